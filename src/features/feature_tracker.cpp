#include "gyro_deblur/feature_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include <Eigen/Dense>
#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"
#include "features/blur_alignment.hpp"
#include "features/blurred_view.hpp"
#include "features/corner_following.hpp"
#include "features/corner_prediction.hpp"
#include "features/epipolar_check.hpp"
#include "features/local_motion.hpp"

namespace gyro_deblur {
namespace {

/// Integers up to here are exact in a float, which is what carries ids in sensor_msgs/PointCloud.
constexpr std::int32_t kIds = 1 << 24;

bool inside(const cv::Point2f& p, const cv::Size& size) {
  return p.x >= 0 && p.y >= 0 && p.x <= static_cast<float>(size.width - 1) &&
         p.y <= static_cast<float>(size.height - 1);
}

cv::Point2f to_cv(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }
Eigen::Vector2d to_eigen(const cv::Point2f& p) { return {p.x, p.y}; }

/// Corners of an image of half the size: noise makes fewer of its own there.
/// @param allowed  CV_8UC1, of the luminance's size: not 0 where a corner may be
std::vector<cv::Point2f> new_corners(const cv::Mat& luminance, const cv::Mat& allowed, int count,
                                     double min_distance_px) {
  constexpr double kQuality = 0.01;  // of the strongest corner's smaller eigenvalue; VINS-Mono has 0.01 as well
  constexpr int kBlockPx = 3;        // side of the squares over which gradients are summed
  const cv::Size half_size(luminance.cols / 2, luminance.rows / 2);
  cv::Mat half, half_allowed;
  cv::resize(luminance, half, half_size, 0, 0, cv::INTER_AREA);
  cv::resize(allowed, half_allowed, half_size, 0, 0, cv::INTER_AREA);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(half, corners, count, kQuality, min_distance_px / 2, half_allowed == 255, kBlockPx);
  for (cv::Point2f& corner : corners) corner = 2 * corner + cv::Point2f(0.5f, 0.5f);
  return corners;
}

/// Successive errors of a track are correlated, and its patch sees other depths than its point's: more than their sum.
/// Fits to simulated flights, see doc/reports/tracks.md.
Eigen::Matrix2d published_covariance(const Eigen::Matrix2d& sum_px2) {
  constexpr double kFactor = 2.5, kFloorPx = 0.06;
  return kFactor * sum_px2 + kFloorPx * kFloorPx * Eigen::Matrix2d::Identity();
}

/// A template older than this many images is replaced: its view of the patch has changed by then.
constexpr int kTemplateImages = 10;

}  // namespace

struct FeatureTracker::State {
  BlurredPoint point;  // in the newest image
  /// The older template: where the point was in an image up to kTemplateImages back.
  std::shared_ptr<const BlurredView> anchor_view;
  BlurredPoint anchor;
  int anchor_age = 0;  // [images]
  /// What it moved by beside its prediction; nothing where a residual velocity predicted it, and at first.
  std::optional<Eigen::Vector2d> unpredicted_px_s;
  Eigen::Matrix2d anchor_map = Eigen::Matrix2d::Identity();         // from there to the newest image
  Eigen::Matrix2d anchor_covariance_px2 = Eigen::Matrix2d::Zero();  // there, against where the track began
  Eigen::Matrix2d since_anchor_px2 = Eigen::Matrix2d::Zero();       // in the newest image, against the anchor

  /// In the newest image, against where the track began.
  Eigen::Matrix2d covariance_px2() const {
    return anchor_map * anchor_covariance_px2 * anchor_map.transpose() + since_anchor_px2;
  }
  /// The newest image becomes that of the older template.
  void anchor_at(const std::shared_ptr<const BlurredView>& newest) {
    anchor_covariance_px2 = covariance_px2();
    since_anchor_px2.setZero();
    anchor_map.setIdentity();
    anchor_view = newest;
    anchor = point;
    anchor_age = 0;
  }
};

struct FeatureTracker::Candidate {
  PredictedPoint predicted;
  std::optional<Alignment> found;
};

struct FeatureTracker::Searcher {
  int threads = 1;
  int window_px = 0;
  std::vector<BlurAligner> aligners;  // of the threads

