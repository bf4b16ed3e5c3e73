// The exposure time of the images of a recording, from their blur.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"
#include "pipeline/exposure_choice.hpp"

namespace gyro_deblur {

/// Estimate from one image.
struct ImageExposure {
  TimeNs stamp_ns = 0;
  std::optional<TimeNs> given_ns;             ///< by a message
  std::optional<TimeNs> estimate_ns;          ///< by the blur of this image alone
  double log_stddev = 0;                      ///< of the natural logarithm of estimate_ns
  double extent_px = 0;                       ///< median over the blocks, of the exposure in use
  std::optional<TimeNs> filtered_ns;          ///< by this image and those before it
  ExposureNeed need = ExposureNeed::NOTHING;  ///< what it lacks, where it has no estimate
};

/// Median power along the motion where the product of frequency and extent is `waves`, and that of a straight path at
/// uniform speed, whose zeros are at whole numbers. Natural logarithms; 0 on the mean of the first lobe.
struct ExposureSpectrumPoint {
  double waves = 0;
  double log_power = 0;
  double log_of_path = 0;
  std::size_t count = 0;  ///< of the windows behind it
};

/// Estimate from all images of a recording.
struct RecordedExposure {
  std::vector<ImageExposure> images;
  std::size_t estimates = 0;  ///< images that have one
  bool is_known = false;
  TimeNs exposure_ns = 0;  ///< median, where it is known
  double log_stddev = 0;   ///< of the natural logarithm of exposure_ns, where it does not vary
  bool varies = false;     ///< from image to image; then from low_ns to high_ns, for eight of ten
  TimeNs low_ns = 0, high_ns = 0;
  ExposureNeed missing = ExposureNeed::NOTHING;  ///< of most images, where it is not known
  TimeNs longest_tried_ns = 0;                   ///< no longer exposure would have been found
  TimeNs frame_interval_ns = 0;                  ///< median; 0: fewer than two images
  /// Median ratio of the images' exposures to those of messages, and the logarithm's standard deviation; nothing where
  /// too few images have both.
  std::optional<ExposureEstimate> over_given;
  std::vector<ExposureSpectrumPoint> spectrum;

  /// That of an image whose exposure is not given; 0: not known.
  TimeNs exposure_of(TimeNs stamp_ns) const;
};

/// Whether an estimate contradicts a given exposure, by a ratio that matters and beyond its uncertainty.
/// @param over_given  estimated over given exposure
bool contradicts(const ExposureEstimate& over_given);

/// Looks at one image after the other, as the pipeline does while the camera is in use: the blur of optical flow and
/// gyroscope is compared with the spectra, and estimates are filtered by ExposureChoice. Not thread-safe.
class RecordedExposureEstimator {
 public:
  /// @param shutter   readout, and the row that stamps refer to; exposure and phase are not used
  /// @param pipeline  significant_bits and threads are used
  /// @param motion    nothing: the motion follows from the images alone
  /// Throws OptionError.
  RecordedExposureEstimator(const CameraCalibration& camera, const ShutterTiming& shutter,
                            const PipelineOptions& pipeline, std::optional<RotationTrack> motion);

  /// @param stamp_ns   in ascending order
  /// @param middle_ns  of the exposure of the row that the stamp refers to: the motion is known there, whatever the
  ///                   exposure is
  /// @param image      CV_8U or CV_16U that fits `layout`, of the camera's size
  /// @param given_ns   exposure by this image's message
  /// Throws std::invalid_argument when the image does not fit.
  void add(TimeNs stamp_ns, TimeNs middle_ns, const cv::Mat& image, PixelLayout layout,
           const std::optional<TimeNs>& given_ns);

  RecordedExposure result() const;

 private:
  void add_spectra(const FrameBlur& field, const cv::Mat& luminance);

  ShutterTiming shutter_;
  Pipeline pipeline_;
  ExposureChoice choice_;
  FramePeriod period_;
  RotationTrack motion_;
  bool without_gyro_;
  std::vector<ImageExposure> images_;
  TimeNs longest_tried_ns_ = 0;
  std::vector<std::vector<float>> log_powers_;  // by waves
  int spectra_images_ = 0;
};

}  // namespace gyro_deblur
