#include "calibrate/image_turn.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

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
/// As those of flow: over a longer time a mean rate says little.
constexpr TimeNs kLongestStepNs = 250'000'000;
constexpr std::size_t kFewestPoints = 12;
/// Part of the corners that has to be found again, see ResidualFlow.
constexpr double kLeastFollowed = 0.3;
/// What Lucas-Kanade leaves in a rotation of all points, in the smaller image [px].
constexpr double kFloorPx = 0.02;

double middle_row(const Camera& camera) { return 0.5 * (camera.calibration().height_px - 1); }

}  // namespace

void ImageTurnTracker::set_mask(const PixelMask& mask) {
  if (mask_.is_same(mask)) return;
  mask_ = mask;
  usable_.release();
}

void ImageTurnTracker::reset() {
  pyramid_.clear();
  corners_.clear();
  exposure_.reset();
  rate_rad_s_.setZero();
}

void ImageTurnTracker::shrink_mask(const cv::Size& size) {
  if (mask_.empty() || usable_.size() == size) return;
  constexpr int kWholly = 255;
  cv::Mat share;
  cv::resize(mask_.pixels(), share, size, 0, 0, cv::INTER_AREA);
  cv::erode(share == kWholly, usable_, cv::getStructuringElement(cv::MORPH_RECT, {kWindowPx, kWindowPx}));
}

std::optional<ImageTurn> ImageTurnTracker::add(const cv::Mat& luminance, const Camera& camera,
                                               const RowExposure& exposure) {
  const CameraCalibration& calibration = camera.calibration();
  if (luminance.type() != CV_8UC1 || luminance.cols != calibration.width_px ||
      luminance.rows != calibration.height_px) {
    throw std::invalid_argument("ImageTurnTracker needs 8-bit luminance of the camera's size");
  }
  if (!mask_.empty() && mask_.size() != luminance.size()) throw std::invalid_argument("the mask has not its size");
  if (exposure_) {
    const TimeNs step_ns = exposure.middle(middle_row(camera)) - exposure_->middle(middle_row(camera));
    if (step_ns <= 0 || step_ns > kLongestStepNs || calibration != calibration_) reset();
  }
  std::optional<ImageTurn> turn;
  on_one_thread([&] {
    cv::Mat small = luminance;
    for (scale_ = 1; small.cols > kLargestWidthPx; scale_ *= 2) {
      cv::Mat half;
      cv::pyrDown(small, half);  // its pixel (x, y) is at (2 x, 2 y)
      small = half;
    }
    shrink_mask(small.size());
    std::vector<cv::Mat> pyramid = corner_pyramid(small, kWindowPx, kLevels);
    if (exposure_) turn = follow(pyramid, camera, exposure);
    const double min_distance_px = 0.6 * std::sqrt(static_cast<double>(small.total()) / kMostCorners);
    corners_.clear();
    cv::goodFeaturesToTrack(small, corners_, kMostCorners, kCornerQuality, min_distance_px, usable_);
    pyramid_ = std::move(pyramid);
  });
  exposure_ = exposure;
  calibration_ = calibration;
  rate_rad_s_ = turn ? turn->rate_rad_s : Eigen::Vector3d::Zero();
  return turn;
}

std::optional<ImageTurn> ImageTurnTracker::follow(const std::vector<cv::Mat>& pyramid, const Camera& camera,
                                                  const RowExposure& exposure) {
  ImageTurn turn;
  turn.begin_ns = exposure_->middle(middle_row(camera));
  turn.end_ns = exposure.middle(middle_row(camera));
  const double step_s = to_seconds(turn.end_ns - turn.begin_ns);
  const auto pixel_of = [this](const cv::Point2f& p) { return Eigen::Vector2d(scale_ * p.x, scale_ * p.y); };
  const Eigen::Matrix3d turned = so3_exp(-step_s * rate_rad_s_).toRotationMatrix();
  std::vector<cv::Point2f> before, start;
  std::vector<Eigen::Vector3d> rays;
  for (const cv::Point2f& corner : corners_) {
    const Eigen::Vector3d ray = camera.ray(pixel_of(corner));
    const Eigen::Vector2d at_px = camera.project(turned * ray) / scale_;
    if (!ray.allFinite() || !at_px.allFinite()) continue;
    before.push_back(corner);
    start.emplace_back(static_cast<float>(at_px.x()), static_cast<float>(at_px.y()));
    rays.push_back(ray.normalized());
  }
  const CornerSearch search{
      kWindowPx, kLevels, cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, kIterations, kLeastStepPx),
      kMaxRoundTripPx};
  const FollowedCorners followed = follow_there_and_back(pyramid_, pyramid, before, start, search);
  const cv::Rect2f image({0, 0}, cv::Size2f(pyramid.front().size()));
  std::vector<Eigen::Vector3d> from, to;
  std::vector<double> speeds_rad_s;
  for (std::size_t i = 0; i < followed.places.size(); ++i) {
    if (!followed.found[i] || !image.contains(followed.places[i])) continue;
    const Eigen::Vector2d from_px = pixel_of(before[i]), to_px = pixel_of(followed.places[i]);
    const Eigen::Vector3d ray = camera.ray(to_px).normalized();
    if (!ray.allFinite()) continue;
    // A rolling shutter sees a point that changes its row after another time than that between the middle rows.
    const double seen_after_s = to_seconds(exposure.middle(to_px.y()) - exposure_->middle(from_px.y()));
    if (2 * seen_after_s < step_s) continue;
    from.push_back(rays[i]);
    to.push_back((rays[i] + step_s / seen_after_s * (ray - rays[i])).normalized());
    speeds_rad_s.push_back((ray - rays[i]).norm() / seen_after_s);
  }
  if (from.size() < kFewestPoints || static_cast<double>(from.size()) < kLeastFollowed * before.size()) return {};
  const RayRotation rotation = robust_rotation(from, to);
  // Scene points move against the camera.
  turn.rate_rad_s = -log_rotation(rotation.R) / step_s;
  const double floor_rad = scale_ * kFloorPx / camera.calibration().fx_px;
  // Translation moves all points together, so that the median error stands for the rotation, however many they are.
  turn.stddev_rad_s = std::hypot(rotation.median_error, floor_rad) / step_s;
  turn.speed_rad_s = median(speeds_rad_s);
  return turn;
}

}  // namespace gyro_deblur