  /// Calls body(i, thread) for i < count.
  template <typename Body>
  void for_each(std::size_t count, Body&& body) {
    constexpr int kPointsAtATime = 4;
    const int used = threads_or_all(threads);
    aligners.resize(static_cast<std::size_t>(used));
    run_parallel(static_cast<int>(count), used, kPointsAtATime,
                 [&body](int i, int thread) { body(static_cast<std::size_t>(i), static_cast<std::size_t>(thread)); });
  }

  std::optional<Alignment> find(const BlurredView& from, const BlurredPoint& in_from, const BlurredView& to,
                                const Eigen::Vector2d& start_px, const Eigen::Matrix2d& map, const Camera& camera,
                                const CameraMotion& motion, std::size_t thread) {
    AlignmentOptions options;
    options.window_px = window_px;
    const BlurredPoint in_to = to.point_at(start_px, camera, motion);
    std::optional<Alignment> found =
        aligners[thread].align(from.luminance(), in_from, to.luminance(), in_to, map, options);
    if (!found || !is_usable(*found)) return std::nullopt;
    found->covariance_px2 += model_variance_px2(in_from.path_px, in_to.path_px) * Eigen::Matrix2d::Identity();
    return found;
  }

  /// Of what noise does not make: patches that no affine map takes to each other, and paths that are not exact.
  static double model_variance_px2(const PlanePath& first_px, const PlanePath& second_px) {
    constexpr double kFloorPx = 0.04, kShareOfExtent = 0.0045;  // fits, see doc/reports/tracks.md
    const double extent_px = std::hypot(extent_of(first_px).norm(), extent_of(second_px).norm());
    return std::pow(kFloorPx, 2) + std::pow(kShareOfExtent * extent_px, 2);
  }

  static bool is_usable(const Alignment& found) {
    // What is less certain helps no estimator, and may have been found by chance. Smaller limits end half of the tracks
    // in low light (doc/reports/tracks.md).
    constexpr double kMaxStddevPx = 1.4;
    const Eigen::Matrix2d& c = found.covariance_px2;
    const double largest = 0.5 * (c.trace() + std::hypot(c(0, 0) - c(1, 1), 2 * c(0, 1)));
    return agrees(found) && largest < kMaxStddevPx * kMaxStddevPx;
  }

  /// Takes a track to where it was found in a new image.
  void advance(State* state, const Candidate& candidate, const BlurredView& view, const Camera& camera,
               const CameraMotion& motion, std::size_t thread) {
    const Eigen::Matrix2d& map = candidate.predicted.map;
    state->anchor_map = map * state->anchor_map;
    state->since_anchor_px2 = map * state->since_anchor_px2 * map.transpose() + candidate.found->covariance_px2;
    state->point.place_px = candidate.found->place_px;
    ++state->anchor_age;
    if (state->anchor_age > 1) hold_down_drift(state, view, camera, motion, thread);
    state->point = view.point_at(state->point.place_px, camera, motion);
  }

