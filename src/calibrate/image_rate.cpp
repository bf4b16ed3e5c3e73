// Estimates the rotation rate of the camera between two images.
#include "calibrate/image_rate.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <opencv2/imgproc.hpp>

#include "base/median.hpp"
#include "base/one_thread.hpp"
#include "calibrate/aligned_rotation.hpp"
#include "features/corner_following.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

/// Corners are followed in an image no wider than this: a rotation of many points needs no more.
constexpr int kLargestWidthPx = 400;
constexpr int kMostCorners = 80;
constexpr double kCornerQuality = 0.01;
constexpr int kWindowPx = 13, kLevels = 3;
constexpr int kIterations = 10;
constexpr double kLeastStepPx = 0.03, kMaxRoundTripPx = 0.5;
/// As in optical flow: over a longer time a mean rate is no measure of the rate at an instant.
constexpr TimeNs kLongestStepNs = 250'000'000;
constexpr std::size_t kFewestPoints = 12;
/// Part of the corners that has to be found again, see ResidualFlow.
constexpr double kLeastFollowed = 0.3;
/// Error of Lucas-Kanade in a rotation of all points, in the smaller image [px].
constexpr double kFloorPx = 0.02;

/// A direction before and after, and where its rows are between the first (-0.5) and the last (0.5) of the image.
struct MovedRay {
  Eigen::Vector3d from, to;
  double row;
};

/// How directions moved.
struct RayMotion {
  Eigen::Matrix3d R;
  Eigen::Matrix3d by_rows;        ///< see ImageRate
  double stddev_rad = 0;          ///< of the rotation, about the axis of which least is known
  double translation_square = 0;  ///< expected square of a component, over the scene's depth
};

/// Least squares with Cauchy's weights. A direction moves by the rotation, by the translation over the mean depth, and
/// along the latter by as much as its own depth differs: there it counts less.
class RayMotionFit {
 public:
  /// @param translation_stddev  > 0: of a component, over the scene's depth, as far as it is known
  /// @param floor_rad           > 0: of a direction
  RayMotionFit(const std::vector<MovedRay>& rays, double translation_stddev, double floor_rad)
      : columns_(rays.size()),
        moved_(rays.size()),
        translation_stddev_(translation_stddev),
        floor_rad_(floor_rad),
        stddev_rad_(translation_stddev) {
    std::vector<Eigen::Vector3d> from, to;
    for (const MovedRay& ray : rays) {
      from.push_back(ray.from);
      to.push_back(ray.to);
      rows_.push_back(ray.row);
    }
    R_ = robust_rotation(from, to);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Eigen::Vector3d ray = R_ * from[i];
      Eigen::Matrix<double, 2, 3> across;
      across.row(0) = ray.unitOrthogonal();
      across.row(1) = ray.cross(across.row(0).transpose());
      for (int axis = 0; axis < 3; ++axis) {
        columns_[i].col(axis) = across * Eigen::Vector3d::Unit(axis).cross(ray);
        columns_[i].col(3 + axis) = across.col(axis);
      }
      moved_[i] = across * (to[i] - ray);
    }
  }

  RayMotion solve() {
    constexpr int kSteps = 5;
    for (int step = 0; step < kSteps; ++step) iterate();
    const Normal covariance = normal_.inverse();
    const Eigen::Matrix3d of_rotation = covariance.topLeftCorner<3, 3>();
    RayMotion result;
    result.R = so3_exp(motion_.head<3>()).toRotationMatrix() * R_;
    result.by_rows = (covariance * by_rows_).topRows<3>();
    result.stddev_rad = std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(of_rotation).eigenvalues()[2]);
    result.translation_square = (motion_.tail<3>().squaredNorm() + covariance.bottomRightCorner<3, 3>().trace()) / 3;
    return result;
  }

 private:
  using Columns = Eigen::Matrix<double, 2, 6>;
  using Unknowns = Eigen::Matrix<double, 6, 1>;
  using Normal = Eigen::Matrix<double, 6, 6>;

  /// Where the translation takes a direction.
  Eigen::Vector2d translated(std::size_t i) const { return columns_[i].rightCols<3>() * motion_.tail<3>(); }

  void iterate() {
    constexpr double kDepthsDiffer = 0.5, kScale = 2;
    /// Median of the absolute value of a normal variable.
    constexpr double kMedianNormal = 0.6745;
    normal_ = Normal::Zero();
    normal_.bottomRightCorner<3, 3>().diagonal().setConstant(1 / (translation_stddev_ * translation_stddev_));
    by_rows_.setZero();
    Unknowns right = Unknowns::Zero();
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const Eigen::Vector2d along = kDepthsDiffer * translated(i);
      const Eigen::Matrix2d covariance =
          stddev_rad_ * stddev_rad_ * Eigen::Matrix2d::Identity() + along * along.transpose();
      const Eigen::Matrix2d inverse = covariance.inverse();
      const Eigen::Vector2d off = moved_[i] - columns_[i] * motion_;
      const double robust = 1 / (1 + off.dot(inverse * off) / (kScale * kScale));
      const Eigen::Matrix<double, 6, 2> weighted = robust * columns_[i].transpose() * inverse;
      normal_ += weighted * columns_[i];
      right += weighted * moved_[i];
      by_rows_ += rows_[i] * weighted * columns_[i].leftCols<3>();
    }
    motion_ = normal_.ldlt().solve(right);
    std::vector<double> across_rad;
    for (std::size_t i = 0; i < columns_.size(); ++i) {
      const Eigen::Vector2d off = moved_[i] - columns_[i] * motion_;
      Eigen::Vector2d along = translated(i);
      along = along.norm() > 0 ? Eigen::Vector2d(along.normalized()) : Eigen::Vector2d::UnitX();
      across_rad.push_back(std::abs(along.x() * off.y() - along.y() * off.x()));
    }
    stddev_rad_ = std::max(median(across_rad) / kMedianNormal, floor_rad_);
  }

  std::vector<Columns> columns_;
  std::vector<Eigen::Vector2d> moved_;
  std::vector<double> rows_;
  double translation_stddev_, floor_rad_, stddev_rad_;
  Eigen::Matrix3d R_;
  Unknowns motion_ = Unknowns::Zero();
  Normal normal_;
  Eigen::Matrix<double, 6, 3> by_rows_;
};

