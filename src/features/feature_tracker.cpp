// Tracks corners from image to image, with covariances.
#include "gyro_deblur/feature_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "features/blurred_view.hpp"
#include "features/corner_detector.hpp"
#include "features/corner_prediction.hpp"
#include "features/epipolar_check.hpp"
#include "features/track_search.hpp"

namespace gyro_deblur {
namespace {

bool inside(const Eigen::Vector2d& p, const cv::Size& size) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= size.width - 1 && p.y() <= size.height - 1;
}

/// A patch sees other depths than its point's. A fit to simulated flights, see doc/reports/tracks.md.
Eigen::Matrix2d published_covariance(const Eigen::Matrix2d& sum_px2) {
  constexpr double kFloorPx = 0.06;
  return sum_px2 + kFloorPx * kFloorPx * Eigen::Matrix2d::Identity();
}

}  // namespace

FeatureTracker::FeatureTracker(const TrackerOptions& options)
    : search_(std::make_unique<TrackSearch>()), detector_(std::make_unique<CornerDetector>()) {
  set_options(options);
}

FeatureTracker::~FeatureTracker() = default;

void FeatureTracker::set_options(const TrackerOptions& options) {
  options.validate();
  if (options.window_px != options_.window_px) with_used_window_.release();
  if (options.window_px != options_.window_px) search_->reset();
  options_ = options;
}

void FeatureTracker::set_mask(const PixelMask& mask) {
  if (mask.is_same(mask_)) return;
  mask_ = mask;
  with_used_window_.release();
}

void FeatureTracker::reset() {
  tracks_.clear();
  states_.clear();
  view_.reset();
}

std::optional<TimeRange> FeatureTracker::newest_frame() const {
  if (!view_) return std::nullopt;
  return view_->exposure().frame();
}

const std::vector<Track>& FeatureTracker::track(const cv::Mat& luminance, const Camera& camera,
                                                const CameraMotion& motion, const RowExposure& exposure,
                                                const FrameBlur* field, bool repeats) {
  if (repeats && view_ && view_->exposure().start(0) == exposure.start(0)) return tracks_;
  const CameraCalibration& calibration = camera.calibration();
  if (luminance.type() != CV_8UC1 || luminance.cols != calibration.width_px ||
      luminance.rows != calibration.height_px) {
    throw std::invalid_argument("tracking needs 8-bit luminance of the camera's size, " +
                                std::to_string(calibration.width_px) + "x" + std::to_string(calibration.height_px));
  }
  if (!mask_.empty() && mask_.size() != luminance.size()) throw std::invalid_argument("the mask has not its size");
  if (view_) {
    const TimeNs step_ns = exposure.start(0) - view_->exposure().start(0);
    if (step_ns <= 0 || step_ns > kLongestTrackBreakNs || calibration != calibration_) reset();
  }
  const auto view = std::make_shared<const BlurredView>(luminance, exposure, field);
  if (view_ && !tracks_.empty()) {
    follow(view, camera, motion);
  } else {
    search_->reset();
  }
  add_corners(view, camera, motion);
  view_ = view;
  calibration_ = calibration;
  return tracks_;
}