  /// Improves what was found from the image before by the older template, where the two agree.
  void hold_down_drift(State* state, const BlurredView& view, const Camera& camera, const CameraMotion& motion,
                       std::size_t thread) {
    const std::optional<Alignment> found = find(*state->anchor_view, state->anchor, view, state->point.place_px,
                                                state->anchor_map, camera, motion, thread);
    if (!found) return;
    constexpr double kMaxMahalanobis = 13.8;  // of two degrees of freedom: 99.9 %
    const Eigen::Vector2d difference_px = found->place_px - state->point.place_px;
    const Eigen::Matrix2d sum_px2 = found->covariance_px2 + state->since_anchor_px2;
    if (difference_px.dot(sum_px2.inverse() * difference_px) > kMaxMahalanobis) return;
    const Eigen::Matrix2d share = state->since_anchor_px2 * sum_px2.inverse();
    state->point.place_px += share * difference_px;
    state->since_anchor_px2 = (Eigen::Matrix2d::Identity() - share) * state->since_anchor_px2;
  }
};

FeatureTracker::FeatureTracker(const TrackerOptions& options) : searcher_(std::make_unique<Searcher>()) {
  set_options(options);
}

FeatureTracker::~FeatureTracker() = default;

void FeatureTracker::set_options(const TrackerOptions& options) {
  options.validate();
  if (options.window_px != options_.window_px) with_used_window_.release();
  if (options.window_px != options_.window_px || options.levels != options_.levels) pyramid_.clear();
  options_ = options;
  searcher_->window_px = options.window_px;
}

void FeatureTracker::set_threads(int threads) { searcher_->threads = threads; }

void FeatureTracker::set_mask(const PixelMask& mask) {
  if (mask.is_same(mask_)) return;
  mask_ = mask;
  with_used_window_.release();
}

void FeatureTracker::reset() {
  tracks_.clear();
  states_.clear();
  view_.reset();
  pyramid_.clear();
}

std::optional<TimeRange> FeatureTracker::newest_frame() const {
  if (!view_) return std::nullopt;
  return view_->exposure().frame();
}

const std::vector<Track>& FeatureTracker::track(const cv::Mat& luminance, const Camera& camera,
                                                const CameraMotion& motion, const RowExposure& exposure,
                                                const FrameBlur* field) {
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
  std::vector<cv::Mat> pyramid;
  if (view_) follow(view, camera, motion, &pyramid);
  pyramid_ = std::move(pyramid);
  add_corners(view, camera, motion);
  view_ = view;
  calibration_ = calibration;
  return tracks_;
}

const std::vector<Track>& FeatureTracker::track_again(const cv::Mat& luminance, const Camera& camera,
                                                      const CameraMotion& motion, const RowExposure& exposure,
                                                      const FrameBlur* field) {
  const bool is_newest = view_ && view_->exposure().start(0) == exposure.start(0);
  return is_newest ? tracks_ : track(luminance, camera, motion, exposure, field);
}

std::vector<FeatureTracker::Candidate> FeatureTracker::search(const BlurredView& view, const Camera& camera,
                                                              const CameraMotion& motion,
                                                              std::vector<cv::Mat>* pyramid) {
  std::vector<Candidate> candidates(tracks_.size());
  const double dt_s = to_seconds(view.exposure().start(0) - view_->exposure().start(0));
  std::vector<DisplacedPoint> of_last;  // what points moved by beside their predictions is much the same now
  for (const State& state : states_) {
    if (state.unpredicted_px_s) of_last.push_back({state.point.place_px, dt_s * *state.unpredicted_px_s});
  }
  searcher_->for_each(tracks_.size(), [&](std::size_t i, std::size_t thread) {
    Candidate& candidate = candidates[i];
    const State& state = states_[i];
    candidate.predicted = predict_point(state.point.place_px, *view_, view, camera, motion);
    Eigen::Vector2d start_px = candidate.predicted.place_px;
    if (!candidate.predicted.by_residual) {
      if (of_last.empty()) return;
      start_px += state.unpredicted_px_s ? dt_s * *state.unpredicted_px_s
                                         : local_motion(of_last, state.point.place_px).displacement_px;
    }
    candidate.found =
        searcher_->find(*view_, state.point, view, start_px, candidate.predicted.map, camera, motion, thread);
    // Otherwise it may have been found by chance: a search there and back decides.
    constexpr double kSurePx = 0.15, kMaxSurprisePx = 1;
    if (!candidate.predicted.by_residual && candidate.found &&
        (candidate.found->covariance_px2.trace() > kSurePx * kSurePx ||
         (candidate.found->place_px - start_px).norm() > kMaxSurprisePx)) {
      candidate.found.reset();
    }
  });
  std::vector<std::size_t> open;  // what the prediction alone does not find
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (!candidates[i].found) open.push_back(i);
  }
  if (open.empty()) return candidates;
  std::vector<cv::Point2f> before, start;
  for (const std::size_t i : open) {
    before.push_back(to_cv(states_[i].point.place_px));
    start.push_back(to_cv(candidates[i].predicted.place_px));
  }
  if (pyramid_.empty()) pyramid_ = corner_pyramid(view_->luminance(), options_.window_px, options_.levels);
  *pyramid = corner_pyramid(view.luminance(), options_.window_px, options_.levels);
  const FollowedCorners corners = follow_there_and_back(
      pyramid_, *pyramid, before, start,
      {options_.window_px, options_.levels,
       cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.05),  // a start: the alignment follows
       options_.max_round_trip_px});
  searcher_->for_each(open.size(), [&](std::size_t k, std::size_t thread) {
    Candidate& candidate = candidates[open[k]];
    if (candidate.predicted.by_residual && !corners.found[k]) return;
    const Eigen::Vector2d start_px = corners.found[k] ? to_eigen(corners.places[k]) : candidate.predicted.place_px;
    candidate.found = searcher_->find(*view_, states_[open[k]].point, view, start_px, candidate.predicted.map, camera,
                                      motion, thread);
  });
  return candidates;
}