/// A pixel that moved, in the image's larger side from its middle.
struct MovedPixel {
  Eigen::Vector2d middle, moved;  ///< half way, and the way
  double row;                     ///< as MovedRay's
};

/// How the pixels of an unknown lens moved: as by a rotation, whose effect at the image's middle is the rate times the
/// focal length, and grows by the square of the distance from there as the lens wants; and by a motion forward. Least
/// squares with Cauchy's weights.
/// @param focal_length  a guess, for by_rows alone
/// @param floor         > 0: error of a pixel
/// @param step_s        > 0: from image to image
/// @param rate          [out] its rate, by_rows and standard deviation, see ImageRate::lens_known
void fit_pixel_motion(const std::vector<MovedPixel>& pixels, double focal_length, double floor, double step_s,
                      ImageRate* rate) {
  using Normal = Eigen::Matrix<double, 6, 6>;
  constexpr int kSteps = 5;
  constexpr double kRidge = 1e-6;
  constexpr double kMedianOfPlane = 1.1774;  // of the length of two normal variables
  // Rotation, growth along x and y, motion forward.
  std::vector<Eigen::Matrix<double, 2, 6>> columns;
  for (const MovedPixel& pixel : pixels) {
    const double x = pixel.middle.x(), y = pixel.middle.y();
    columns.emplace_back();
    columns.back() << 0, -1, y, x * x, x * y, x, 1, 0, -x, x * y, y * y, y;
  }
  Eigen::Matrix<double, 6, 3> of_rotation = Eigen::Matrix<double, 6, 3>::Identity();
  of_rotation(3, 1) = -1 / (focal_length * focal_length);
  of_rotation(4, 0) = 1 / (focal_length * focal_length);
  std::vector<double> weights(pixels.size(), 1), errors(pixels.size());
  for (int step = 0; step < kSteps; ++step) {
    Normal normal = kRidge * Normal::Identity();
    Eigen::Matrix<double, 6, 1> right = Eigen::Matrix<double, 6, 1>::Zero();
    Eigen::Matrix<double, 6, 3> by_rows = Eigen::Matrix<double, 6, 3>::Zero();
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const Eigen::Matrix<double, 6, 2> weighted = weights[i] * columns[i].transpose();
      normal += weighted * columns[i];
      right += weighted * pixels[i].moved;
      by_rows += pixels[i].row * weighted * columns[i] * of_rotation;
    }
    const Normal covariance = normal.inverse();
    const Eigen::Matrix<double, 6, 1> motion = covariance * right;
    for (std::size_t i = 0; i < pixels.size(); ++i) errors[i] = (pixels[i].moved - columns[i] * motion).norm();
    const double scatter = std::max(median(errors) / kMedianOfPlane, floor);
    rate->rate_rad_s = motion.head<3>() / step_s;
    rate->by_rows = (covariance * by_rows).topRows<3>();
    const Eigen::Matrix3d of_rates = covariance.topLeftCorner<3, 3>();
    const double stddev =
        scatter * std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(of_rates).eigenvalues()[2]);
    rate->stddev_rad_s = std::hypot(stddev, floor) / step_s;
    weights = cauchy_weights(errors, floor);
  }
}