void FeatureTracker::follow(const std::shared_ptr<const BlurredView>& view, const Camera& camera,
                            const CameraMotion& motion) {
  const double dt_s = to_seconds(view->exposure().start(0) - view_->exposure().start(0));
  const std::vector<TrackState> before = states_;
  const std::vector<TrackCandidate> candidates =
      search_->follow({*view_, *view, camera, motion, dt_s, options_, threads_}, &states_);
  const cv::Size size = view->luminance().size();
  std::vector<Track> tracks;
  std::vector<TrackState> states;
  std::vector<Eigen::Vector3d> rotated_rays, rays;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (!candidates[i].found) continue;
    Track track = tracks_[i];
    TrackState state = states_[i];
    const Eigen::Vector2d& at_px = state.point.place_px;
    if (!inside(at_px, size) || !mask_.uses({cvRound(at_px.x()), cvRound(at_px.y())})) continue;
    if (!state.ray.allFinite()) continue;
    rotated_rays.push_back(rotated_ray(before[i].ray, motion, view_->exposure().middle(track.pixel_px.y()),
                                       view->exposure().middle(at_px.y()))
                               .value_or(before[i].ray));
    rays.push_back(state.ray);
    state.unpredicted_px_s.reset();
    if (!candidates[i].predicted.by_residual) {
      state.unpredicted_px_s = (candidates[i].found->place_px - candidates[i].predicted.place_px) / dt_s;
    }
    track.pixel_px = at_px;
    track.covariance_px2 = published_covariance(state.covariance_px2());
    // The velocity is that of the place before drift was taken out: the correction is no motion.
    const Eigen::Vector3d found_ray = candidates[i].predicted.near->ray(candidates[i].found->place_px);
    track.velocity_1_s = (camera.normalized(found_ray) - track.normalized) / dt_s;
    track.normalized = camera.normalized(state.ray);
    ++track.length;
    if (state.anchor_age >= kTemplateImages) state.anchor_at(view);
    tracks.push_back(track);
    states.push_back(state);
  }
  const std::vector<char> agrees_with_others =
      agree_with_epipolar_geometry(rotated_rays, rays, camera.calibration().fx_px, options_.max_epipolar_px);
  tracks_.clear();
  states_.clear();
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    if (!agrees_with_others[i]) continue;
    tracks_.push_back(tracks[i]);
    states_.push_back(states[i]);
  }
}

void FeatureTracker::add_corners(const std::shared_ptr<const BlurredView>& view, const Camera& camera,
                                 const CameraMotion& motion) {
  const cv::Mat& luminance = view->luminance();
  std::vector<std::size_t> order(tracks_.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(),
                   [this](std::size_t a, std::size_t b) { return tracks_[a].length > tracks_[b].length; });
  if (with_used_window_.empty()) with_used_window_ = mask_.with_used_window(largest_reach_px(options_.window_px));
  std::vector<Eigen::Vector2d> taken_px;
  std::vector<Track> tracks;
  std::vector<TrackState> states;
  // Not at the distance of new ones already, of which many would fall below it by the slightest change of view.
  const double met_px2 = std::pow(options_.min_distance_px / 2, 2);
  for (const std::size_t i : order) {
    const Eigen::Vector2d& at_px = tracks_[i].pixel_px;
    const bool has_met = std::any_of(taken_px.begin(), taken_px.end(), [&](const Eigen::Vector2d& other_px) {
      return (other_px - at_px).squaredNorm() <= met_px2;
    });
    if (has_met) continue;  // the longer one stays
    taken_px.push_back(at_px);
    if (tracks.size() == static_cast<std::size_t>(options_.max_tracks)) continue;
    tracks.push_back(tracks_[i]);
    states.push_back(states_[i]);
  }
  tracks_ = std::move(tracks);
  states_ = std::move(states);
  const int missing = options_.max_tracks - static_cast<int>(tracks_.size());
  if (missing <= 0) return;
  // A corner whose window is cut is about to leave, or has just come.
  const int margin_px =
      std::max(options_.window_px / 2, std::min(options_.border_px, std::min(luminance.cols, luminance.rows) / 4));
  const CornerRequest request{missing, options_.min_distance_px, margin_px, with_used_window_, taken_px};
  for (const Eigen::Vector2d& corner_px : detector_->detect(luminance, request)) {
    const Eigen::Vector3d ray = camera.ray(corner_px);
    if (!ray.allFinite()) continue;
    Track track;
    track.id = next_id_;
    next_id_ = (next_id_ + 1) % kTrackerIds;
    track.pixel_px = corner_px;
    track.normalized = camera.normalized(ray);
    tracks_.push_back(track);
    TrackState state;
    state.ray = ray;
    state.point = view->point_at(track.pixel_px, ray, camera, motion);
    state.anchor_at(view);
    states_.push_back(state);
  }
}

}  // namespace gyro_deblur
