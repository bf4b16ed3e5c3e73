#include "engine/plane_filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "base/parallel.hpp"

namespace gyro_deblur {
namespace {

// Longest side of a cell [px]: that of usual blocks.
constexpr int kMaxCellPx = 64;

// What a tile has beside its window, by the path's extent. On four photographs of the Oxford sets, noise of 2 grey
// levels, arcs of 25 / 60 px, 1, 2 and 4 restore 25.13 / 21.53, 25.19 / 21.73 and 25.20 / 21.81 dB.
constexpr float kAroundExtents = 2;
static_assert(2 * kMaxCellPx + kAroundExtents * kMaxPlaneExtentPx <= kMaxFourierSize,
              "paths of fields have their tiles");

// Of the one step towards an image outside that fits. In the same measurements whole images of 576x480 gain 0.23 / 0.30
// dB; 1.7 and 3.5 gain 0.20 / 0.26 and 0.21 / 0.24, eight steps of 1.7 0.38 / 0.51.
constexpr float kOverRelaxation = 2.5f;

/// From 0 to 1 in `length` steps as the square of a sine. `ramp` is one of these already.
void make_ramp(int length, std::vector<float>& ramp) {
  if (static_cast<int>(ramp.size()) == length) return;
  ramp.resize(length);
  for (int i = 0; i < length; ++i) {
    const double s = std::sin(0.5 * CV_PI * (i + 0.5) / length);
    ramp[i] = static_cast<float>(s * s);
  }
}

void clear(cv::Size size, cv::Mat& sums) {
  sums.create(size, CV_32F);
  sums.setTo(0);
}

}  // namespace

PlaneFilter::PlaneFilter(const FourierLoops& loops) : loops_(loops) {}

void PlaneFilter::cut(const std::vector<int>& borders, Axis& axis) {
  axis.borders = {0};
  axis.first_of_block = {0};
  for (std::size_t block = 1; block < borders.size(); ++block) {
    const int begin = borders[block - 1], length = borders[block] - begin;
    const int parts = (length + kMaxCellPx - 1) / kMaxCellPx;
    for (int i = 1; i <= parts; ++i) axis.borders.push_back(begin + length * i / parts);
    axis.first_of_block.push_back(axis.first_of_block.back() + parts);
  }
  const int cells = axis.first_of_block.back();
  const auto length_of = [&](int cell) { return axis.borders[cell + 1] - axis.borders[cell]; };
  // Half of what the windows before and behind a border share.
  const auto half_at = [&](int border) {
    return border == 0 || border == cells ? 0 : std::min(length_of(border - 1), length_of(border)) / 2;
  };
  axis.window_begins.resize(cells);
  axis.weights.resize(cells);
  std::vector<float> ramp;
  for (int cell = 0; cell < cells; ++cell) {
    const int before = half_at(cell), behind = half_at(cell + 1);
    axis.window_begins[cell] = axis.borders[cell] - before;
    std::vector<float>& weights = axis.weights[cell];
    weights.assign(before + length_of(cell) + behind, 1.0f);
    make_ramp(2 * before, ramp);
    std::copy(ramp.begin(), ramp.end(), weights.begin());
    make_ramp(2 * behind, ramp);
    std::copy(ramp.begin(), ramp.end(), weights.rbegin());
  }
}

void PlaneFilter::cut_cells(const FilterGrid& grid, const std::vector<int>& blocks, cv::Size size) {
  pad_before_ = pad_behind_ = 0;
  cut(grid.x, across_);
  cut(grid.y, down_);
  for (std::vector<Cell>& cells : cells_) cells.clear();
  for (const int block : blocks) {
    const int block_col = block % grid.cols(), block_row = block / grid.cols();
    const float extent_px = extent_of(grid.blocks[block].inverse->path_px).maxCoeff();
    const int around = static_cast<int>(std::ceil(std::min<float>(kAroundExtents * extent_px, kMaxFourierSize)));
    for (int row = down_.first_of_block[block_row]; row < down_.first_of_block[block_row + 1]; ++row) {
      for (int col = across_.first_of_block[block_col]; col < across_.first_of_block[block_col + 1]; ++col) {
        const cv::Rect window(across_.window_begins[col], down_.window_begins[row],
                              static_cast<int>(across_.weights[col].size()),
                              static_cast<int>(down_.weights[row].size()));
        const int side = fourier_size(std::min(std::max(window.width, window.height) + around, kMaxFourierSize));
        const bool at_the_end = (window & cv::Rect(1, 1, size.width - 2, size.height - 2)) != window;
        cells_[row % 2].push_back({col, row, block, window, side, at_the_end});
        pad_before_ = std::max({pad_before_, side - window.br().x, side - window.br().y});
        pad_behind_ = std::max({pad_behind_, window.x + side - size.width, window.y + side - size.height});
        if (plans_.count(side) == 0) plans_.emplace(side, FourierPlan(side, loops_.largest_radix));
      }
    }
  }
}

float* PlaneFilter::floats_in(std::vector<CacheLine>& lines, int count) {
  constexpr int kLineFloats = sizeof(CacheLine) / sizeof(float);
  lines.resize(std::max<std::size_t>(lines.size(), count / kLineFloats));
  return lines.data()->floats;
}

template <typename Pixel>
void PlaneFilter::load_tile(const cv::Mat& padded, const Cell& cell, Scratch& scratch, float* tile) const {
  const cv::Rect& window = cell.window;
  const int size = cell.size, stride = fourier_stride(size);
  const auto load_row = [&](int y, float* to) {
    const Pixel* from = padded.ptr<Pixel>(window.y + y + pad_before_) + window.x + pad_before_;
#pragma omp simd
    for (int x = 0; x < window.width; ++x) to[x] = from[x];
    const float* weights = scratch.fade_x.data();
#pragma omp simd
    for (int x = window.width; x < size; ++x) {
      const float behind = from[x], before = from[x - size];
      to[x] = behind + weights[x - window.width] * (before - behind);
    }
  };
  for (int y = 0; y < size; ++y) {
    float* to = tile + y * stride;
    load_row(y, to);
    if (y < window.height) continue;
    load_row(y - size, scratch.row.data());
    const float weight = scratch.fade_y[y - window.height];
#pragma omp simd
    for (int x = 0; x < size; ++x) to[x] += weight * (scratch.row[x] - to[x]);
  }
}

void PlaneFilter::continue_tile(const Cell& cell, const FourierStages& plan, Scratch& scratch, float* tile) const {
  const int size = cell.size, stride = fourier_stride(size);
  // Share of the image in what a tile has at an element, along one axis.
  const auto find_inside = [size](int begin, int length, int image, const std::vector<float>& fade,
                                  std::vector<float>& inside) {
    inside.assign(size, 1.0f);
    for (int i = length; i < size; ++i) {
      const float before = fade[i - length];
      inside[i] = (begin + i < image ? 1 - before : 0) + (begin + i - size >= 0 ? before : 0);
    }
  };
  find_inside(cell.window.x, cell.window.width, across_.borders.back(), scratch.fade_x, scratch.inside_x);
  find_inside(cell.window.y, cell.window.height, down_.borders.back(), scratch.fade_y, scratch.inside_y);
  float* continued = floats_in(scratch.continued, size * stride);
  float* transform = floats_in(scratch.transform, fourier_scratch(size));
  float* gain = floats_in(scratch.gain_rows, 2 * loops_.lanes * size);
  std::copy_n(tile, size * stride, continued);
  loops_.transform_columns(plan, continued, transform);
  for (int row = 0; row < size / 2; row += loops_.lanes) {
    scratch.gain.rows_blurred_again(row, gain);
    loops_.filter_rows(plan, row, gain, 0, size, continued, transform);
  }
  loops_.restore_columns(plan, 0, size, continued, transform);
  for (int y = 0; y < size; ++y) {
    const float *inside_x = scratch.inside_x.data(), *from = continued + y * stride;
    const float inside_y = scratch.inside_y[y];
    float* to = tile + y * stride;
#pragma omp simd
    for (int x = 0; x < size; ++x) to[x] += kOverRelaxation * (1 - inside_x[x] * inside_y) * (from[x] - to[x]);
  }
}

template <typename Pixel>
void PlaneFilter::filter_cell(const Cell& cell, const PlaneInverse& inverse, Scratch& scratch) {
  const FourierStages plan = plans_.at(cell.size).stages();
  const cv::Rect& window = cell.window;
  const int size = cell.size, stride = fourier_stride(size), channels = static_cast<int>(padded_.size());
  float* tiles = floats_in(scratch.tiles, channels * size * stride);
  float* transform = floats_in(scratch.transform, fourier_scratch(size));
  float* gain = floats_in(scratch.gain_rows, 2 * loops_.lanes * size);
  scratch.row.resize(std::max<std::size_t>(scratch.row.size(), size));
  make_ramp(size - window.width, scratch.fade_x);
  make_ramp(size - window.height, scratch.fade_y);
  scratch.gain.set(inverse, plan);
  for (int channel = 0; channel < channels; ++channel) {
    float* tile = tiles + channel * size * stride;
    load_tile<Pixel>(padded_[channel], cell, scratch, tile);
    if (cell.at_the_end) continue_tile(cell, plan, scratch, tile);
    loops_.transform_columns(plan, tile, transform);
  }
  for (int row = 0; row < size / 2; row += loops_.lanes) {
    scratch.gain.rows(row, gain);
    for (int channel = 0; channel < channels; ++channel) {
      loops_.filter_rows(plan, row, gain, 0, window.width, tiles + channel * size * stride, transform);
    }
  }
  const float *weights_x = across_.weights[cell.col].data(), *weights_y = down_.weights[cell.row].data();
  for (int channel = 0; channel < channels; ++channel) {
    float* tile = tiles + channel * size * stride;
    loops_.restore_columns(plan, 0, window.width, tile, transform);
    for (int y = 0; y < window.height; ++y) {
      const float* from = tile + y * stride;
      float* sums = sums_[cell.col % 2][channel].ptr<float>(window.y + y) + window.x;
#pragma omp simd
      for (int x = 0; x < window.width; ++x) sums[x] += from[x] * (weights_x[x] * weights_y[y]);
    }
  }
  if (are_ones_) return;
  for (int y = 0; y < window.height; ++y) {
    float* weights = weights_[cell.col % 2].ptr<float>(window.y + y) + window.x;
    for (int x = 0; x < window.width; ++x) weights[x] += weights_x[x] * weights_y[y];
  }
}

template <typename Pixel>
void PlaneFilter::deliver(int block, SeamBlender& seams, cv::Mat& dst) const {
  constexpr int kMax = std::numeric_limits<Pixel>::max(), kPiece = 64;
  const int channels = static_cast<int>(sums_[0].size());
  const auto deliver_piece = [&](int channel, int x, int y, int count, Pixel* to) {
    const float *even = sums_[0][channel].ptr<float>(y) + x, *odd = sums_[1][channel].ptr<float>(y) + x;
    // In steps that vectorise each: float to int, int clipped, int to pixel.
    int values[kPiece];
    if (are_ones_) {
      for (int i = 0; i < count; ++i) values[i] = static_cast<int>(even[i] + odd[i] + 0.5f);
    } else {
      const float *of_even = weights_[0].ptr<float>(y) + x, *of_odd = weights_[1].ptr<float>(y) + x;
      for (int i = 0; i < count; ++i) {
        values[i] = static_cast<int>((even[i] + odd[i]) / (of_even[i] + of_odd[i]) + 0.5f);
      }
    }
    for (int i = 0; i < count; ++i) values[i] = std::min(std::max(values[i], 0), kMax);
    for (int i = 0; i < count; ++i) to[i * channels] = static_cast<Pixel>(values[i]);
  };
  for (const SeamBlender::Part<Pixel>& part : seams.parts<Pixel>(block, dst)) {
    const cv::Rect& rect = part.rect;
    for (int y = 0; y < rect.height; ++y) {
      for (int x = 0; x < rect.width; x += kPiece) {
        const int count = std::min(kPiece, rect.width - x);
        for (int channel = 0; channel < channels; ++channel) {
          deliver_piece(channel, rect.x + x, rect.y + y, count, part.to + y * part.stride + x * channels + channel);
        }
      }
    }
  }
}

template <typename Pixel>
void PlaneFilter::filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                            SeamBlender& seams, cv::Mat& dst) {
  cut_cells(grid, blocks, src.size());
  const int channels = src.channels();
  padded_.resize(channels);
  cv::split(src, channels_);
  for (int channel = 0; channel < channels; ++channel) {
    cv::copyMakeBorder(channels_[channel], padded_[channel], pad_before_, pad_behind_, pad_before_, pad_behind_,
                       cv::BORDER_REPLICATE);
  }
  are_ones_ = blocks.size() == grid.blocks.size();
  for (const int odd : {0, 1}) {
    sums_[odd].resize(channels);
    for (cv::Mat& sums : sums_[odd]) clear(src.size(), sums);
    if (!are_ones_) clear(src.size(), weights_[odd]);
  }
  const PlaneGainLoops& gain_loops = *find_plane_gain_loops(loops_.name);
  while (static_cast<int>(scratch_.size()) < threads) scratch_.emplace_back(gain_loops);
  for (const std::vector<Cell>& cells : cells_) {
    run_parallel(static_cast<int>(cells.size()), threads, 1, [&](int i, int thread) {
      filter_cell<Pixel>(cells[i], *grid.blocks[cells[i].block].inverse, scratch_[thread]);
    });
  }
  constexpr int kBlocksAtATime = 16;
  run_parallel(static_cast<int>(blocks.size()), threads, kBlocksAtATime,
               [&](int i) { deliver<Pixel>(blocks[i], seams, dst); });
}

void PlaneFilter::filter(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                         SeamBlender& seams, cv::Mat& dst) {
  if (blocks.empty()) return;
  if (src.depth() == CV_8U) {
    filter_as<std::uint8_t>(src, grid, blocks, threads, seams, dst);
  } else {
    filter_as<std::uint16_t>(src, grid, blocks, threads, seams, dst);
  }
}

}  // namespace gyro_deblur
