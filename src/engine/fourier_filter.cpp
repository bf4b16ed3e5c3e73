// Filters tiles in the frequency domain and adds them up.
#include "engine/fourier_filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "base/parallel.hpp"
#include "blur/path_2d.hpp"
#include "engine/half_size.hpp"

namespace gyro_deblur {
namespace {

// Longest side of a cell [px]: that of usual blocks.
constexpr int kMaxCellPx = 64;

// Margin of a tile around its window, in extents of the path: quality against time (doc/reports/filter_constants.md).
constexpr float kAroundExtents = 1.75;
static_assert(2 * kMaxCellPx + 1.5f * kMax2dExtentPx <= kMaxFourierSize, "the longest paths have 1.5 extents of it");

// Length of the single step towards a consistent continuation outside the image (doc/reports/filter_constants.md).
constexpr float kOverRelaxation = 2.5f;

// At half the size restoration falls off between these [cycles/px]: halving folds what is beyond onto it.
constexpr double kFallsFrom = 0.16, kEndsAt = 0.24;
// Half the size serves where at kEndsAt the mean gain in power of a straight uniform path of this extent is less than
// this share of WienerInverse2d's ratio there: finer detail then adds noise only (doc/reports/filter_constants.md).
constexpr double kHalvedBelow = 0.07;

/// From 0 to 1 in `length` steps as the square of a sine. `ramp` is one of these already.
void make_ramp(int length, std::vector<float>& ramp) {
  if (static_cast<int>(ramp.size()) == length) return;
  ramp.resize(length);
  for (int i = 0; i < length; ++i) {
    const double s = std::sin(0.5 * CV_PI * (i + 0.5) / length);
    ramp[i] = static_cast<float>(s * s);
  }
}

bool noise_hides_fine_detail(const WienerInverse2d& inverse) {
  const double radians = CV_PI * kEndsAt * extent_of(inverse.path_px).maxCoeff();
  const double ratio = inverse.noise_to_signal + inverse.noise_rise_px2 * kEndsAt * kEndsAt;
  return 0.5 < kHalvedBelow * ratio * radians * radians;
}

WienerInverse2d at_half_size(WienerInverse2d inverse) {
  for (Eigen::Vector2f& place_px : inverse.path_px) place_px *= 0.5f;
  inverse.noise_rise_px2 *= 0.25f;
  return inverse;
}

}  // namespace

FourierFilter::FourierFilter(const FourierSimd& simd)
    : simd_(simd),
      gain_simd_(*find_for_cpu<WienerGain2dSimd>(simd.name)),
      tile_simd_(*find_for_cpu<TileSimd>(simd.name)),
      half_size_simd_(*find_for_cpu<HalfSizeSimd>(simd.name)) {}

void FourierFilter::cut(const std::vector<int>& borders, Axis& axis) {
  std::vector<int> of_cells = {0};
  axis.length = borders.back();
  axis.first_of_block = {0};
  for (std::size_t block = 1; block < borders.size(); ++block) {
    const int begin = borders[block - 1], length = borders[block] - begin;
    const int parts = (length + kMaxCellPx - 1) / kMaxCellPx;
    for (int i = 1; i <= parts; ++i) of_cells.push_back(begin + length * i / parts);
    axis.first_of_block.push_back(axis.first_of_block.back() + parts);
  }
  const int cells = axis.first_of_block.back();
  const auto length_of = [&](int cell) { return of_cells[cell + 1] - of_cells[cell]; };
  // Half of what the windows before and behind a border share.
  const auto half_at = [&](int border) {
    return border == 0 || border == cells ? 0 : std::min(length_of(border - 1), length_of(border)) / 2;
  };
  axis.window_begins.resize(cells);
  axis.weights.resize(cells);
  std::vector<float> ramp;
  for (int cell = 0; cell < cells; ++cell) {
    const int before = half_at(cell), behind = half_at(cell + 1);
    axis.window_begins[cell] = of_cells[cell] - before;
    std::vector<float>& weights = axis.weights[cell];
    weights.assign(before + length_of(cell) + behind, 1.0f);
    make_ramp(2 * before, ramp);
    std::copy(ramp.begin(), ramp.end(), weights.begin());
    make_ramp(2 * behind, ramp);
    std::copy(ramp.begin(), ramp.end(), weights.rbegin());
  }
}

void FourierFilter::downsample2x_axis(const Axis& whole, Axis& half) {
  half.length = (whole.length + 1) / 2;
  half.first_of_block = whole.first_of_block;
  half.window_begins.resize(whole.window_begins.size());
  half.weights.resize(whole.weights.size());
  for (std::size_t cell = 0; cell < whole.weights.size(); ++cell) {
    const std::vector<float>& weights = whole.weights[cell];
    const int begin = whole.window_begins[cell], end = begin + static_cast<int>(weights.size());
    const auto weight_at = [&](int at) { return at < begin || at >= end ? 0 : weights[at - begin]; };
    half.window_begins[cell] = begin / 2;
    half.weights[cell].clear();
    for (int at = begin / 2 * 2; at < end; at += 2) {
      const float second = at + 1 < whole.length ? weight_at(at + 1) : weight_at(at);
      half.weights[cell].push_back(0.5f * (weight_at(at) + second));
    }
  }
}

void FourierFilter::add_cell(int col, int row, int block, const Eigen::Vector2f& extent_px, int channels,
                             int level_index) {
  Level& level = levels_[level_index];
  const cv::Rect window(level.across.window_begins[col], level.down.window_begins[row],
                        static_cast<int>(level.across.weights[col].size()),
                        static_cast<int>(level.down.weights[row].size()));
  const auto length_of_tile = [&](int in_window, float extent) {
    const float length = static_cast<float>(in_window) + std::ceil(kAroundExtents * extent);
    const int size = fourier_size(static_cast<int>(std::min<float>(length, kMaxFourierSize)));
    if (level.plans.count(size) == 0) level.plans.emplace(size, make_plan(size, simd_.largest_radix, level_index));
    return size;
  };
  const cv::Size tile(length_of_tile(window.width, extent_px.x()), length_of_tile(window.height, extent_px.y()));
  const bool at_the_end = (window & cv::Rect(1, 1, level.across.length - 2, level.down.length - 2)) != window;
  level.cell_at[static_cast<std::ptrdiff_t>(row) * level.across.cells() + col] = static_cast<int>(level.cells.size());
  level.cells.push_back({col, row, block, window, tile, at_the_end, result_count_});
  result_count_ += static_cast<std::size_t>(window.area()) * channels;
}

void FourierFilter::make_tiles(const FilterGrid& grid, const std::vector<int>& blocks, int channels) {
  Level& whole = levels_[WHOLE];
  cut(grid.x, whole.across);
  cut(grid.y, whole.down);
  downsample2x_axis(whole.across, levels_[HALF].across);
  downsample2x_axis(whole.down, levels_[HALF].down);
  for (Level& level : levels_) {
    level.cells.clear();
    level.cell_at.assign(static_cast<std::size_t>(whole.across.cells()) * whole.down.cells(), -1);
  }
  result_count_ = 0;
  for (const int block : blocks) {
    const int block_col = block % grid.cols(), block_row = block / grid.cols();
    const Eigen::Vector2f extent_px = extent_of(grid.blocks[block].inverse->path_px);
    const int level = noise_hides_fine_detail(*grid.blocks[block].inverse) ? HALF : WHOLE;
    for (int row = whole.down.first_of_block[block_row]; row < whole.down.first_of_block[block_row + 1]; ++row) {
      for (int col = whole.across.first_of_block[block_col]; col < whole.across.first_of_block[block_col + 1]; ++col) {
        add_cell(col, row, block, level == HALF ? 0.5f * extent_px : extent_px, channels, level);
      }
    }
  }
  if (results_.size() < result_count_) {
    results_ = {};  // or they would be copied
    results_.resize(result_count_);
  }
}

FourierFilter::Plan FourierFilter::make_plan(int size, int largest_radix, int level) {
  Plan plan{FourierPlan(size, largest_radix), {}};
  plan.band.gain.assign(size / 2, 1.0f);
  plan.band.again.assign(size / 2, 1.0f);
  for (int k = 0; level == HALF && k < size / 2; ++k) {
    const double f = 0.5 * k / size, left = lowpass_response(f);
    const double s = std::sin(0.5 * CV_PI * std::clamp((kEndsAt - f) / (kEndsAt - kFallsFrom), 0.0, 1.0));
    plan.band.again[k] = static_cast<float>(s * s);
    plan.band.gain[k] = static_cast<float>(s * s / (left * left));
  }
  return plan;
}

void FourierFilter::prepare_images(const cv::Mat& src, int threads) {
  Level &whole = levels_[WHOLE], &half = levels_[HALF];
  if (src.channels() > 1) {
    cv::split(src, planes_);
    whole.images.assign(planes_.begin(), planes_.end());
  } else {
    whole.images.assign(1, src);
  }
  half.images.resize(whole.images.size());
  for (std::size_t channel = 0; channel < whole.images.size() && !half.cells.empty(); ++channel) {
    downsample2x(whole.images[channel], threads, half.images[channel], half_size_simd_);
  }
}

float* FourierFilter::floats_in(std::vector<CacheLine>& lines, int count) {
  constexpr int kLineFloats = sizeof(CacheLine) / sizeof(float);
  lines.resize(std::max<std::size_t>(lines.size(), count / kLineFloats));
  return lines.data()->floats;
}

void FourierFilter::load_tile(const cv::Mat& image, const Cell& cell, Scratch& scratch, float* tile) const {
  const cv::Rect& window = cell.window;
  const TileSource source{image.data,
                          static_cast<std::ptrdiff_t>(image.step1()),
                          image.cols,
                          image.rows,
                          window.x,
                          window.y,
                          window.width,
                          window.height,
                          cell.tile.width,
                          cell.tile.height,
                          scratch.fade_x.data(),
                          scratch.fade_y.data()};
  const auto load = image.depth() == CV_8U    ? tile_simd_.load_bytes
                    : image.depth() == CV_16U ? tile_simd_.load_words
                                              : tile_simd_.load_floats;
  load(source, tile, floats_in(scratch.row, tile_scratch(source.cols)));
}

void FourierFilter::continue_tile(const Level& level, const Cell& cell, const FourierTile& plan, Scratch& scratch,
                                  float* tile) const {
  const int cols = cell.tile.width, rows = cell.tile.height, stride = fourier_stride(cols);
  // Share of the image in what a tile has at an element, along one axis.
  const auto find_inside = [](int begin, int length, int size, int image, const std::vector<float>& fade,
                              std::vector<float>& inside) {
    inside.assign(size, 1.0f);
    for (int i = length; i < size; ++i) {
      const float before = fade[i - length];
      inside[i] = (begin + i < image ? 1 - before : 0) + (begin + i - size >= 0 ? before : 0);
    }
  };
  const cv::Rect& window = cell.window;
  find_inside(window.x, window.width, cols, level.across.length, scratch.fade_x, scratch.inside_x);
  find_inside(window.y, window.height, rows, level.down.length, scratch.fade_y, scratch.inside_y);
  float* continued = floats_in(scratch.continued, rows * stride);
  float* transform = floats_in(scratch.transform, fourier_scratch(std::max(cols, rows)));
  const float* again = floats_in(scratch.again, rows * cols);
  std::copy_n(tile, rows * stride, continued);
  simd_.transform_columns(plan, continued, transform);
  for (int row = 0; row < rows / 2; row += simd_.lanes) {
    simd_.filter_rows(plan, row, again + 2 * row * cols, 0, cols, continued, transform);
  }
  simd_.restore_columns(plan, 0, cols, continued, transform);
  tile_simd_.continue_tile(cols, rows, kOverRelaxation, scratch.inside_x.data(), scratch.inside_y.data(), continued,
                           tile);
}

void FourierFilter::filter_cell(const Cell& cell, const WienerInverse2d& inverse, const Level& level,
                                Scratch& scratch) {
  const Plan &plan_across = level.plans.at(cell.tile.width), &plan_down = level.plans.at(cell.tile.height);
  const FourierTile plan{plan_across.transform.stages(), plan_down.transform.stages()};
  const cv::Rect& window = cell.window;
  const int cols = cell.tile.width, rows = cell.tile.height, stride = fourier_stride(cols);
  const int channels = static_cast<int>(level.images.size());
  float* tiles = floats_in(scratch.tiles, channels * rows * stride);
  float* transform = floats_in(scratch.transform, fourier_scratch(std::max(cols, rows)));
  // At the end of the image the gains are needed twice.
  const bool at_the_end = cell.at_the_end;
  float* gains = floats_in(scratch.gains, 2 * (at_the_end ? rows / 2 : simd_.lanes) * cols);
  float* again = at_the_end ? floats_in(scratch.again, rows * cols) : nullptr;
  make_ramp(cols - window.width, scratch.fade_x);
  make_ramp(rows - window.height, scratch.fade_y);
  scratch.gain.set(inverse, plan, plan_across.band, plan_down.band);
  for (int row = 0; row < rows / 2 && at_the_end; row += simd_.lanes) {
    scratch.gain.rows(row, gains + 2 * row * cols, again + 2 * row * cols);
  }
  for (int channel = 0; channel < channels; ++channel) {
    float* tile = tiles + channel * rows * stride;
    load_tile(level.images[channel], cell, scratch, tile);
    if (at_the_end) continue_tile(level, cell, plan, scratch, tile);
    simd_.transform_columns(plan, tile, transform);
  }
  for (int row = 0; row < rows / 2; row += simd_.lanes) {
    const float* gain = gains + (at_the_end ? 2 * row * cols : 0);
    if (!at_the_end) scratch.gain.rows(row, gains);
    for (int channel = 0; channel < channels; ++channel) {
      simd_.filter_rows(plan, row, gain, 0, window.width, tiles + channel * rows * stride, transform);
    }
  }
  const float *weights_x = level.across.weights[cell.col].data(), *weights_y = level.down.weights[cell.row].data();
  float* to = results_.data() + cell.result;
  for (int channel = 0; channel < channels; ++channel, to += window.area()) {
    float* tile = tiles + channel * rows * stride;
    simd_.restore_columns(plan, 0, window.width, tile, transform);
    tile_simd_.weigh(tile, cols, window.width, window.height, weights_x, weights_y, to);
  }
}

void FourierFilter::find_part(int level_index, const FilterGrid& grid, int block, const cv::Rect& rect,
                              Part& part) const {
  const Level& level = levels_[level_index];
  const cv::Rect pixels = level_index == HALF ? needed_of_half(rect, {level.across.length, level.down.length}) : rect;
  const auto along = [](const Axis& axis, int of_block, int begin_px, int end_px) {
    cv::Range cells(axis.first_of_block[of_block], axis.first_of_block[of_block + 1]);
    while (cells.start > 0 && axis.window_end(cells.start - 1) > begin_px) --cells.start;
    while (cells.end < axis.cells() && axis.window_begins[cells.end] < end_px) ++cells.end;
    return cells;
  };
  const cv::Range cols = along(level.across, block % grid.cols(), pixels.x, pixels.br().x);
  const cv::Range rows = along(level.down, block / grid.cols(), pixels.y, pixels.br().y);
  part.pixels = pixels;
  part.cells.clear();
  part.has_all = true;
  for (int row = rows.start; row < rows.end; ++row) {
    const int* cells = level.cell_at.data() + static_cast<std::ptrdiff_t>(row) * level.across.cells();
    for (int col = cols.start; col < cols.end; ++col) {
      if (cells[col] < 0) {
        part.has_all = false;
      } else if (!(level.cells[cells[col]].window & pixels).empty()) {
        part.cells.push_back(cells[col]);
      }
    }
  }
}

void FourierFilter::overlap_add(int level_index, const Part& part, const cv::Rect& rect, std::optional<int> channel,
                                Scratch& scratch, std::vector<float>& sums) const {
  const Level& level = levels_[level_index];
  std::vector<float>& to = level_index == HALF ? scratch.halves : sums;
  to.assign(static_cast<std::size_t>(part.pixels.area()), 0);
  for (const int index : part.cells) {
    const Cell& cell = level.cells[index];
    const cv::Rect both = cell.window & part.pixels;
    const cv::Point in_window = both.tl() - cell.window.tl(), in_part = both.tl() - part.pixels.tl();
    const float* weights_x = level.across.weights[cell.col].data() + in_window.x;
    const float* weights_y = level.down.weights[cell.row].data() + in_window.y;
    const float* results =
        results_.data() + cell.result + in_window.x +
        (static_cast<std::ptrdiff_t>(channel.value_or(0)) * cell.window.height + in_window.y) * cell.window.width;
    float* sum = to.data() + static_cast<std::ptrdiff_t>(in_part.y) * part.pixels.width + in_part.x;
    if (channel) {
      tile_simd_.add(results, cell.window.width, both.width, both.height, sum, part.pixels.width);
      continue;
    }
    for (int y = 0; y < both.height; ++y, sum += part.pixels.width) {
#pragma omp simd
      for (int x = 0; x < both.width; ++x) sum[x] += weights_x[x] * weights_y[y];
    }
  }
  if (level_index == WHOLE) return;
  sums.resize(static_cast<std::size_t>(rect.area()));
  double_size(part.pixels, to.data(), rect, scratch.of_doubling, sums.data(), half_size_simd_);
}

template <typename Pixel>
void FourierFilter::write_block(int block, const FilterGrid& grid, SeamBlender& seams, Scratch& scratch,
                                cv::Mat& dst) const {
  const int channels = dst.channels();
  const cv::Rect reach = seams.reach(block);
  const std::size_t area = static_cast<std::size_t>(reach.area());
  Part(&parts)[LEVELS] = scratch.parts;
  for (const int level : {WHOLE, HALF}) find_part(level, grid, block, reach, parts[level]);
  const bool is_mixed = !parts[WHOLE].cells.empty() && !parts[HALF].cells.empty();
  const int first = parts[WHOLE].cells.empty() ? HALF : WHOLE;
  // Weights of all cells at one size sum up to 1.
  const bool has_weights = is_mixed || !parts[first].has_all;
  for (const int level : {WHOLE, HALF}) {
    if (has_weights && !parts[level].cells.empty()) {
      overlap_add(level, parts[level], reach, {}, scratch, scratch.weights[level]);
    }
  }
  for (int channel = 0; channel < channels; ++channel) {
    for (const int level : {WHOLE, HALF}) {
      if (!parts[level].cells.empty()) {
        overlap_add(level, parts[level], reach, channel, scratch, scratch.values[level]);
      }
    }
    float* values = scratch.values[first].data();
    const float* weights = scratch.weights[first].data();
    if (is_mixed) {
      const float *halves = scratch.values[HALF].data(), *weights_of_halves = scratch.weights[HALF].data();
      tile_simd_.mix_sizes(halves, weights_of_halves, weights, reach.area(), values);
    } else if (has_weights) {
#pragma omp simd
      for (std::size_t i = 0; i < area; ++i) values[i] /= weights[i];
    }
    for (const SeamBlender::Part<Pixel>& piece : seams.parts<Pixel>(block, dst)) {
      const cv::Rect& rect = piece.rect;
      if (rect.empty()) continue;
      const float* from = values + static_cast<std::ptrdiff_t>(rect.y - reach.y) * reach.width + rect.x - reach.x;
      Pixel* to = piece.to + channel;
      if constexpr (sizeof(Pixel) == 1) {
        tile_simd_.store_bytes(from, reach.width, rect.width, rect.height, channels, to, piece.stride);
      } else {
        tile_simd_.store_words(from, reach.width, rect.width, rect.height, channels, to, piece.stride);
      }
    }
  }
}

template <typename Pixel>
void FourierFilter::filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                              SeamBlender& seams, cv::Mat& dst) {
  make_tiles(grid, blocks, src.channels());
  prepare_images(src, threads);
  while (static_cast<int>(scratch_.size()) < threads) scratch_.emplace_back(gain_simd_);
  const std::vector<Cell>&of_whole = levels_[WHOLE].cells, &of_half = levels_[HALF].cells;
  const int wholes = static_cast<int>(of_whole.size()), halves = static_cast<int>(of_half.size());
  parallel_for(wholes + halves, threads, 1, [&](int i, int thread) {
    if (i < wholes) {
      const WienerInverse2d& inverse = *grid.blocks[of_whole[i].block].inverse;
      filter_cell(of_whole[i], inverse, levels_[WHOLE], scratch_[thread]);
    } else {
      const Cell& cell = of_half[i - wholes];
      filter_cell(cell, at_half_size(*grid.blocks[cell.block].inverse), levels_[HALF], scratch_[thread]);
    }
  });
  constexpr int kBlocksAtATime = 4;
  parallel_for(static_cast<int>(blocks.size()), threads, kBlocksAtATime,
               [&](int i, int thread) { write_block<Pixel>(blocks[i], grid, seams, scratch_[thread], dst); });
  levels_[WHOLE].images.clear();  // `src` belongs to the caller
}

void FourierFilter::filter(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                           SeamBlender& seams, cv::Mat& dst) {
  if (blocks.empty()) return;
  if (src.depth() == CV_8U) {
    filter_as<std::uint8_t>(src, grid, blocks, threads, seams, dst);
  } else {
    filter_as<std::uint16_t>(src, grid, blocks, threads, seams, dst);
  }
}

}  // namespace gyro_deblur
