// Body of the loops of the 2-D filter around its transforms, once per instruction set (see base/vectors_impl.hpp).
#include "base/fourier.hpp"
#include "base/vectors_impl.hpp"
#include "engine/tile_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

inline Vector load_vector(const std::uint8_t* from) { return load_pixels(from); }
inline Vector load_vector(const std::uint16_t* from) { return load_pixels(from); }
inline Vector load_vector(const float* from) { return load(from); }

/// Columns of an image that a row of a tile needs: [first, first + count), and which of them it has.
struct Columns {
  int first, count;
  int inside, end;  ///< from `first` on
};

Columns columns_of(const TileSource& source) {
  Columns columns{};
  columns.count = 2 * source.cols - source.width;
  columns.first = source.x + source.width - source.cols;
  const int before = -columns.first, end = source.image_cols + before;
  columns.inside = before < 0 ? 0 : (before < columns.count ? before : columns.count - 1);
  columns.end = end <= columns.inside ? columns.inside + 1 : (end < columns.count ? end : columns.count);
  return columns;
}

/// What a row of a tile needs of a row of the image, whose edges go on.
template <typename Pixel>
void extend_row(const Pixel* row, int image_cols, const Columns& columns, float* to) {
  int x = 0;
  for (; x < columns.inside; ++x) to[x] = row[0];
  for (; x + kLanes <= columns.end; x += kLanes) store(to + x, load_vector(row + columns.first + x));
  for (; x < columns.end; ++x) to[x] = row[columns.first + x];
  for (; x < columns.count; ++x) to[x] = row[image_cols - 1];
}

/// A row of a tile from two of the image, each from the first of its columns on: here + weight (above - here).
template <bool kMixes, typename Pixel>
void fade_row(const TileSource& source, const Pixel* here, const Pixel* above, float weight, float* to) {
  const int faded = source.cols - source.width;
  const auto vector_at = [&](int i) {
    const Vector v = load_vector(here + i);
    return kMixes ? v + weight * (load_vector(above + i) - v) : v;
  };
  const auto value_at = [&](int i) {
    const float v = here[i];
    return kMixes ? v + weight * (static_cast<float>(above[i]) - v) : v;
  };
  int x = 0;
  for (; x + kLanes <= source.width; x += kLanes) store(to + x, vector_at(faded + x));
  for (; x < source.width; ++x) to[x] = value_at(faded + x);
  to += source.width;
  for (x = 0; x + kLanes <= faded; x += kLanes) {
    const Vector behind = vector_at(source.cols + x);
    store(to + x, behind + load(source.fade_x + x) * (vector_at(x) - behind));
  }
  for (; x < faded; ++x) {
    const float behind = value_at(source.cols + x);
    to[x] = behind + source.fade_x[x] * (value_at(x) - behind);
  }
}

template <typename Pixel>
void fade_row(const TileSource& source, int y, const Pixel* here, const Pixel* above, float* to) {
  if (y < source.height) {
    fade_row<false>(source, here, here, 0, to);
  } else {
    fade_row<true>(source, here, above, source.fade_y[y - source.height], to);
  }
}

template <typename Pixel>
void load_tile(const TileSource& source, float* tile, float* scratch) {
  const Columns columns = columns_of(source);
  const bool has_all = columns.inside == 0 && columns.end == columns.count;
  const auto row_at = [&](int y) {
    return static_cast<const Pixel*>(source.pixels) + clamp_to(source.y + y, source.image_rows) * source.row_pixels;
  };
  float *here = scratch, *above = scratch + columns.count;
  for (int y = 0; y < source.rows; ++y, tile += fourier_stride(source.cols)) {
    const Pixel *row = row_at(y), *row_above = row_at(y - source.rows);
    if (has_all) {
      fade_row(source, y, row + columns.first, row_above + columns.first, tile);
      continue;
    }
    extend_row(row, source.image_cols, columns, here);
    if (y >= source.height) extend_row(row_above, source.image_cols, columns, above);
    fade_row(source, y, here, above, tile);
  }
}

