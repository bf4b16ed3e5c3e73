// Searches the points of one image in the next.
#include "features/track_search.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Dense>

#include "base/parallel.hpp"
#include "blur/path_2d.hpp"
#include "features/corner_following.hpp"
#include "features/local_motion.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {
namespace {

/// An alignment with a smaller standard deviation [px] is not improved by a second one.
constexpr double kClearPx = 0.15;

double stddev_px(const Alignment& found) { return std::sqrt(found.covariance_px2.trace()); }

/// Errors that are not noise: patches that no local map takes to each other, and inexact paths.
double model_variance_px2(const Path2d& first_px, const Path2d& second_px) {
  constexpr double kFloorPx = 0.065, kShareOfExtent = 0.004;  // fits, see doc/reports/tracks.md
  const double extent_px = std::hypot(extent_of(first_px).norm(), extent_of(second_px).norm());
  return std::pow(kFloorPx, 2) + std::pow(kShareOfExtent * extent_px, 2);
}

/// Side of the compared window. A window that is shorter than the blur shows one end of it, whose place shifts by the
/// error of the path's length. In low light a larger window has less noise (doc/reports/tracks.md).
int window_for(const Path2d& first_px, const Path2d& second_px, int sharp_window_px) {
  const double extent_px = std::max(extent_of(first_px).norm(), extent_of(second_px).norm());
  return std::min(largest_window_px(sharp_window_px), sharp_window_px + 2 * static_cast<int>(extent_px / 2));
}

/// What half the size loses, long blur has taken from the image along its path, and noise hides across it. Measured
/// with noise of 2 grey levels, where half the size serves from 30 px on, and of 4, from 15 px on
/// (doc/reports/tracks.md).
bool serves_at_half_size(const BlurredPoint& first, const BlurredPoint& second) {
  constexpr double kExtentTimesNoise = 60, kLeastExtentPx = 12, kAlwaysFromPx = 30;
  const double extent_px = std::max(extent_of(first.path_px).norm(), extent_of(second.path_px).norm());
  return extent_px >=
         std::clamp(kExtentTimesNoise / std::max(first.noise, second.noise), kLeastExtentPx, kAlwaysFromPx);
}

bool is_usable(const Alignment& found) {
  // A less certain place helps no estimator, and may have been found by chance. A limit of 0.7 px halves the length of
  // tracks in low light (doc/reports/tracks.md).
  constexpr double kMaxStddevPx = 1.4;
  const Eigen::Matrix2d& c = found.covariance_px2;
  const double largest = 0.5 * (c.trace() + std::hypot(c(0, 0) - c(1, 1), 2 * c(0, 1)));
  return agrees(found) && largest < kMaxStddevPx * kMaxStddevPx;
}

/// Whether blur is short in the newest image and in the older template, which then needs no second one. Long blurs that
/// differ make the comparison noisy.
bool is_sharp(const TrackState& state) {
  constexpr double kShortPx = 3;
  return std::hypot(extent_of(state.point.path_px).norm(), extent_of(state.anchor.path_px).norm()) < kShortPx;
}

cv::Point2f to_cv(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }

}  // namespace

void TrackState::anchor_at(const std::shared_ptr<const BlurredView>& newest) {
  anchor_covariance_px2 = covariance_px2();
  since_anchor_px2.setZero();
  anchor_map = {};
  anchor_view = newest;
  anchor = point;
  anchor_age = 0;
}

/// The tools of one thread for one step.
struct TrackSearch::Thread {
  const TrackStep& step;
  const RememberedMotion& motion;
  BlurAligner& aligner;

  BlurredPoint point_at(const Eigen::Vector2d& place_px, const NearbyRays& rays) const {
    return step.now.point_at(place_px, rays.ray(place_px), step.camera, motion);
  }

  void predict(const TrackState& state, TrackCandidate* candidate) const {
    const Eigen::Vector2d& place_px = state.point.place_px;
    const NearbyRays rays(step.camera, place_px, state.ray);
    candidate->predicted = predict_point(place_px, rays, step.before, step.now, motion);
    if (state.residual_slope_1_s) {
      candidate->predicted.map.jacobian = candidate->predicted.rotated_map + step.seconds * *state.residual_slope_1_s;
    }
  }

