// Rejects the blocks that contradict their predicted blur, by likelihood or gradient.
#include "blur/blur_validation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"
#include "blur/blur_likelihood.hpp"
#include "blur/image_noise.hpp"
#include "blur/path_1d.hpp"

namespace gyro_deblur {
namespace {

/// For each pixel of a row the larger one of `strongest` and |gx dx + gy dy|, with the Sobel pair (gx, gy) in grey
/// levels times 8.
/// @param above, here, below  from the pixel left of the first one on
void strongest_of_row(const std::uint8_t* above, const std::uint8_t* here, const std::uint8_t* below, int width,
                      float dx, float dy, float* strongest) {
  for (int x = 0; x < width; ++x) {
    // 16 bits hold it, and the loop takes a quarter less time than with 32.
    const auto gx =
        static_cast<std::int16_t>(above[x + 2] - above[x] + 2 * (here[x + 2] - here[x]) + below[x + 2] - below[x]);
    const auto gy = static_cast<std::int16_t>(below[x] - above[x] + 2 * (below[x + 1] - above[x + 1]) + below[x + 2] -
                                              above[x + 2]);
    const float along = std::abs(dx * gx + dy * gy);
    strongest[x] = strongest[x] < along ? along : strongest[x];
  }
}

/// Ratio of REJECTED to DEBLURRED blocks above which the prediction is wrong for the whole frame. Of truly blurred
/// blocks 1.4 % are rejected, of sharp ones 68 % or more (see ValidationOptions).
constexpr std::size_t kOutvotingFactor = 4;

/// Rejects DEBLURRED blocks of whose neighbours, as far as they were validated, more than half are REJECTED. A block
/// with little texture along the motion passes whatever its blur; what makes a prediction wrong (translation, a wrong
/// extrinsic) is wrong for its neighbours too.
FrameBlur reject_outvoted(const FrameBlur& validated) {
  FrameBlur field = validated;
  for (int i = 0; i < validated.grid.size(); ++i) {
    if (validated.blocks[i].status != BlockStatus::DEBLURRED) continue;
    int rejected = 0, deblurred = 0;
    validated.grid.for_each_around(i, [&](int other) {
      const BlockStatus status = validated.blocks[other].status;
      rejected += status == BlockStatus::REJECTED ? 1 : 0;
      deblurred += status == BlockStatus::DEBLURRED && other != i ? 1 : 0;
    });
    if (rejected > deblurred) field.blocks[i].status = BlockStatus::REJECTED;
  }
  // Hardly any prediction of the frame holds: neither do those that nothing contradicts.
  if (field.count(BlockStatus::REJECTED) > kOutvotingFactor * field.count(BlockStatus::DEBLURRED)) field.reject_all();
  return field;
}

FrameBlur validate_by_gradient(const FrameBlur& field, const cv::Mat& luminance, const ValidationOptions& options,
                               int threads) {
  FrameBlur validated = field;
  constexpr int kBlocksAtATime = 8;
  parallel_for(field.grid.size(), threads, kBlocksAtATime, [&](int i) {
    BlockBlur& block = validated.blocks[i];
    if (block.status != BlockStatus::DEBLURRED) return;
    if (max_gradient_along(luminance, field.grid.rect(i), block.angle_rad) >
        options.threshold(steepest_box_px(block))) {
      block.status = BlockStatus::REJECTED;
    }
  });
  return reject_outvoted(validated);
}

/// Log likelihood ratio, neighbours and frame included, below which a block is rejected. Of blocks with a wrong
/// prediction that share exceeds it: a fit to measured quantiles (doc/reports/validation.md), within 5 from .1 to .01.
/// The default is below 0, which accepts blocks without evidence. Deblurring them gains nothing, but their keypoints
/// lie where the prediction puts them, which mostly holds.
double least_log_ratio(double false_accept_rate) { return 14 * std::log(0.025 / false_accept_rate); }

/// Shorter blur changes a spectrum little; an edge that is sharper than it may be is better evidence. Noise does not
/// come near what so short a blur allows.
constexpr double kShortPx = 5;

FrameBlur validate_by_likelihood(const FrameBlur& field, const cv::Mat& luminance, const ValidationOptions& options,
                                 int threads, std::optional<double> noise) {
  if (!noise) noise = image_noise(luminance, PixelLayout::GRAY, 8, 1, {}, threads);
  const BlurLikelihood likelihood(luminance, noise.value_or(0), threads);
  const std::vector<double> ratios = with_neighbours(field.grid, log_ratios(field, likelihood, threads));
  const double least = least_log_ratio(options.false_accept_rate);
  FrameBlur validated = field, brief = field;
  for (int i = 0; i < field.grid.size(); ++i) {
    if (field.blocks[i].status != BlockStatus::DEBLURRED) continue;
    if (ratios[i] < least) validated.blocks[i].status = BlockStatus::REJECTED;
    if (field.blocks[i].extent_px >= kShortPx) brief.blocks[i].status = BlockStatus::SHARP;
  }
  if (brief.count(BlockStatus::DEBLURRED) == 0) return validated;
  brief = validate_by_gradient(brief, likelihood.without_outliers(), options, threads);
  for (int i = 0; i < field.grid.size(); ++i) {
    if (brief.blocks[i].status == BlockStatus::REJECTED) validated.blocks[i].status = BlockStatus::REJECTED;
  }
  return validated;
}

}  // namespace

float max_gradient_along(const cv::Mat& luminance, const cv::Rect& block, double angle_rad) {
  constexpr double kSobelScale = 1.0 / 8;  // the Sobel pair sums to 8 on a ramp of one grey level a pixel
  const auto dx = static_cast<float>(kSobelScale * std::cos(angle_rad));
  const auto dy = static_cast<float>(kSobelScale * std::sin(angle_rad));
  thread_local cv::Mat around;  // the block and the pixels next to it, replicated beyond the image
  cv::copyMakeBorder(luminance(block), around, 1, 1, 1, 1, cv::BORDER_REPLICATE);
  thread_local std::vector<float> strongest;  // of each column: such a loop vectorises
  strongest.assign(block.width, 0);
  for (int y = 0; y < block.height; ++y) {
    strongest_of_row(around.ptr<std::uint8_t>(y), around.ptr<std::uint8_t>(y + 1), around.ptr<std::uint8_t>(y + 2),
                     block.width, dx, dy, strongest.data());
  }
  return *std::max_element(strongest.begin(), strongest.end());
}

double steepest_box_px(const BlockBlur& blur) {
  if (!blur.nonuniform_path_px) return blur.extent_px;
  // The Sobel pair measures a step over two pixels; a box of r px reduces it to 2 / r of its height there.
  constexpr double kWindowPx = 2;
  double most = 0;
  for (const double place_px : *blur.nonuniform_path_px) {
    // The share of the exposure spent in a window is largest where the window begins or ends at a place.
    most = std::max({most, share_within(*blur.nonuniform_path_px, place_px, place_px + kWindowPx),
                     share_within(*blur.nonuniform_path_px, place_px - kWindowPx, place_px)});
  }
  return std::min<double>(blur.extent_px, kWindowPx / most);
}

FrameBlur validate_blur_field(const FrameBlur& field, const cv::Mat& luminance, const ValidationOptions& options,
                              int threads, std::optional<double> noise_grey_levels) {
  options.validate();
  field.grid.require_luminance(luminance, "validation");
  if (options.rule == ValidationRule::NONE) return field;
  return options.rule == ValidationRule::GRADIENT
             ? validate_by_gradient(field, luminance, options, threads)
             : validate_by_likelihood(field, luminance, options, threads, noise_grey_levels);
}

}  // namespace gyro_deblur