double larger_side_px(const CameraCalibration& calibration) {
  return std::max(calibration.width_px, calibration.height_px);
}

double middle_row(const Camera& camera) { return 0.5 * (camera.calibration().height_px - 1); }

/// Corners of the image before, where a rotation takes them, and their directions.
struct Predicted {
  std::vector<cv::Point2f> before, start;  ///< in the smaller image
  std::vector<Eigen::Vector3d> rays;
};
/// @param scale  of the camera's image, over the smaller one
Predicted predict(const std::vector<cv::Point2f>& corners, const Camera& camera, const Eigen::Matrix3d& rotation,
                  int scale) {
  Predicted predicted;
  for (const cv::Point2f& corner : corners) {
    const Eigen::Vector3d ray = camera.ray(Eigen::Vector2d(scale * corner.x, scale * corner.y));
    const Eigen::Vector2d at_px = camera.project(rotation * ray) / scale;
    if (!ray.allFinite() || !at_px.allFinite()) continue;
    predicted.before.push_back(corner);
    predicted.start.emplace_back(static_cast<float>(at_px.x()), static_cast<float>(at_px.y()));
    predicted.rays.push_back(ray.normalized());
  }
  return predicted;
}

}  // namespace

void ImageRateTracker::set_mask(const PixelMask& mask) {
  if (mask_.is_same(mask)) return;
  mask_ = mask;
  usable_.release();
}

void ImageRateTracker::reset() {
  pyramid_.clear();
  corners_.clear();
  exposure_.reset();
  rate_rad_s_.setZero();
  translation_rad_s_ = kFirstTranslationRadS;
}

std::optional<ImageRate> ImageRateTracker::add(const cv::Mat& luminance, const Camera& camera,
                                               const RowExposure& exposure, bool lens_known) {
  const CameraCalibration& calibration = camera.calibration();
  if (luminance.type() != CV_8UC1 || luminance.cols != calibration.width_px ||
      luminance.rows != calibration.height_px) {
    throw std::invalid_argument("ImageRateTracker needs 8-bit luminance of the camera's size");
  }
  if (!mask_.empty() && mask_.size() != luminance.size()) throw std::invalid_argument("the mask has not its size");
  if (exposure_) {
    const TimeNs step_ns = exposure.middle(middle_row(camera)) - exposure_->middle(middle_row(camera));
    if (step_ns <= 0 || step_ns > kLongestStepNs || calibration != calibration_) reset();
  }
  std::optional<ImageRate> rate;
  on_one_thread([&] {
    cv::Mat small = luminance;
    for (scale_ = 1; small.cols > kLargestWidthPx; scale_ *= 2) small = downsample2x(small, 1);
    if (!mask_.empty() && usable_.size() != small.size()) {
      usable_ = shrink_mask(mask_.pixels(), small.size(), kWindowPx);
    }
    std::vector<cv::Mat> pyramid = corner_pyramid(small, kWindowPx, kLevels);
    if (exposure_) rate = follow(pyramid, camera, exposure, lens_known);
    const double min_distance_px = 0.6 * std::sqrt(static_cast<double>(small.total()) / kMostCorners);
    corners_.clear();
    cv::goodFeaturesToTrack(small, corners_, kMostCorners, kCornerQuality, min_distance_px, usable_);
    pyramid_ = std::move(pyramid);
  });
  exposure_ = exposure;
  calibration_ = calibration;
  rate_rad_s_ = rate ? rate->rate_rad_s : Eigen::Vector3d::Zero();
  if (!lens_known) rate_rad_s_.head<2>() *= larger_side_px(calibration) / calibration.fx_px;
  return rate;
}

