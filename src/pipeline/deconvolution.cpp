// Chooses a filter for each block and deblurs an image with an engine.
#include "pipeline/deconvolution.hpp"

#include <algorithm>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "base/parallel.hpp"
#include "blur/block_texture.hpp"
#include "blur/image_noise.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {
namespace {

// Rounding error [px] of places within a path of 500 px, as floats.
constexpr double kRounding = 1e-3;

/// The inverse of a non-uniform path whose lengths count `scale` times; null where that is no blur.
std::shared_ptr<const LineKernel> nonuniform_kernel(Path1d path_px, double scale, int ratio_doublings,
                                                    const FilterOptions& options) {
  for (float& place_px : path_px) place_px *= static_cast<float>(scale);
  // Not blur.extent_px: rounded on its own, it may lie on the other side of a limit.
  const double extent_px = extent_of(path_px);
  if (extent_px < kMinKernelExtentPx) return nullptr;
  if (extent_px > kMaxKernelExtentPx) {
    for (float& place_px : path_px) place_px *= static_cast<float>((kMaxKernelExtentPx - kRounding) / extent_px);
  }
  return std::make_shared<const LineKernel>(wiener_kernel(path_px, with_doubled_ratio(options, ratio_doublings)));
}

/// The whole path of a block, centred if its filter is that of a box.
Path2d path_2d(const BlockBlur& blur) {
  if (blur.curved_path_px) return *blur.curved_path_px;
  const Eigen::Vector2f line(std::cos(blur.angle_rad), std::sin(blur.angle_rad));
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const float even_px = (static_cast<float>(k) / (kPathInstants - 1) - 0.5f) * blur.extent_px;
    path_px[k] = line * (blur.nonuniform_path_px ? (*blur.nonuniform_path_px)[k] : even_px);
  }
  return path_px;
}

/// A grid without borders: the filters of a field whose lengths count `scale` times.
FilterGrid make_filters(const FrameBlur& field, double scale, const FilterBank& bank, int threads, bool in_2d) {
  const std::size_t blocks = field.blocks.size();
  FilterGrid made{{}, {}, std::vector<BlockFilter>(blocks), std::vector<std::shared_ptr<const void>>(blocks)};
  constexpr int kBlocksAtATime = 16;
  parallel_for(static_cast<int>(blocks), threads, kBlocksAtATime, [&](int i) {
    const BlockBlur& blur = field.blocks[i];
    if (blur.status != BlockStatus::DEBLURRED) return;
    const double extent_px = blur.extent_px * scale;
    // With half of the pixels a line's power is half as dense, at half of the frequencies.
    const bool by_noise = bank.options().regularization == Regularization::ADAPTIVE;
    const double noise_to_texture = by_noise ? blur.noise_to_texture * scale : 0;
    const int doublings = noise_to_texture > 0 ? bank.choose(extent_px, noise_to_texture).ratio_doublings : 0;
    BlockFilter& filter = made.blocks[i];
    filter.angle_rad = blur.angle_rad;
    if (blur.curved_path_px || in_2d) {
      Path2d path_px = path_2d(blur);
      for (Eigen::Vector2f& place_px : path_px) place_px *= static_cast<float>(scale);
      if (extent_px < kMinKernelExtentPx) return;
      const auto inverse =
          std::make_shared<const WienerInverse2d>(wiener_inverse_2d(path_px, bank.options(), noise_to_texture));
      filter.inverse = inverse.get();
      made.owned[i] = inverse;
    } else if (blur.nonuniform_path_px) {
      const auto kernel = nonuniform_kernel(*blur.nonuniform_path_px, scale, doublings, bank.options());
      filter.kernel = kernel.get();
      made.owned[i] = kernel;
    } else if (extent_px >= kMinKernelExtentPx) {
      filter.kernel = &bank.kernel(extent_px, doublings);
      __builtin_prefetch(filter.kernel);  // engines read it after all blocks have theirs
    }
  });
  return made;
}

bool filters_anything(const FilterGrid& grid) {
  return std::any_of(grid.blocks.begin(), grid.blocks.end(), [](const BlockFilter& block) { return !block.copies(); });
}

/// Columns, or rows, of a grid: borders, and which block's number each has there.
struct Divisions {
  std::vector<int> borders = {0};
  std::vector<int> indices;

  /// Appends division `index`, which ends at `end`, unless it is empty.
  void add(int index, int end) {
    if (end == borders.back()) return;
    borders.push_back(end);
    indices.push_back(index);
  }
};

