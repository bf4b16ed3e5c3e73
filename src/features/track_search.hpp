// Where the points of one image are in the next: by the predicted motion, neighbours, and blur-aware alignment.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "features/blur_alignment.hpp"
#include "features/blurred_view.hpp"
#include "features/remembered_motion.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Side of the largest window at the whole size that points are compared in.
constexpr int largest_window_px(int sharp_window_px) {
  return std::max(sharp_window_px, std::min(101, 2 * sharp_window_px - 1));
}
/// Side in pixels of half the size that takes the place of one in pixels of the whole: it covers a quarter more. Odd.
constexpr int half_size_window_px(int window_px) { return 5 * window_px / 8 | 1; }
/// How far from a point its window may reach in pixels of the whole size.
constexpr int largest_reach_px(int sharp_window_px) {
  return 2 * (half_size_window_px(largest_window_px(sharp_window_px)) / 2) + 1;
}

/// An older template is replaced after so many images: its view of the patch has changed by then.
constexpr int kTemplateImages = 10;

/// What is known of a track in the newest image.
struct TrackState {
  BlurredPoint point;
  Eigen::Vector3d ray;  ///< its direction, z = 1
  /// The older template: where the point was in an image some back.
  std::shared_ptr<const BlurredView> anchor_view;
  BlurredPoint anchor;
  int anchor_age = 0;  ///< [images]
  /// Deviation from its prediction; nothing where a residual velocity predicted it, and at first.
  std::optional<Eigen::Vector2d> unpredicted_px_s;
  /// Jacobian of the velocities around it that the rotation does not explain; nothing at first.
  std::optional<Eigen::Matrix2d> residual_slope_1_s;
  LocalMap anchor_map;                                              ///< from there to the newest image
  Eigen::Matrix2d anchor_covariance_px2 = Eigen::Matrix2d::Zero();  ///< there, against where the track began
  Eigen::Matrix2d since_anchor_px2 = Eigen::Matrix2d::Zero();       ///< in the newest image, against the anchor

  /// In the newest image, against where the track began.
  Eigen::Matrix2d covariance_px2() const {
    return anchor_map.jacobian * anchor_covariance_px2 * anchor_map.jacobian.transpose() + since_anchor_px2;
  }
  /// The newest image becomes that of the older template.
  void anchor_at(const std::shared_ptr<const BlurredView>& newest);
};

/// One image to the next. Refers to what it was made of.
struct TrackStep {
  const BlurredView &before, &now;
  const Camera& camera;
  const CameraMotion& motion;
  double seconds;  ///< > 0
  const TrackerOptions& options;
  int threads;  ///< >= 0; 0: one for each core
};

/// A track in the new image.
struct TrackCandidate {
  PredictedPoint predicted;  ///< with the map by the last residual slope where that is known
  BlurredPoint near_start;   ///< the path of a point about there
  std::optional<Alignment> found;
  bool by_anchor = false;  ///< found from the older template, which needs no other
};

/// Finds points, on several threads. Keeps its buffers. Not thread-safe.
class TrackSearch {
 public:
  /// Forgets the image before.
  void reset() { pyramid_.clear(); }

  /// Takes the states of the points that are found to the new image.
  /// @return one for each state
  std::vector<TrackCandidate> follow(const TrackStep& step, std::vector<TrackState>* states);

 private:
  struct Thread;  // what each of them uses
  /// Calls body(i, thread) for i < count.
  template <typename Body>
  void for_each(std::size_t count, const TrackStep& step, Body&& body);

  /// Candidates with their predictions, found where these are good enough.
  std::vector<TrackCandidate> search(const TrackStep& step, const std::vector<TrackState>& states);
  /// By Lucas-Kanade over pyramids, those that were not found and may be elsewhere.
  void search_far(const TrackStep& step, const std::vector<TrackState>& states,
                  std::vector<TrackCandidate>* candidates);
  /// Again, with what the points that were found say of the motion around each, and takes the states there.
  void refine(const TrackStep& step, std::vector<TrackCandidate>* candidates, std::vector<TrackState>* states);

  std::vector<BlurAligner> aligners_;  // of the threads
  std::vector<cv::Mat> pyramid_;       // of the newest image; empty: not made
  std::vector<cv::Mat> pyramid_before_;
};

}  // namespace gyro_deblur
