// Quality of an image for feature detection, as a whole and by pixel.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>

#include "base/median.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/pixel_mask.hpp"

namespace gyro_deblur {

/// Values equal the constants of gyro_deblur/ImageQuality.msg.
enum class QualityGrade : std::uint8_t {
  SHARP = 0,             ///< nearly all of the input is sharp
  DEBLURRED = 1,         ///< nearly all of it is sharp or deblurred
  PARTLY_DEBLURRED = 2,  ///< part of it stays blurred
  POOR = 3,              ///< few corners can be expected where they would be without blur
  UNKNOWN = 4,           ///< its blur is not known
};

/// Name of the grade, e.g. "PARTLY_DEBLURRED". Never null.
const char* to_string(QualityGrade grade);

/// Images with a score below it are POOR: three of four corners that are found are wrong. ImageQuality.msg says so.
constexpr double kPoorScore = 0.25;

/// Median and 95th percentile of the blocks' extents [px].
struct ExtentSpread {
  double median_px = 0, p95_px = 0;
};

/// An image after validation and deblurring. Blocks count by their pixels, MASKED ones in `shares` alone.
struct FrameQuality {
  QualityGrade grade = QualityGrade::UNKNOWN;
  /// [0, 1], the mean of expected_repeatability() of all blocks; nothing: not known.
  std::optional<double> score;
  ExtentSpread before;          ///< of the blur that arrived, of blocks whose blur is known; 0 when there are none
  ExtentSpread after;           ///< of what was left of it: nothing of a DEBLURRED block's
  std::optional<double> noise;  ///< [grey levels of 8 bits]; nothing: not known
  double contrast = 0;          ///< the same; 0: not known
  std::array<double, kBlockStatuses.size()> shares{};  ///< [0, 1] of the pixels, by status

  double share(BlockStatus status) const { return shares[static_cast<std::size_t>(status)]; }
};

/// Share of the corners found in a block that are also found, within 2 px, in a sharp image of the same light: of
/// Shi-Tomasi corners, the 500 strongest of each image. Fitted to experiments/image_quality, see
/// doc/reports/image_quality.md.
/// @param noise_to_contrast  of the image, >= 0; see noise_to_contrast()
/// @return in [0, 1]; nothing for a block whose blur is not known (NO_GYRO, MASKED)
std::optional<double> expected_repeatability(const BlockBlur& block, double noise_to_contrast);

/// Noise over contrast without noise, in [0, 1]; 0 if one of them is not known.
double noise_to_contrast(const FrameBlur& field);

/// @param field  validated
FrameQuality assess_quality(const FrameBlur& field);

/// Median extent of the blocks for which keep(status) is true [px]; 0 when there are none.
template <typename Keep>
double median_extent_px(const FrameBlur& field, Keep keep) {
  std::vector<float> extents_px;
  for (const BlockBlur& block : field.blocks) {
    if (keep(block.status)) extents_px.push_back(block.extent_px);
  }
  return median(std::move(extents_px));
}

/// CV_8UC1 of the field's size: 255 where the image is sharp or restored, 0 where it is not, or nothing is known of it.
/// A deblurred pixel is restored where all that its blur has mixed is inside the image. Masked pixels have 0.
/// @param field          validated
/// @param mask_of_input  empty, or of the field's size
cv::Mat trust_mask(const FrameBlur& field, const PixelMask& mask_of_input = {});

}  // namespace gyro_deblur