  std::optional<Alignment> find(const BlurredView& from, const BlurredPoint& in_from, const Eigen::Vector2d& start_px,
                                const LocalMap& map, TrackCandidate* candidate) const {
    // Within this distance paths differ by less than a hundredth of their length.
    constexpr double kSamePathPx = 3;
    if (!((start_px - candidate->near_start.place_px).norm() < kSamePathPx)) {
      candidate->near_start = point_at(start_px, *candidate->predicted.near);
    }
    BlurredPoint in_to = candidate->near_start;
    in_to.place_px = start_px;
    AlignmentOptions options;
    options.window_px = window_for(in_from.path_px, in_to.path_px, step.options.window_px);
    std::optional<Alignment> found;
    if (serves_at_half_size(in_from, in_to)) {
      options.window_px = half_size_window_px(options.window_px);
      options.max_offset_px /= 2;
      options.min_step_px /= 2;
      found = aligner.align(from.half_size(), at_half_size(in_from), step.now.half_size(), at_half_size(in_to),
                            at_half_size(map), options);
      if (found) *found = at_whole_size(*found);
    } else {
      found = aligner.align(from.luminance(), in_from, step.now.luminance(), in_to, map, options);
    }
    if (!found) return std::nullopt;
    found->covariance_px2 += model_variance_px2(in_from.path_px, in_to.path_px) * Eigen::Matrix2d::Identity();
    if (!is_usable(*found)) return std::nullopt;
    return found;
  }

  /// By the older template alone where that is enough, or else by the image before.
  void find(const TrackState& state, const Eigen::Vector2d& start_px, TrackCandidate* candidate) const {
    candidate->by_anchor = false;
    if (state.anchor_age > 0 && is_sharp(state)) {
      candidate->found = find(*state.anchor_view, state.anchor, start_px,
                              combined(candidate->predicted.map, state.anchor_map), candidate);
      candidate->by_anchor = candidate->found && stddev_px(*candidate->found) < kClearPx;
      if (candidate->by_anchor) return;
    }
    candidate->found = find(step.before, state.point, start_px, candidate->predicted.map, candidate);
  }

  /// Takes a track to where it was found.
  void advance(TrackState* state, TrackCandidate* candidate) const {
    const Eigen::Matrix2d& map = candidate->predicted.map.jacobian;
    state->anchor_map = combined(candidate->predicted.map, state->anchor_map);
    const Eigen::Matrix2d until_now_px2 = map * state->since_anchor_px2 * map.transpose();
    state->since_anchor_px2 = candidate->found->covariance_px2;
    if (!candidate->by_anchor) state->since_anchor_px2 += until_now_px2;
    state->point.place_px = candidate->found->place_px;
    ++state->anchor_age;
    // Once, by the template that is about to be replaced: in each image it takes 1.4 times the time, and drift after 20
    // images is no smaller (doc/reports/tracks.md).
    if (!candidate->by_anchor && state->anchor_age == kTemplateImages) hold_down_drift(state, candidate);
    state->ray = candidate->predicted.near->ray(state->point.place_px);
    state->point = step.now.point_at(state->point.place_px, state->ray, step.camera, motion);
  }