/// Filters the four planes of a Bayer mosaic. Each samples the image at every second pixel from (px, py), so direction
/// stays, extent halves, and block borders (even, because block sizes are) fall between samples.
FallbackCounts deconvolve_bayer(const cv::Mat& mosaic, const FrameBlur& field, const FilterBank& bank, Engine& engine,
                                int threads, cv::Mat& dst) {
  FallbackCounts slow;
  mosaic.copyTo(dst);
  const std::size_t pixel_bytes = mosaic.elemSize();
  const FilterGrid made = make_filters(field, 0.5, bank, threads, engine.prefers_2d());
  cv::Mat plane, filtered;
  for (int py = 0; py < 2; ++py) {
    for (int px = 0; px < 2; ++px) {
      // Number of samples of this plane before image coordinate x.
      const auto samples_before = [](int x, int phase) { return (x - phase + 1) / 2; };
      const cv::Size size(samples_before(mosaic.cols, px), samples_before(mosaic.rows, py));
      if (size.empty()) continue;

      // The last column and row of blocks may have no sample of this plane.
      const int block_cols = field.grid.cols();
      Divisions cols, rows;
      for (int col = 0; col < block_cols; ++col) cols.add(col, samples_before(field.grid.rect(col).br().x, px));
      for (int row = 0; row < field.grid.rows(); ++row) {
        rows.add(row, samples_before(field.grid.rect(row * block_cols).br().y, py));
      }
      FilterGrid grid{cols.borders, rows.borders, {}};
      for (const int row : rows.indices) {
        for (const int col : cols.indices) grid.blocks.push_back(made.blocks[row * block_cols + col]);
      }
      if (!filters_anything(grid)) continue;

      plane.create(size, mosaic.type());
      for (int y = 0; y < size.height; ++y) {
        const uchar* from = mosaic.ptr(2 * y + py) + px * pixel_bytes;
        uchar* to = plane.ptr(y);
        for (int x = 0; x < size.width; ++x) std::copy_n(from + 2 * x * pixel_bytes, pixel_bytes, to + x * pixel_bytes);
      }
      engine.filter(plane, grid, filtered);
      keep_larger(engine.fallback_counts(), slow);
      for (int y = 0; y < size.height; ++y) {
        const uchar* from = filtered.ptr(y);
        uchar* to = dst.ptr(2 * y + py) + px * pixel_bytes;
        for (int x = 0; x < size.width; ++x) std::copy_n(from + x * pixel_bytes, pixel_bytes, to + 2 * x * pixel_bytes);
      }
    }
  }
  return slow;
}

/// The rectangle, widened to at least `side_px` on each side within the image.
cv::Rect at_least(int side_px, const cv::Rect& rect, const cv::Size& image) {
  const auto widen = [side_px](int& begin, int& length, int limit) {
    const int wanted = std::min(std::max(length, side_px), limit);
    begin = std::clamp(begin - (wanted - length) / 2, 0, limit - wanted);
    length = wanted;
  };
  cv::Rect widened = rect;
  widen(widened.x, widened.width, image.width);
  widen(widened.y, widened.height, image.height);
  return widened;
}

}  // namespace

void adapt_regularization(const cv::Mat& luminance, const FilterBank& bank, FrameBlur& field, int threads,
                          const PixelMask& mask) {
  if (bank.options().regularization != Regularization::ADAPTIVE || !field.noise ||
      field.count(BlockStatus::DEBLURRED) == 0)
    return;
  field.grid.require_luminance(luminance, "regularization: adaptive");
  // A camera that smooths its noise, or compresses its images, leaves more of it in coarser detail than in the finest.
  // Of texture blur of 10 px leaves an eighth or less there (0.25 cycles/px); up to half as much again may be that.
  constexpr double kTextureShare = 1.5, kMinCoarseExtentPx = 10;
  const double found = image_noise(luminance, PixelLayout::GRAY, 8, 2, mask, threads).value_or(0);
  const double coarse = found > kTextureShare * *field.noise ? found : *field.noise;
  constexpr int kBlocksAtATime = 16, kMinSidePx = 32;  // 240 differences: a tenth off
  parallel_for(field.grid.size(), threads, kBlocksAtATime, [&](int i) {
    BlockBlur& block = field.blocks[i];
    if (block.status != BlockStatus::DEBLURRED) return;
    const bool is_short = block.extent_px < kMinCoarseExtentPx;
    const double noise = is_short ? *field.noise : coarse, variance = noise * noise;
    // The luminance of a colour image or a mosaic has less noise than its pixels.
    const double of_luminance = found == 0 ? noise : is_short ? std::min(found, noise) : found;
    const double texture = texture_along_line(luminance, at_least(kMinSidePx, field.grid.rect(i), luminance.size()),
                                              block.angle_rad, block.extent_px, of_luminance * of_luminance);
    // Much of a photograph's texture is in few edges, which stand out from noise more than their power suggests. With a
    // fifth of it photographs gain most, of .1, .2, .35, .6 and 1 (doc/reports/experiments.md, "Noise").
    constexpr double kNoiseWeight = 0.2;
    // Without any texture no filter gains.
    constexpr double kMinTexture = 1e-4;
    block.noise_to_texture = static_cast<float>(kNoiseWeight * variance / std::max(texture, kMinTexture));
    const FilterChoice choice = bank.choose(block.extent_px, block.noise_to_texture);
    block.noise_gain = static_cast<float>(choice.noise_gain);
    if (choice.gain < 0) block.status = BlockStatus::NOISY;
  });
}

