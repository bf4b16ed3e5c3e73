// How long a camera may expose while it moves as it does, so that its blur can still be undone well.
#pragma once

#include <optional>

#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/frame_quality.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// What the variance of an image's noise consists of, and how each part of noise over contrast depends on the exposure
/// t, the scene's light and the lens left alone, whether the camera keeps its images as bright by its gain or not. In
/// the linear camera model of EMVA 1288 the signal grows with t, the variance of light's own noise with t as well, and
/// that of reading does not grow. Shares >= 0 that sum to 1.
struct NoiseShares {
  double photons = 1;   ///< variance over contrast squared falls as 1 / t
  double reading = 0;   ///< as 1 / t^2
  double constant = 0;  ///< not at all
};

/// What an advice is found by: the motion and noise of an image.
struct ExposureTerms {
  double speed_px_s = 0;         ///< >= 0; how fast what half of the pixels show moves at most
  TimeNs exposure_ns = 0;        ///< > 0, of the image
  double noise_to_contrast = 0;  ///< > 0, in the image, see noise_to_contrast()
  NoiseShares noise;             ///< of that
  BlurFieldOptions blur_field;   ///< which extents are deblurred
};

/// Of an image; nothing where its motion, noise or contrast are not known.
/// @param quality  of the field
/// @param noise    the sensor's, where it is known: tells which part of the noise is light's own. Else all of it is
///                 taken for that, as in all but the darkest images
std::optional<ExposureTerms> exposure_terms(const FrameBlur& field, const FrameQuality& quality,
                                            const BlurFieldOptions& options, const NoiseModel& noise);

/// Share of an image's corners that can be expected where they would be without blur, had it been exposed for so long:
/// expected_repeatability() of blur that grows with the exposure, deblurred where that is worth it, and noise that
/// falls.
/// @param exposure_ns  > 0
/// @return in [0, 1]
double expected_repeatability_at(const ExposureTerms& terms, TimeNs exposure_ns);

struct ExposureAdvice {
  TimeNs best_ns = 0;     ///< exposure at which most corners can be expected
  TimeNs longest_ns = 0;  ///< the longest one at which three quarters of those can
  double best_share = 0;  ///< expected_repeatability_at(best_ns)
};

/// The longest exposure whose blur can still be undone well. Deblurred images have at most four fifths of the corners
/// of sharp ones with the same noise, so that three quarters of the most that any exposure gives is well, and not so
/// near the maximum that only images without blur were.
/// @param limit_ns  > 0; no longer exposures are considered: the frame period
/// @return nothing where images are POOR at any exposure
std::optional<ExposureAdvice> advise_exposure(const ExposureTerms& terms, TimeNs limit_ns);

}  // namespace gyro_deblur