  /// Improves what was found from the image before by the older template, where the two agree.
  void hold_down_drift(TrackState* state, TrackCandidate* candidate) const {
    const auto found = find(*state->anchor_view, state->anchor, state->point.place_px, state->anchor_map, candidate);
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

template <typename Body>
void TrackSearch::for_each(std::size_t count, const TrackStep& step, Body&& body) {
  constexpr int kPointsAtATime = 4;
  const int used = threads_or_all(step.threads);
  aligners_.resize(static_cast<std::size_t>(used));
  const std::vector<RememberedMotion> motions(static_cast<std::size_t>(used), RememberedMotion(step.motion));
  parallel_for(static_cast<int>(count), used, kPointsAtATime, [&](int i, int thread) {
    const auto index = static_cast<std::size_t>(thread);
    body(static_cast<std::size_t>(i), Thread{step, motions[index], aligners_[index]});
  });
}

std::vector<TrackCandidate> TrackSearch::search(const TrackStep& step, const std::vector<TrackState>& states) {
  std::vector<TrackCandidate> candidates(states.size());
  std::vector<DisplacedPoint> of_last;  // deviations from predictions are much the same in the next image
  for (const TrackState& state : states) {
    if (state.unpredicted_px_s) of_last.push_back({state.point.place_px, step.seconds * *state.unpredicted_px_s});
  }
  const LocalMotions motions_of_last(of_last);
  for_each(states.size(), step, [&](std::size_t i, const Thread& thread) {
    TrackCandidate& candidate = candidates[i];
    const TrackState& state = states[i];
    thread.predict(state, &candidate);
    candidate.near_start = thread.point_at(candidate.predicted.place_px, *candidate.predicted.near);
    Eigen::Vector2d start_px = candidate.predicted.place_px;
    if (!candidate.predicted.by_residual) {
      if (of_last.empty()) return;
      start_px += state.unpredicted_px_s
                      ? Eigen::Vector2d(step.seconds * *state.unpredicted_px_s)
                      : motions_of_last.at(state.point.place_px).value_or(LocalMotion{}).displacement_px;
    }
    thread.find(state, start_px, &candidate);
    // Without a residual velocity it may have been found by chance, unless it is certain and near: search_far()
    // decides.
    constexpr double kSurePx = 0.5, kMaxSurprisePx = 2;
    if (!candidate.predicted.by_residual && candidate.found &&
        (stddev_px(*candidate.found) > kSurePx || (candidate.found->place_px - start_px).norm() > kMaxSurprisePx)) {
      candidate.found.reset();
    }
  });
  return candidates;
}

void TrackSearch::search_far(const TrackStep& step, const std::vector<TrackState>& states,
                             std::vector<TrackCandidate>* candidates) {
  // If half of the points were found, the others that residual velocities predict are outside the image or hidden. If
  // nearly all were, so are those that the last motion predicts; a few are not worth both images' pyramids.
  const auto found = std::count_if(candidates->begin(), candidates->end(),
                                   [](const TrackCandidate& each) { return each.found.has_value(); });
  const double share = static_cast<double>(found) / static_cast<double>(std::max<std::size_t>(1, states.size()));
  constexpr double kMost = 0.5, kNearlyAll = 0.9;
  std::vector<std::size_t> open;
  std::vector<cv::Point2f> before, start;
  for (std::size_t i = 0; i < states.size(); ++i) {
    if ((*candidates)[i].found || share > ((*candidates)[i].predicted.by_residual ? kMost : kNearlyAll)) continue;
    open.push_back(i);
    before.push_back(to_cv(states[i].point.place_px));
    start.push_back(to_cv((*candidates)[i].predicted.place_px));
  }
  if (open.empty()) return;
  // As in VINS-Mono's tracker.
  constexpr int kLevels = 3;
  constexpr double kMaxRoundTripPx = 1;
  const TrackerOptions& options = step.options;
  if (pyramid_before_.empty()) {
    pyramid_before_ = corner_pyramid(step.before.luminance(), options.window_px, kLevels);
  }
  pyramid_ = corner_pyramid(step.now.luminance(), options.window_px, kLevels);
  const FollowedCorners corners = follow_there_and_back(
      pyramid_before_, pyramid_, before, start,
      {options.window_px, kLevels,
       cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.05),  // a start: the alignment follows
       kMaxRoundTripPx});
  for_each(open.size(), step, [&](std::size_t k, const Thread& thread) {
    TrackCandidate& candidate = (*candidates)[open[k]];
    if (candidate.predicted.by_residual && !corners.found[k]) return;
    const Eigen::Vector2d start_px =
        corners.found[k] ? Eigen::Vector2d(corners.places[k].x, corners.places[k].y) : candidate.predicted.place_px;
    thread.find(states[open[k]], start_px, &candidate);
  });
}

void TrackSearch::refine(const TrackStep& step, std::vector<TrackCandidate>* candidates,
                         std::vector<TrackState>* states) {
  // Against the rotation alone: what tracks show of the velocities around them is smoother, and more accurate, than
  // residual velocities from block to block.
  std::vector<DisplacedPoint> displaced;
  for (std::size_t i = 0; i < candidates->size(); ++i) {
    const TrackCandidate& candidate = (*candidates)[i];
    if (!candidate.found) continue;
    displaced.push_back({(*states)[i].point.place_px, candidate.found->place_px - candidate.predicted.rotated_px});
  }
  const LocalMotions motions(std::move(displaced));
  for_each(candidates->size(), step, [&](std::size_t i, const Thread& thread) {
    TrackCandidate& candidate = (*candidates)[i];
    TrackState& state = (*states)[i];
    PredictedPoint& predicted = candidate.predicted;
    const std::optional<LocalMotion> local =
        motions.at(state.point.place_px, predicted.map.jacobian - predicted.rotated_map);
    // Where the map stays what it was, the patches do too: this moves the corner of a window by a fifth of a pixel.
    // With half of it errors are 1 % smaller.
    constexpr double kLeastSlope = 0.02;
    bool has_changed = false;
    Eigen::Vector2d start_px = predicted.place_px;
    if (local) {
      const Eigen::Matrix2d map = predicted.rotated_map + local->slope;
      has_changed = (map - predicted.map.jacobian).norm() > kLeastSlope;
      predicted.map.jacobian = map;
      start_px = predicted.rotated_px + local->displacement_px;
    }
    if (!candidate.found || has_changed) {
      thread.find(state, candidate.found ? candidate.found->place_px : start_px, &candidate);
    }
    if (!candidate.found) return;
    state.residual_slope_1_s.reset();
    if (local) state.residual_slope_1_s = local->slope / step.seconds;
    thread.advance(&state, &candidate);
  });
}

std::vector<TrackCandidate> TrackSearch::follow(const TrackStep& step, std::vector<TrackState>* states) {
  const AwakeHelpers helpers(step.threads);
  pyramid_before_ = std::move(pyramid_);
  pyramid_.clear();
  std::vector<TrackCandidate> candidates = search(step, *states);
  search_far(step, *states, &candidates);
  refine(step, &candidates, states);
  return candidates;
}

}  // namespace gyro_deblur
