// Advice on the longest exposure time whose blur can still be removed well at the camera's present motion.
#pragma once

#include <optional>

#include "blur/frame_quality.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Parts of the variance of an image's noise, by how they fall with the exposure time t at constant light (linear
/// camera model of EMVA 1288): variance over squared contrast. Shares >= 0 that sum to 1.
struct NoiseShares {
  double photons = 1;   ///< photon noise, falls as 1 / t
  double reading = 0;   ///< read noise, falls as 1 / t^2
  double constant = 0;  ///< does not fall
};

/// Motion and noise of an image, from which the advice is computed.
struct ExposureTerms {
  double speed_px_s = 0;         ///< median speed of the image's pixels, >= 0
  TimeNs exposure_ns = 0;        ///< exposure time of the image, > 0
  double noise_to_contrast = 0;  ///< > 0, see noise_to_contrast()
  NoiseShares noise;             ///< parts of that noise
  BlurFieldOptions blur_field;   ///< which extents are deblurred
};

/// Terms of an image; nothing if its motion, noise or contrast is not known. All noise is taken for photon noise.
/// @param quality  of the field
std::optional<ExposureTerms> exposure_terms(const FrameBlur& field, const FrameQuality& quality,
                                            const BlurFieldOptions& options);

/// Expected share of an image's corners that are where they would be without blur, at another exposure time:
/// expected_repeatability() with blur that grows and noise that falls with the exposure time.
/// @param exposure_ns  > 0
/// @return in [0, 1]
double expected_repeatability_at(const ExposureTerms& terms, TimeNs exposure_ns);

/// Result of advise_exposure().
struct ExposureAdvice {
  TimeNs best_ns = 0;     ///< exposure time with most expected corners
  TimeNs longest_ns = 0;  ///< longest exposure time with three quarters of those
  double best_share = 0;  ///< expected_repeatability_at(best_ns)
};

/// The longest exposure time whose blur can still be removed well (doc/reports/image_quality.md#the-longest-exposure).
/// @param limit_ns  longest exposure time that is considered, > 0: the frame period
/// @return nothing if images are POOR at any exposure time
std::optional<ExposureAdvice> advise_exposure(const ExposureTerms& terms, TimeNs limit_ns);

}  // namespace gyro_deblur
