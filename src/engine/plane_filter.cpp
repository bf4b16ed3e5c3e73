#include "engine/plane_filter.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "base/parallel.hpp"
#include "engine/half_size.hpp"

namespace gyro_deblur {
namespace {

// Longest side of a cell [px]: that of usual blocks.
constexpr int kMaxCellPx = 64;

// What a tile has beside its window, by the path's extent. On four photographs of the Oxford sets, noise of 2 grey
// levels, arcs of 25 / 60 px, 1, 2 and 4 restore 25.13 / 21.53, 25.19 / 21.73 and 25.20 / 21.81 dB; of hand-shake at
// 1080p 1.5 restores 0.1 dB less than 2, has the same matches, and takes four fifths of the time.
constexpr float kAroundExtents = 1.5;
static_assert(2 * kMaxCellPx + kAroundExtents * kMaxPlaneExtentPx <= kMaxFourierSize,
              "paths of fields have their tiles");

// Of the one step towards an image outside that fits. In the same measurements whole images of 576x480 gain 0.23 / 0.30
// dB; 1.7 and 3.5 gain 0.20 / 0.26 and 0.21 / 0.24, eight steps of 1.7 0.38 / 0.51.
constexpr float kOverRelaxation = 2.5f;

// At half the size, what is restored falls off between these [cycles/px]; beyond, halving mixes it with other
// frequencies.
constexpr double kFallsFrom = 0.16, kEndsAt = 0.24;
// Half the size serves where at kEndsAt a straight run of this extent leaves less of a wave's power, on the mean, than
// this share of PlaneInverse's ratio there. Of hand-shake at 1080p (the frames of experiments/hand_shake) with noise of
// 0.5, 1, 2 and 4 grey levels, what lies above 0.2 cycles/px is worth 0.3, 0.2, 0.05 and -0.2 dB at 26 px, and 0.1,
// 0.1, 0 and -0.1 dB at 63 px.
constexpr double kHalvedBelow = 0.035;

/// From 0 to 1 in `length` steps as the square of a sine. `ramp` is one of these already.
void make_ramp(int length, std::vector<float>& ramp) {
  if (static_cast<int>(ramp.size()) == length) return;
  ramp.resize(length);
  for (int i = 0; i < length; ++i) {
    const double s = std::sin(0.5 * CV_PI * (i + 0.5) / length);
    ramp[i] = static_cast<float>(s * s);
  }
}

bool is_for_half_size(const PlaneInverse& inverse) {
  const double radians = CV_PI * kEndsAt * extent_of(inverse.path_px).maxCoeff();
  const double ratio = inverse.noise_to_signal + inverse.noise_rise_px2 * kEndsAt * kEndsAt;
  return 0.5 < kHalvedBelow * ratio * radians * radians;
}

PlaneInverse at_half_size(PlaneInverse inverse) {
  for (Eigen::Vector2f& place_px : inverse.path_px) place_px *= 0.5f;
  inverse.noise_rise_px2 *= 0.25f;
  return inverse;
}

/// A block and its neighbours in a grid.
template <typename Use>
void for_each_around(int block, const FilterGrid& grid, const Use& use) {
  const int block_col = block % grid.cols(), block_row = block / grid.cols();
  for (int row = std::max(block_row - 1, 0); row <= std::min(block_row + 1, grid.rows() - 1); ++row) {
    for (int col = std::max(block_col - 1, 0); col <= std::min(block_col + 1, grid.cols() - 1); ++col) {
      use(row * grid.cols() + col);
    }
  }
}

}  // namespace

PlaneFilter::PlaneFilter(const FourierLoops& loops) : loops_(loops) {}

void PlaneFilter::cut(const std::vector<int>& borders, Axis& axis) {
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

void PlaneFilter::halve_axis(const Axis& whole, Axis& half) {
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

void PlaneFilter::add_cell(int col, int row, int block, float extent_px, int level_index) {
  Level& level = levels_[level_index];
  const cv::Rect window(level.across.window_begins[col], level.down.window_begins[row],
                        static_cast<int>(level.across.weights[col].size()),
                        static_cast<int>(level.down.weights[row].size()));
  const float around_px = std::ceil(kAroundExtents * extent_px);
  const int longest = std::max(window.width, window.height);
  const int side = fourier_size(static_cast<int>(std::min<float>(longest + around_px, kMaxFourierSize)));
  const cv::Size size(level.across.length, level.down.length);
  const bool at_the_end = (window & cv::Rect(1, 1, size.width - 2, size.height - 2)) != window;
  level.cells[row % 2].push_back({col, row, block, window, side, at_the_end});
  level.pad_before = std::max({level.pad_before, side - window.br().x, side - window.br().y});
  level.pad_behind = std::max({level.pad_behind, window.x + side - size.width, window.y + side - size.height});
  if (level.plans.count(side) == 0) level.plans.emplace(side, make_plan(side, loops_.largest_radix, level_index));
}

void PlaneFilter::cut_cells(const FilterGrid& grid, const std::vector<int>& blocks) {
  for (Level& level : levels_) {
    for (std::vector<Cell>& cells : level.cells) cells.clear();
    level.pad_before = level.pad_behind = 0;
    level.around.assign(grid.blocks.size(), 0);
  }
  Level& whole = levels_[WHOLE];
  cut(grid.x, whole.across);
  cut(grid.y, whole.down);
  halve_axis(whole.across, levels_[HALF].across);
  halve_axis(whole.down, levels_[HALF].down);
  for (const int block : blocks) {
    const int block_col = block % grid.cols(), block_row = block / grid.cols();
    const float extent_px = extent_of(grid.blocks[block].inverse->path_px).maxCoeff();
    const int level = is_for_half_size(*grid.blocks[block].inverse) ? HALF : WHOLE;
    for (int row = whole.down.first_of_block[block_row]; row < whole.down.first_of_block[block_row + 1]; ++row) {
      for (int col = whole.across.first_of_block[block_col]; col < whole.across.first_of_block[block_col + 1]; ++col) {
        add_cell(col, row, block, level == HALF ? 0.5f * extent_px : extent_px, level);
      }
    }
    for_each_around(block, grid, [&](int neighbour) { ++levels_[level].around[neighbour]; });
  }
}

PlaneFilter::Plan PlaneFilter::make_plan(int size, int largest_radix, int level) {
  Plan plan{FourierPlan(size, largest_radix), {}};
  plan.band.gain.assign(size / 2, 1.0f);
  plan.band.again.assign(size / 2, 1.0f);
  for (int k = 0; level == HALF && k < size / 2; ++k) {
    const double f = 0.5 * k / size, left = left_by_halving(f);
    const double s = std::sin(0.5 * CV_PI * std::clamp((kEndsAt - f) / (kEndsAt - kFallsFrom), 0.0, 1.0));
    plan.band.again[k] = static_cast<float>(s * s);
    plan.band.gain[k] = static_cast<float>(s * s / (left * left));
  }
  return plan;
}

void PlaneFilter::clear_sums(const FilterGrid& grid, int threads, Level& level) {
  const cv::Size size(level.across.length, level.down.length);
  for (const int odd : {0, 1}) {
    for (cv::Mat& sums : level.sums[odd]) sums.create(size, CV_32F);
    if (!are_ones_) level.weights[odd].create(size, CV_32F);
  }
  // Windows end in blocks with a cell beside them, and these look so far beyond themselves (margins, and at half the
  // size the low pass), which is into the next ones where all but those at the edges are as long.
  constexpr int kLooksPx = 10;
  const auto are_long = [](const std::vector<int>& borders) {
    for (std::size_t i = 2; i + 1 < borders.size(); ++i) {
      if (borders[i] - borders[i - 1] < kLooksPx) return false;
    }
    return true;
  };
  std::vector<char> is_seen(grid.blocks.size(), are_long(grid.x) && are_long(grid.y) ? 0 : 1);
  for (int block = 0; block < static_cast<int>(grid.blocks.size()); ++block) {
    if (level.around[block] == 0) continue;
    for_each_around(block, grid, [&](int neighbour) { is_seen[neighbour] = 1; });
  }
  const int shrink = &level == &levels_[HALF] ? 2 : 1;
  const auto border = [shrink](const std::vector<int>& borders, int i, int length) {
    return i + 1 == static_cast<int>(borders.size()) ? length : borders[i] / shrink;
  };
  run_parallel(grid.rows(), threads, 1, [&](int row) {
    const char* seen = is_seen.data() + static_cast<std::ptrdiff_t>(row) * grid.cols();
    const int begin_y = border(grid.y, row, size.height), end_y = border(grid.y, row + 1, size.height);
    for (int col = 0, end_col; col < grid.cols(); col = end_col) {
      end_col = col + 1;
      while (end_col < grid.cols() && seen[end_col] == seen[col]) ++end_col;
      if (!seen[col]) continue;
      const int begin_x = border(grid.x, col, size.width), end_x = border(grid.x, end_col, size.width);
      const auto clear = [&](cv::Mat& sums) {
        for (int y = begin_y; y < end_y; ++y) std::fill_n(sums.ptr<float>(y) + begin_x, end_x - begin_x, 0.0f);
      };
      for (const int odd : {0, 1}) {
        for (cv::Mat& sums : level.sums[odd]) clear(sums);
        if (!are_ones_) clear(level.weights[odd]);
      }
    }
  });
}

void PlaneFilter::prepare_levels(const cv::Mat& src, const FilterGrid& grid, int threads) {
  cv::split(src, channels_);
  for (Level& level : levels_) {
    if (!level.is_used()) continue;
    const bool is_half = &level == &levels_[HALF];
    level.padded.resize(channels_.size());
    for (std::size_t channel = 0; channel < channels_.size(); ++channel) {
      if (is_half) halve(channels_[channel], threads, half_);
      cv::copyMakeBorder(is_half ? half_ : channels_[channel], level.padded[channel], level.pad_before,
                         level.pad_behind, level.pad_before, level.pad_behind, cv::BORDER_REPLICATE);
    }
    for (std::vector<cv::Mat>& sums : level.sums) sums.resize(channels_.size());
    clear_sums(grid, threads, level);
  }
}

float* PlaneFilter::floats_in(std::vector<CacheLine>& lines, int count) {
  constexpr int kLineFloats = sizeof(CacheLine) / sizeof(float);
  lines.resize(std::max<std::size_t>(lines.size(), count / kLineFloats));
  return lines.data()->floats;
}

template <typename Pixel>
void PlaneFilter::load_tile(const cv::Mat& padded, const Level& level, const Cell& cell, Scratch& scratch,
                            float* tile) {
  const cv::Rect& window = cell.window;
  const int size = cell.size, stride = fourier_stride(size);
  const auto load_row = [&](int y, float* to) {
    const Pixel* from = padded.ptr<Pixel>(window.y + y + level.pad_before) + window.x + level.pad_before;
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

void PlaneFilter::continue_tile(const Level& level, const Cell& cell, const FourierStages& plan, Scratch& scratch,
                                float* tile) const {
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
  find_inside(cell.window.x, cell.window.width, level.across.length, scratch.fade_x, scratch.inside_x);
  find_inside(cell.window.y, cell.window.height, level.down.length, scratch.fade_y, scratch.inside_y);
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
void PlaneFilter::filter_cell(const Cell& cell, const PlaneInverse& inverse, Level& level, Scratch& scratch) const {
  const Plan& plan_of_size = level.plans.at(cell.size);
  const FourierStages plan = plan_of_size.transform.stages();
  const cv::Rect& window = cell.window;
  const int size = cell.size, stride = fourier_stride(size), channels = static_cast<int>(level.padded.size());
  float* tiles = floats_in(scratch.tiles, channels * size * stride);
  float* transform = floats_in(scratch.transform, fourier_scratch(size));
  float* gain = floats_in(scratch.gain_rows, 2 * loops_.lanes * size);
  scratch.row.resize(std::max<std::size_t>(scratch.row.size(), size));
  make_ramp(size - window.width, scratch.fade_x);
  make_ramp(size - window.height, scratch.fade_y);
  scratch.gain.set(inverse, plan, plan_of_size.band);
  for (int channel = 0; channel < channels; ++channel) {
    float* tile = tiles + channel * size * stride;
    load_tile<Pixel>(level.padded[channel], level, cell, scratch, tile);
    if (cell.at_the_end) continue_tile(level, cell, plan, scratch, tile);
    loops_.transform_columns(plan, tile, transform);
  }
  for (int row = 0; row < size / 2; row += loops_.lanes) {
    scratch.gain.rows(row, gain);
    for (int channel = 0; channel < channels; ++channel) {
      loops_.filter_rows(plan, row, gain, 0, window.width, tiles + channel * size * stride, transform);
    }
  }
  const float *weights_x = level.across.weights[cell.col].data(), *weights_y = level.down.weights[cell.row].data();
  for (int channel = 0; channel < channels; ++channel) {
    float* tile = tiles + channel * size * stride;
    loops_.restore_columns(plan, 0, window.width, tile, transform);
    for (int y = 0; y < window.height; ++y) {
      const float* from = tile + y * stride;
      float* sums = level.sums[cell.col % 2][channel].ptr<float>(window.y + y) + window.x;
#pragma omp simd
      for (int x = 0; x < window.width; ++x) sums[x] += from[x] * (weights_x[x] * weights_y[y]);
    }
  }
  if (are_ones_) return;
  for (int y = 0; y < window.height; ++y) {
    float* weights = level.weights[cell.col % 2].ptr<float>(window.y + y) + window.x;
    for (int x = 0; x < window.width; ++x) weights[x] += weights_x[x] * weights_y[y];
  }
}

bool PlaneFilter::are_ones_on(int block, const FilterGrid& grid) const {
  const int col = block % grid.cols(), row = block / grid.cols();
  const int cols = std::min(col + 2, grid.cols()) - std::max(col - 1, 0);
  const int rows = std::min(row + 2, grid.rows()) - std::max(row - 1, 0);
  return std::max(levels_[WHOLE].around[block], levels_[HALF].around[block]) == cols * rows;
}

void PlaneFilter::gather(int block, const cv::Rect& rect, int channel, bool are_ones, Scratch& scratch) const {
  const std::size_t area = static_cast<std::size_t>(rect.area());
  std::vector<float>&values = scratch.values, &weights = scratch.weights;
  values.assign(area, 0);
  if (!are_ones) weights.assign(area, 0);
  const auto add = [&](int level, const cv::Mat& even, const cv::Mat& odd, std::vector<float>& to) {
    if (level == HALF) {
      scratch.doubled.resize(area);
      double_sum(even, odd, rect, scratch.of_doubling, scratch.doubled.data());
      for (std::size_t i = 0; i < area; ++i) to[i] += scratch.doubled[i];
      return;
    }
    for (int y = 0; y < rect.height; ++y) {
      const float *a = even.ptr<float>(rect.y + y) + rect.x, *b = odd.ptr<float>(rect.y + y) + rect.x;
      float* row = to.data() + static_cast<std::ptrdiff_t>(y) * rect.width;
#pragma omp simd
      for (int x = 0; x < rect.width; ++x) row[x] += a[x] + b[x];
    }
  };
  for (const int i : {WHOLE, HALF}) {
    const Level& level = levels_[i];
    if (level.around[block] == 0) continue;
    add(i, level.sums[0][channel], level.sums[1][channel], values);
    if (!are_ones) add(i, level.weights[0], level.weights[1], weights);
  }
}

template <typename Pixel>
void PlaneFilter::deliver(int block, const FilterGrid& grid, SeamBlender& seams, Scratch& scratch, cv::Mat& dst) const {
  const bool are_ones = are_ones_on(block, grid);
  constexpr int kMax = std::numeric_limits<Pixel>::max();
  const int channels = static_cast<int>(channels_.size());
  for (const SeamBlender::Part<Pixel>& part : seams.parts<Pixel>(block, dst)) {
    const cv::Rect& rect = part.rect;
    if (rect.empty()) continue;
    for (int channel = 0; channel < channels; ++channel) {
      gather(block, rect, channel, are_ones, scratch);
      const std::size_t area = scratch.values.size();
      // In steps that vectorise each: float to int, int clipped, int to pixel.
      scratch.whole_numbers.resize(area);
      int* numbers = scratch.whole_numbers.data();
      const float *values = scratch.values.data(), *weights = scratch.weights.data();
      if (are_ones) {
#pragma omp simd
        for (std::size_t i = 0; i < area; ++i) numbers[i] = static_cast<int>(values[i] + 0.5f);
      } else {
#pragma omp simd
        for (std::size_t i = 0; i < area; ++i) numbers[i] = static_cast<int>(values[i] / weights[i] + 0.5f);
      }
#pragma omp simd
      for (std::size_t i = 0; i < area; ++i) numbers[i] = std::min(std::max(numbers[i], 0), kMax);
      for (int y = 0; y < rect.height; ++y, numbers += rect.width) {
        Pixel* to = part.to + y * part.stride + channel;
        for (int x = 0; x < rect.width; ++x) to[x * channels] = static_cast<Pixel>(numbers[x]);
      }
    }
  }
}

template <typename Pixel>
void PlaneFilter::filter_as(const cv::Mat& src, const FilterGrid& grid, const std::vector<int>& blocks, int threads,
                            SeamBlender& seams, cv::Mat& dst) {
  cut_cells(grid, blocks);
  are_ones_ = blocks.size() == grid.blocks.size() && levels_[WHOLE].is_used() != levels_[HALF].is_used();
  prepare_levels(src, grid, threads);
  const PlaneGainLoops& gain_loops = *find_plane_gain_loops(loops_.name);
  while (static_cast<int>(scratch_.size()) < threads) scratch_.emplace_back(gain_loops);
  for (const int odd : {0, 1}) {
    const std::vector<Cell>&of_whole = levels_[WHOLE].cells[odd], &of_half = levels_[HALF].cells[odd];
    const int wholes = static_cast<int>(of_whole.size()), halves = static_cast<int>(of_half.size());
    run_parallel(wholes + halves, threads, 1, [&](int i, int thread) {
      if (i < wholes) {
        const PlaneInverse& inverse = *grid.blocks[of_whole[i].block].inverse;
        filter_cell<Pixel>(of_whole[i], inverse, levels_[WHOLE], scratch_[thread]);
      } else {
        const Cell& cell = of_half[i - wholes];
        filter_cell<float>(cell, at_half_size(*grid.blocks[cell.block].inverse), levels_[HALF], scratch_[thread]);
      }
    });
  }
  constexpr int kBlocksAtATime = 16;
  run_parallel(static_cast<int>(blocks.size()), threads, kBlocksAtATime,
               [&](int i, int thread) { deliver<Pixel>(blocks[i], grid, seams, scratch_[thread], dst); });
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
