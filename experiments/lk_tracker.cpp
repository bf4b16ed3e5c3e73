#include "lk_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "features/corner_following.hpp"
#include "features/corner_prediction.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur::experiments {
namespace {

/// Integers up to here are exact in a float, which is what carries ids in sensor_msgs/PointCloud.
constexpr std::int32_t kIds = 1 << 24;

// As in VINS-Mono's tracker.
constexpr int kLevels = 3;
constexpr double kMaxRoundTripPx = 1;
/// Of the strongest corner's smaller eigenvalue; VINS-Mono has 0.01 as well.
constexpr double kCornerQuality = 0.01;

/// The fundamental matrix has seven degrees of freedom; OpenCV's RANSAC wants eight points.
constexpr std::size_t kMinForGeometry = 8;
constexpr double kRansacConfidence = 0.99;

bool inside(const cv::Point2f& p, const cv::Size& size) {
  return p.x >= 0 && p.y >= 0 && p.x <= static_cast<float>(size.width - 1) &&
         p.y <= static_cast<float>(size.height - 1);
}

cv::Point2f to_cv(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }
Eigen::Vector2d to_eigen(const cv::Point2f& p) { return {p.x, p.y}; }

}  // namespace

LkTracker::LkTracker(const TrackerOptions& options) : options_(options) { options_.validate(); }

const std::vector<Track>& LkTracker::track(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure) {
  std::vector<cv::Mat> pyramid = corner_pyramid(luminance, options_.window_px, kLevels);
  if (exposure_) follow(pyramid, camera, motion, exposure);
  add_corners(luminance, camera);
  pyramid_ = std::move(pyramid);
  exposure_ = exposure;
  return tracks_;
}

void LkTracker::follow(const std::vector<cv::Mat>& pyramid, const Camera& camera, const CameraMotion& motion,
                       const RowExposure& exposure) {
  if (tracks_.empty()) return;
  const cv::Size size(camera.calibration().width_px, camera.calibration().height_px);
  std::vector<cv::Point2f> before, start;
  for (const Track& track : tracks_) {
    before.push_back(to_cv(track.pixel_px));
    start.push_back(
        to_cv(predicted_pixel(track.pixel_px, camera, motion, *exposure_, exposure).value_or(track.pixel_px)));
  }
  const FollowedCorners corners = follow_there_and_back(
      pyramid_, pyramid, before, start,
      {options_.window_px, kLevels,
       cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.01),  // OpenCV's defaults
       kMaxRoundTripPx});
  const std::vector<cv::Point2f>& after = corners.places;

  const double dt_s = to_seconds(exposure.start(0) - exposure_->start(0));
  std::vector<Track> followed;
  // For the epipolar geometry: undistorted pixels of an ideal camera, with the rotation taken out of the first.
  std::vector<cv::Point2f> ideal_before, ideal_after;
  const double focal_px = camera.calibration().fx_px;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (!corners.found[i] || !inside(after[i], size)) continue;
    Track track = tracks_[i];
    const Eigen::Vector3d ray = camera.ray(to_eigen(after[i]));
    if (!ray.allFinite()) continue;
    const auto direction = rotated_ray(camera.ray(track.pixel_px), motion, exposure_->middle(track.pixel_px.y()),
                                       exposure.middle(after[i].y));
    ideal_before.push_back(to_cv(focal_px * direction.value_or(camera.ray(track.pixel_px)).hnormalized()));
    ideal_after.push_back(to_cv(focal_px * ray.hnormalized()));
    track.pixel_px = to_eigen(after[i]);
    const Eigen::Vector2d normalized = camera.normalized(ray);
    track.velocity_1_s = (normalized - track.normalized) / dt_s;
    track.normalized = normalized;
    ++track.length;
    followed.push_back(track);
  }
  tracks_ = std::move(followed);
  if (tracks_.size() < kMinForGeometry) return;

  std::vector<uchar> agrees;
  cv::setRNGSeed(1);  // the same result for the same images
  cv::findFundamentalMat(ideal_before, ideal_after, cv::FM_RANSAC, options_.max_epipolar_px, kRansacConfidence, agrees);
  if (agrees.size() != tracks_.size()) return;  // no matrix found: nothing to disagree with
  std::size_t kept = 0;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    // What stays where the rotation takes it is right whatever the direction of translation.
    if (!agrees[i] && cv::norm(ideal_after[i] - ideal_before[i]) > options_.max_epipolar_px) continue;
    tracks_[kept++] = tracks_[i];
  }
  tracks_.resize(kept);
}

void LkTracker::add_corners(const cv::Mat& luminance, const Camera& camera) {
  std::stable_sort(tracks_.begin(), tracks_.end(), [](const Track& a, const Track& b) { return a.length > b.length; });
  cv::Mat allowed(luminance.size(), CV_8UC1, cv::Scalar(255));
  const int radius_px = cvRound(options_.min_distance_px);
  cv::Mat met(luminance.size(), CV_8UC1, cv::Scalar(0));
  std::size_t kept = 0;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    const cv::Point at(cvRound(tracks_[i].pixel_px.x()), cvRound(tracks_[i].pixel_px.y()));
    if (met.at<uchar>(at) != 0) continue;  // two tracks have met: the longer one stays
    // Not at the distance of new ones already, of which many would fall below it by the slightest change of view.
    cv::circle(met, at, radius_px / 2, cv::Scalar(255), cv::FILLED);
    cv::circle(allowed, at, radius_px, cv::Scalar(0), cv::FILLED);
    tracks_[kept++] = tracks_[i];
  }
  tracks_.resize(std::min(kept, static_cast<std::size_t>(options_.max_tracks)));
  const int missing = options_.max_tracks - static_cast<int>(tracks_.size());
  if (missing <= 0) return;
  // A corner whose window is cut is about to leave, or has just come.
  const int margin_px =
      std::max(options_.window_px / 2, std::min(options_.border_px, std::min(allowed.cols, allowed.rows) / 4));
  cv::rectangle(allowed, {0, 0}, {allowed.cols - 1, allowed.rows - 1}, cv::Scalar(0), 2 * margin_px);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(luminance, corners, missing, kCornerQuality, options_.min_distance_px, allowed);
  for (const cv::Point2f& corner : corners) {
    const Eigen::Vector3d ray = camera.ray(to_eigen(corner));
    if (!ray.allFinite()) continue;
    Track track;
    track.id = next_id_;
    next_id_ = (next_id_ + 1) % kIds;
    track.pixel_px = to_eigen(corner);
    track.normalized = camera.normalized(ray);
    tracks_.push_back(track);
  }
}

}  // namespace gyro_deblur::experiments