void FeatureTracker::refine(const BlurredView& view, const Camera& camera, const CameraMotion& motion,
                            std::vector<Candidate>* candidates) {
  std::vector<DisplacedPoint> displaced;
  for (std::size_t i = 0; i < candidates->size(); ++i) {
    const Candidate& candidate = (*candidates)[i];
    if (!candidate.found) continue;
    displaced.push_back({states_[i].point.place_px, candidate.found->place_px - candidate.predicted.place_px});
  }
  searcher_->for_each(candidates->size(), [&](std::size_t i, std::size_t thread) {
    Candidate& candidate = (*candidates)[i];
    const LocalMotion local = local_motion(displaced, states_[i].point.place_px);
    // Where the map stays what it was, the patches do too.
    constexpr double kLeastSlope = 0.005;
    const bool stays = candidate.found && local.slope.norm() < kLeastSlope;
    candidate.predicted.map += local.slope;
    const Eigen::Vector2d start_px =
        candidate.found ? candidate.found->place_px : candidate.predicted.place_px + local.displacement_px;
    if (!stays) {
      candidate.found =
          searcher_->find(*view_, states_[i].point, view, start_px, candidate.predicted.map, camera, motion, thread);
    }
    if (candidate.found) searcher_->advance(&states_[i], candidate, view, camera, motion, thread);
  });
}

void FeatureTracker::follow(const std::shared_ptr<const BlurredView>& view, const Camera& camera,
                            const CameraMotion& motion, std::vector<cv::Mat>* pyramid) {
  if (tracks_.empty()) return;
  std::vector<Candidate> candidates = search(*view, camera, motion, pyramid);
  refine(*view, camera, motion, &candidates);
  const cv::Size size = view->luminance().size();
  const double dt_s = to_seconds(view->exposure().start(0) - view_->exposure().start(0));
  std::vector<Track> tracks;
  std::vector<State> states;
  std::vector<Eigen::Vector3d> turned_rays;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (!candidates[i].found) continue;
    Track track = tracks_[i];
    State state = states_[i];
    const Eigen::Vector2d& at_px = state.point.place_px;
    if (!inside(to_cv(at_px), size) || !mask_.uses({cvRound(at_px.x()), cvRound(at_px.y())})) continue;
    const Eigen::Vector3d ray = camera.ray(at_px);
    if (!ray.allFinite()) continue;
    const auto direction = turned_ray(track.pixel_px, camera, motion, view_->exposure().middle(track.pixel_px.y()),
                                      view->exposure().middle(at_px.y()));
    turned_rays.push_back(direction.value_or(camera.ray(track.pixel_px)));
    state.unpredicted_px_s.reset();
    if (!candidates[i].predicted.by_residual) {
      state.unpredicted_px_s = (candidates[i].found->place_px - candidates[i].predicted.place_px) / dt_s;
    }
    track.pixel_px = at_px;
    track.covariance_px2 = published_covariance(state.covariance_px2());
    const Eigen::Vector2d normalized = camera.normalized(ray);
    track.velocity_1_s = (normalized - track.normalized) / dt_s;
    track.normalized = normalized;
    ++track.length;
    if (state.anchor_age >= kTemplateImages) state.anchor_at(view);
    tracks.push_back(track);
    states.push_back(state);
  }
  tracks_ = std::move(tracks);
  states_ = std::move(states);
  check_geometry(camera, turned_rays);
}

