// Rotation rate of a camera, from its images alone.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Those of unknown lenses, in the image's larger side: 127 and 14 degrees from side to side.
constexpr double kShortestFocalLength = 0.25, kLongestFocalLength = 4;

/// Mean rate of the camera between two images, at their middle rows.
struct ImageRate {
  TimeNs begin_ns = 0, end_ns = 0;                       ///< mid-exposure of both middle rows, camera clock
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();  ///< of the camera, in its axes
  double stddev_rad_s = 0;  ///< > 0; translation, which looks much like rotation in a small field of view, adds to it
  double speed_rad_s = 0;   ///< median speed of the points' directions: 0 for a camera that stands still
  /// Error of `rate_rad_s` by a rolling shutter: this matrix times the difference of the camera's rates between last
  /// and first row.
  Eigen::Matrix3d by_rows = Eigen::Matrix3d::Zero();
  /// Otherwise the rates about x and y are times the focal length, in the image's larger side, translation is in them
  /// and not in their standard deviation, and the speed is that of the shortest focal length.
  bool lens_known = true;
  int larger_side_px = 0;  ///< of the image, where the lens is not known
};

/// Follows corners from image to image of one camera without the gyroscope, and fits its rotation and translation, with
/// depths that differ by about a half. Takes about two milliseconds an image, for images are halved until they are at
/// most 400 px wide. Not thread-safe.
class ImageRateTracker {
 public:
  /// Corners on masked pixels are not followed. @param mask  empty, or of the images' size
  void set_mask(const PixelMask& mask);

  /// @param luminance  CV_8UC1 of the camera's size; its pixels are copied
  /// @param exposure   of the image, in the order of time
  /// @param lens_known  false: the camera is an ideal lens with a guess of the focal length, and by nothing but that is
  ///                    it known where the next corners are looked for
  /// @return mean rate since the image before; nothing for the first image, after a break of more than 0.25 s, and
  ///         where too few corners are found again
  /// Throws std::invalid_argument when the image does not fit the camera.
  std::optional<ImageRate> add(const cv::Mat& luminance, const Camera& camera, const RowExposure& exposure,
                               bool lens_known = true);

  /// Forgets the image before.
  void reset();

 private:
  static constexpr double kFirstTranslationRadS = 0.2;  // a walk through a room
  std::optional<ImageRate> follow(const std::vector<cv::Mat>& pyramid, const Camera& camera,
                                  const RowExposure& exposure, bool lens_known);

  PixelMask mask_;
  cv::Mat usable_;  // smaller: 255 where a corner may be; empty: everywhere, or not worked out yet
  double scale_ = 1;
  CameraCalibration calibration_;
  std::vector<cv::Mat> pyramid_;  // of the image before, smaller
  std::vector<cv::Point2f> corners_;
  std::optional<RowExposure> exposure_;
  Eigen::Vector3d rate_rad_s_ = Eigen::Vector3d::Zero();  // where the next corners are looked for
  double translation_rad_s_ = kFirstTranslationRadS;      // its effect on directions, one axis, root mean square
};

}  // namespace gyro_deblur
