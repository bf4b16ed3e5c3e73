// What the gyroscope does not know of an image's motion (translation over depth, objects that move by themselves, a bias),
// from corners followed from the image before.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// A velocity beside that of the rotation, in the image.
struct ResidualVelocity {
  Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();
  double stddev_px_s = 0;  ///< of each component
};

/// How corners are followed.
struct ResidualFlowOptions {
  int max_corners = 300;
  double min_distance_px = 20;
  int window_px = 21;
  int levels = 3;
  double max_round_trip_px = 1.5;
  int neighbours = 9;  ///< corners that a block's velocity is the median of
};

/// Residual velocities of the images of one camera. Not thread-safe.
class ResidualFlow {
 public:
  explicit ResidualFlow(const ResidualFlowOptions& options = {}) : options_(options) {}

  /// A corner of the newest image.
  struct Sample {
    Eigen::Vector2d pixel_px;       ///< at the middle of its row's exposure
    Eigen::Vector2d velocity_px_s;  ///< mean since the image before, beside that of the rotation
    TimeNs since_ns;                ///< the image before saw it so long ago
  };

  /// Follows the corners of the image before into this one.
  /// @param luminance  CV_8UC1 of the camera's size; its pixels are copied
  /// @param motion     from the image before to this one; corners beyond what it covers are left out
  const std::vector<Sample>& follow(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                    const RowExposure& exposure);

  /// Of each block of the newest image, at its exposure; nothing where too few corners are near.
  std::vector<std::optional<ResidualVelocity>> velocities(const BlockGrid& grid) const;

  const std::vector<Sample>& samples() const { return samples_; }

  void reset();

 private:
  ResidualFlowOptions options_;
  std::vector<cv::Mat> pyramid_;      // of the newest image
  std::vector<cv::Point2f> corners_;  // of the newest image
  std::optional<RowExposure> exposure_;
  std::vector<Sample> samples_;
};

}  // namespace gyro_deblur
