// One image while the stages of a pipeline process it.
#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Replaces a motion that is not known: residual velocities are then the whole motion.
class StationaryCamera : public CameraMotion {
 public:
  bool covers(const TimeRange& range) const override { return !range.empty(); }
  Eigen::Matrix3d rotation(TimeNs, TimeNs) const override { return Eigen::Matrix3d::Identity(); }
};

/// An image, what belongs to it, and what the stages so far have found. Pixels and motion outlive it.
class FrameContext {
 public:
  FrameContext(const cv::Mat& input, PixelLayout pixel_layout, const CameraMotion& gyro_motion,
               const RowExposure& assumed_exposure, const PipelineRequest& pipeline_request)
      : image(input),
        layout(pixel_layout),
        motion(gyro_motion),
        exposure(assumed_exposure),
        request(pipeline_request) {}

  /// CV_8UC1, of the image as it came; made at the first call.
  const cv::Mat& luminance();
  /// Whether the image has its luminance as it is, with the noise that image_noise() finds.
  bool has_own_luminance() const;
  /// What residual velocities are relative to.
  const CameraMotion& known_motion() const;

  const cv::Mat image;
  const PixelLayout layout;
  const CameraMotion& motion;  ///< by the gyroscope
  RowExposure exposure;        ///< the assumed one, from the exposure stage on the one that was found
  const PipelineRequest request;
  bool is_validated = false;    ///< else it is estimated
  bool images_alone = false;    ///< optical flow gives all of the motion
  ResidualField residuals;      ///< relative to known_motion()
  std::optional<double> noise;  ///< that was found in the image, see image_noise()
  PipelineResult result;

 private:
  cv::Mat luminance_;
  StationaryCamera stationary_;
};

/// The camera that a frame is from.
struct FrameCamera {
  const Camera& camera;
  const BlurFieldEstimator& estimator;
  const PixelMask& mask;
  int threads;  ///< at most; 0: one for each core

  const BlockGrid& grid() const { return estimator.grid(); }
};

}  // namespace gyro_deblur