void FeatureTracker::check_geometry(const Camera& camera, const std::vector<Eigen::Vector3d>& turned_rays) {
  std::vector<Eigen::Vector3d> rays;
  for (const Track& track : tracks_) rays.push_back(camera.ray(track.pixel_px));
  const std::vector<char> agrees_with_others =
      agree_with_epipolar_geometry(turned_rays, rays, camera.calibration().fx_px, options_.max_epipolar_px);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < tracks_.size(); ++i) {
    if (!agrees_with_others[i]) continue;
    tracks_[kept] = tracks_[i];
    states_[kept++] = states_[i];
  }
  tracks_.resize(kept);
  states_.resize(kept);
}

void FeatureTracker::add_corners(const std::shared_ptr<const BlurredView>& view, const Camera& camera,
                                 const CameraMotion& motion) {
  const cv::Mat& luminance = view->luminance();
  std::vector<std::size_t> order(tracks_.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(),
                   [this](std::size_t a, std::size_t b) { return tracks_[a].length > tracks_[b].length; });
  if (with_used_window_.empty()) with_used_window_ = mask_.with_used_window(options_.window_px / 2);
  cv::Mat allowed(luminance.size(), CV_8UC1, cv::Scalar(255));
  if (!with_used_window_.empty()) with_used_window_.copyTo(allowed);
  const int radius_px = cvRound(options_.min_distance_px);
  cv::Mat met(luminance.size(), CV_8UC1, cv::Scalar(0));
  std::vector<Track> tracks;
  std::vector<State> states;
  for (const std::size_t i : order) {
    const cv::Point at(cvRound(tracks_[i].pixel_px.x()), cvRound(tracks_[i].pixel_px.y()));
    if (met.at<uchar>(at) != 0) continue;  // two tracks have met: the longer one stays
    // Not at the distance of new ones already, of which many would fall below it by the slightest change of view.
    cv::circle(met, at, radius_px / 2, cv::Scalar(255), cv::FILLED);
    cv::circle(allowed, at, radius_px, cv::Scalar(0), cv::FILLED);
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
      std::max(options_.window_px / 2, std::min(options_.border_px, std::min(allowed.cols, allowed.rows) / 4));
  cv::rectangle(allowed, {0, 0}, {allowed.cols - 1, allowed.rows - 1}, cv::Scalar(0), 2 * margin_px);
  for (const cv::Point2f& corner : new_corners(luminance, allowed, missing, options_.min_distance_px)) {
    const Eigen::Vector3d ray = camera.ray(to_eigen(corner));
    if (!ray.allFinite()) continue;
    Track track;
    track.id = next_id_;
    next_id_ = (next_id_ + 1) % kIds;
    track.pixel_px = to_eigen(corner);
    track.normalized = camera.normalized(ray);
    tracks_.push_back(track);
    State state;
    state.point = view->point_at(track.pixel_px, camera, motion);
    state.anchor_at(view);
    states_.push_back(state);
  }
}

}  // namespace gyro_deblur
