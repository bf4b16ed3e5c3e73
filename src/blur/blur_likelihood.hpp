// Validation by likelihood: how much better a block's power spectrum fits the predicted blur than less blur.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "blur/noisy_image.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

struct PathPhases;

/// Phases of a path times `scale`, for SpectrumSimd::multiply_path_gain.
PathPhases phases_of(const Path2d& path_px, double scale);

/// One image, made ready for the likelihood of many blurs.
class BlurLikelihood {
 public:
  /// @param luminance          CV_8UC1; is copied
  /// @param noise_grey_levels  standard deviation of its noise, >= 0; 15 % too much or too little costs little
  /// @param threads            at most; 0: one for each core
  BlurLikelihood(const cv::Mat& luminance, double noise_grey_levels, int threads = 0);

  /// Natural logarithm of the likelihood of `blur` over the mean likelihood of less blur, from the power spectrum of a
  /// window around the block (doc/design/validation.md). 0, no evidence, where no window fits into the image.
  /// @param block  inside the image
  double log_ratio(const cv::Rect& block, const BlockBlur& blur) const;

  /// Side [px] of the part of the image that log_ratio() looks at.
  int window_px(double extent_px) const;

  /// The luminance, its pixels limited to what their neighbours and the noise allow: hot ones are gone.
  const cv::Mat& without_outliers() const { return levels_.front().pixels; }

 private:
  int level_of(double extent_px) const;

  std::vector<NoisyImage> levels_;  // the image, and halves of its size
};

/// BlurLikelihood::log_ratio of every DEBLURRED block, row by row, 0 for the others. Where windows overlap because they
/// are larger than blocks, only some blocks are compared; the others have the mean of those around them, each limited.
std::vector<double> log_ratios(const FrameBlur& field, const BlurLikelihood& likelihood, int threads = 0);

/// Sum of a block's log ratio and, each limited, those of its eight neighbours and of the frame: these decide for a
/// block with little texture; a block with much decides for itself (doc/design/validation.md).
std::vector<double> with_neighbours(const BlockGrid& grid, const std::vector<double>& log_ratios);

}  // namespace gyro_deblur