void continue_tile(int cols, int rows, float step, const float* inside_x, const float* inside_y, const float* continued,
                   float* tile) {
  const int stride = fourier_stride(cols);
  for (int y = 0; y < rows; ++y, tile += stride, continued += stride) {
    const float inside = step * inside_y[y];
    for (int x = 0; x < cols; x += kLanes) {  // tiles have whole vectors
      const Vector old = load(tile + x);
      store(tile + x, old + (step - inside * load(inside_x + x)) * (load(continued + x) - old));
    }
  }
}

void weigh(const float* tile, int cols, int width, int height, const float* weights_x, const float* weights_y,
           float* window) {
  for (int y = 0; y < height; ++y, tile += fourier_stride(cols), window += width) {
    const float weight = weights_y[y];
    int x = 0;
    for (; x + kLanes <= width; x += kLanes) store(window + x, load(tile + x) * (load(weights_x + x) * weight));
    for (; x < width; ++x) window[x] = tile[x] * (weights_x[x] * weight);
  }
}

void add(const float* from, std::ptrdiff_t from_stride, int width, int height, float* to, std::ptrdiff_t to_stride) {
  for (int y = 0; y < height; ++y, from += from_stride, to += to_stride) {
    int x = 0;
    for (; x + kLanes <= width; x += kLanes) store(to + x, load(to + x) + load(from + x));
    // Pieces are often a few pixels wider than whole vectors.
    for (; x + 4 <= width; x += 4) {
      const FourFloats sum = load_as<FourFloats>(to + x) + load_as<FourFloats>(from + x);
      std::memcpy(to + x, &sum, sizeof sum);
    }
    for (; x < width; ++x) to[x] += from[x];
  }
}

void mix_sizes(const float* halves, const float* weights_of_halves, const float* weights, int count, float* values) {
  int i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    const Vector none = {}, weight = load(weights + i), weight_of_half = load(weights_of_halves + i);
    const IntVector has_half = (weight_of_half > none) | (weight <= none);
    store(values + i,
          (load(values + i) + (has_half ? load(halves + i) : none)) / (weight + (has_half ? weight_of_half : none)));
  }
  for (; i < count; ++i) {
    const bool has_half = weights_of_halves[i] > 0 || weights[i] <= 0;
    values[i] = (values[i] + (has_half ? halves[i] : 0)) / (weights[i] + (has_half ? weights_of_halves[i] : 0));
  }
}

/// Copies at most kLanes elements without a call: most often a multiple of 4.
template <typename T>
inline void copy_few(const T* from, int count, T* to) {
  int i = 0;
  for (; i + 4 <= count; i += 4) std::memcpy(to + i, from + i, 4 * sizeof(T));
  for (; i < count; ++i) to[i] = from[i];
}

template <typename Pixel>
void store_rows(const float* from, std::ptrdiff_t from_stride, int width, int height, int step, Pixel* to,
                std::ptrdiff_t to_stride) {
  for (int y = 0; y < height; ++y, from += from_stride, to += to_stride) {
    for (int x = 0; x < width; x += kLanes) {
      const int count = width - x < kLanes ? width - x : kLanes;
      if (count == kLanes && step == 1) {
        store_pixels(to + x, load(from + x));
        continue;
      }
      float values[kLanes] = {};
      Pixel pixels[kLanes];
      copy_few(from + x, count, values);
      store_pixels(pixels, load(values));
      if (step == 1) {
        copy_few(pixels, count, to + x);
      } else {
        for (int i = 0; i < count; ++i) to[(x + i) * step] = pixels[i];
      }
    }
  }
}

}  // namespace

extern const TileSimd kTileSimd;
const TileSimd kTileSimd = {GYRO_DEBLUR_ISA_NAME,
                            load_tile<std::uint8_t>,
                            load_tile<std::uint16_t>,
                            load_tile<float>,
                            continue_tile,
                            weigh,
                            add,
                            mix_sizes,
                            store_rows<std::uint8_t>,
                            store_rows<std::uint16_t>};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