std::optional<ImageRate> ImageRateTracker::follow(const std::vector<cv::Mat>& pyramid, const Camera& camera,
                                                  const RowExposure& exposure, bool lens_known) {
  ImageRate rate;
  rate.begin_ns = exposure_->middle(middle_row(camera));
  rate.end_ns = exposure.middle(middle_row(camera));
  const double step_s = to_seconds(rate.end_ns - rate.begin_ns);
  const auto pixel_of = [this](const cv::Point2f& p) { return Eigen::Vector2d(scale_ * p.x, scale_ * p.y); };
  const auto [before, start, rays] =
      predict(corners_, camera, so3_exp(-step_s * rate_rad_s_).toRotationMatrix(), scale_);
  const CornerSearch search{
      kWindowPx, kLevels, cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, kIterations, kLeastStepPx),
      kMaxRoundTripPx};
  const FollowedCorners followed = follow_there_and_back(pyramid_, pyramid, before, start, search);
  const cv::Rect2f image({0, 0}, cv::Size2f(pyramid.front().size()));
  std::vector<MovedRay> moved;
  std::vector<MovedPixel> moved_pixels;
  const double larger_px = larger_side_px(camera.calibration());
  const Eigen::Vector2d center_px(0.5 * (camera.calibration().width_px - 1), middle_row(camera));
  std::vector<double> speeds_rad_s;
  for (std::size_t i = 0; i < followed.places.size(); ++i) {
    if (!followed.found[i] || !image.contains(followed.places[i])) continue;
    const Eigen::Vector2d from_px = pixel_of(before[i]), to_px = pixel_of(followed.places[i]);
    const Eigen::Vector3d ray = camera.ray(to_px).normalized();
    if (!ray.allFinite()) continue;
    // A rolling shutter sees a point that changes its row after another time than that between the middle rows.
    const double seen_after_s = to_seconds(exposure.middle(to_px.y()) - exposure_->middle(from_px.y()));
    if (2 * seen_after_s < step_s) continue;
    const double row = 0.5 * (from_px.y() + to_px.y()) / camera.calibration().height_px - 0.5;
    moved.push_back({rays[i], (rays[i] + step_s / seen_after_s * (ray - rays[i])).normalized(), row});
    if (lens_known) {
      speeds_rad_s.push_back((ray - rays[i]).norm() / seen_after_s);
      continue;
    }
    moved_pixels.push_back({(0.5 * (from_px + to_px) - center_px) / larger_px,
                            step_s / seen_after_s * (to_px - from_px) / larger_px, row});
    // The fastest that it can be.
    speeds_rad_s.push_back((to_px - from_px).norm() / (larger_px * kShortestFocalLength * seen_after_s));
  }
  if (moved.size() < kFewestPoints || static_cast<double>(moved.size()) < kLeastFollowed * before.size()) return {};
  rate.speed_rad_s = median(speeds_rad_s);
  if (!lens_known) {
    rate.lens_known = false;
    rate.larger_side_px = static_cast<int>(larger_px);
    const double focal_length = camera.calibration().fx_px / larger_px;
    fit_pixel_motion(moved_pixels, focal_length, scale_ * kFloorPx / larger_px, step_s, &rate);
    return rate;
  }
  const double floor_rad = scale_ * kFloorPx / camera.calibration().fx_px;
  const RayMotion motion = RayMotionFit(moved, step_s * translation_rad_s_, floor_rad).solve();
  // Scene points move against the camera.
  rate.rate_rad_s = -log_rotation(motion.R) / step_s;
  rate.by_rows = motion.by_rows;
  rate.stddev_rad_s = std::hypot(motion.stddev_rad, floor_rad) / step_s;
  // About a second is remembered. What is not known of a translation counts as one.
  constexpr double kRemembered = 0.95;
  translation_rad_s_ = std::sqrt(kRemembered * translation_rad_s_ * translation_rad_s_ +
                                 (1 - kRemembered) * motion.translation_square / (step_s * step_s));
  return rate;
}

}  // namespace gyro_deblur