FilterGrid make_filter_grid(const FrameBlur& field, const FilterBank& bank, int threads, bool in_2d) {
  const int cols = field.grid.cols();
  FilterGrid grid = make_filters(field, 1.0, bank, threads, in_2d);
  grid.x = grid.y = {0};
  for (int col = 0; col < cols; ++col) grid.x.push_back(field.grid.rect(col).br().x);
  for (int row = 0; row < field.grid.rows(); ++row) grid.y.push_back(field.grid.rect(row * cols).br().y);
  return grid;
}

void prepare_deconvolution(const BlurFieldOptions& options, const FilterBank& bank, Engine& engine, int threads) {
  options.validate();
  // The planes of a mosaic have half the extent.
  const double from_px = std::max(kMinKernelExtentPx, options.min_extent_px / 2);
  const int first = static_cast<int>(from_px / FilterBank::kExtentStepPx);
  const int last =
      static_cast<int>(std::ceil(std::min(options.max_extent_px, kMaxKernelExtentPx) / FilterBank::kExtentStepPx));
  if (engine.prefers_2d()) return;  // it has no use for kernels
  const int doublings = bank.options().regularization == Regularization::ADAPTIVE ? bank.max_doublings() : 0;
  std::vector<const LineKernel*> kernels(std::max(0, last + 1 - first));
  constexpr int kKernelsAtATime = 8;
  parallel_for(static_cast<int>(kernels.size()), threads, kKernelsAtATime, [&](int i) {
    const double extent_px = (first + i) * FilterBank::kExtentStepPx;
    for (int k = 0; k <= doublings; ++k) {
      kernels[i] = &bank.kernel(std::clamp(extent_px, kMinKernelExtentPx, kMaxKernelExtentPx), k);
    }
  });
  engine.prepare(kernels);
}

void keep_larger(const FallbackCounts& of_pass, FallbackCounts& all) {
  for (const auto& [reason, count] : of_pass) {
    std::size_t& most = all[reason];
    most = std::max(most, count);
  }
}

FallbackCounts deconvolve(const cv::Mat& image, PixelLayout layout, const FrameBlur& field, const FilterBank& bank,
                          Engine& engine, cv::Mat& dst, int threads) {
  if (image.cols != field.grid.width_px() || image.rows != field.grid.height_px()) {
    throw std::invalid_argument("image of " + std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                                " px does not fit a blur field of " + std::to_string(field.grid.width_px()) + "x" +
                                std::to_string(field.grid.height_px()) + " px");
  }
  if (image.channels() != channels_of(layout)) {
    throw std::invalid_argument("image has " + std::to_string(image.channels()) + " channels where its layout has " +
                                std::to_string(channels_of(layout)));
  }
  if (field.count(BlockStatus::DEBLURRED) == 0) {
    image.copyTo(dst);
    return {};
  }
  if (is_bayer(layout)) return deconvolve_bayer(image, field, bank, engine, threads, dst);

  const FilterGrid grid = make_filter_grid(field, bank, threads, engine.prefers_2d());
  if (is_yuv422(layout)) {
    cv::Mat luminance, filtered;
    cv::extractChannel(image, luminance, luminance_channel(layout));
    engine.filter(luminance, grid, filtered);
    image.copyTo(dst);
    cv::insertChannel(filtered, dst, luminance_channel(layout));
    return engine.fallback_counts();
  }
  if (image.channels() < 4) {
    engine.filter(image, grid, dst);
    return engine.fallback_counts();
  }
  // Alpha is no light: only the three colours are filtered.
  cv::Mat color(image.size(), CV_MAKETYPE(image.depth(), 3)), filtered;
  const int colors[] = {0, 0, 1, 1, 2, 2};
  cv::mixChannels({image}, {color}, colors, 3);
  engine.filter(color, grid, filtered);
  image.copyTo(dst);
  cv::mixChannels({filtered}, {dst}, colors, 3);
  return engine.fallback_counts();
}

}  // namespace gyro_deblur
