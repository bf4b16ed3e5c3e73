// Tracks points through a few frames and rejects those that do not look as they did in the first.
#include "calibrate/frame_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <utility>

#include "base/require_range.hpp"
#include "blur/image_noise.hpp"
#include "features/corner_following.hpp"
#include "features/local_motion.hpp"

namespace gyro_deblur {
namespace {

/// Frames that a window has at most.
constexpr std::size_t kWindowFrames = 4;

/// From frame to frame. With four halvings steps of about 300 px are followed.
CornerSearch search_to_next_frame() {
  constexpr int kHalvings = 4, kMaxIterations = 30;
  constexpr double kEnoughPx = 0.05;  // an alignment follows
  constexpr double kMaxRoundTripPx = 0.3;
  return {AlignmentOptions{}.window_px, kHalvings,
          cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, kMaxIterations, kEnoughPx),
          kMaxRoundTripPx};
}

Eigen::Vector2d to_eigen(const cv::Point2f& p) { return {p.x, p.y}; }
cv::Point2f to_cv(const Eigen::Vector2d& p) { return {static_cast<float>(p.x()), static_cast<float>(p.y())}; }

/// Path of a point that moves uniformly, as it does nearly during an exposure.
Path2d path_during(const FrameTime& frame, const Eigen::Vector2d& velocity_px_s) {
  const Eigen::Vector2d length_px = to_seconds(frame.exposure_ns) * velocity_px_s;
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    path_px[k] = ((static_cast<double>(k) / (kPathInstants - 1) - 0.5) * length_px).cast<float>();
  }
  return path_px;
}

}  // namespace

FrameTracker::FrameTracker(int max_points) : max_points_(max_points) {
  require_range("max_points", max_points, 10, 10000);
}

void FrameTracker::add(const FrameTime& time, const cv::Mat& luminance) {
  if (luminance.type() != CV_8UC1 || luminance.empty() || (!size_.empty() && luminance.size() != size_)) {
    throw std::invalid_argument("FrameTracker: frames have to be CV_8UC1 and of one size");
  }
  size_ = luminance.size();
  const CornerSearch search = search_to_next_frame();
  Frame frame{time, corner_pyramid(luminance, search.window_px, search.levels),
              std::max(kRoundingNoise, image_noise(luminance, PixelLayout::GRAY).value_or(kRoundingNoise))};
  for (Anchor& anchor : growing_) {
    windows_[anchor.window].frames.push_back(time);
    follow(frame, &anchor);
  }
  if (!growing_.empty() && windows_[growing_.front().window].frames.size() >= kWindowFrames) growing_.pop_front();
  start(frame);
  previous_ = std::move(frame);
}

void FrameTracker::start(const Frame& frame) {
  // Spread over the image: rows are what a rolling shutter is seen in.
  const double min_distance_px = 0.5 * std::sqrt(static_cast<double>(size_.area()) / max_points_);
  Anchor anchor{windows_.size(), frame.pyramid.front(), {}};
  TrackWindow window;
  window.frames = {frame.time};
  const int margin_px = AlignmentOptions{}.window_px / 2;
  for (const Eigen::Vector2d& corner_px :
       detector_.detect(anchor.image, {max_points_, min_distance_px, margin_px, cv::Mat(), {}})) {
    anchor.points.push_back({window.tracks.size(), {corner_px, still_path(), frame.noise}, to_cv(corner_px)});
    window.tracks.push_back({corner_px});
  }
  windows_.push_back(std::move(window));
  growing_.push_back(std::move(anchor));
}

void FrameTracker::follow(const Frame& frame, Anchor* anchor) {
  TrackWindow& window = windows_[anchor->window];
  const double step_s = to_seconds(frame.time.stamp_ns - previous_.time.stamp_ns);
  std::vector<cv::Point2f> last_px;
  for (const Point& point : anchor->points) last_px.push_back(point.last_px);
  const FollowedCorners followed =
      follow_there_and_back(previous_.pyramid, frame.pyramid, last_px, last_px, search_to_next_frame());
  std::vector<DisplacedPoint> displaced;
  for (std::size_t i = 0; i < last_px.size(); ++i) {
    if (!followed.found[i]) continue;
    const Eigen::Vector2d& from_px = anchor->points[i].in_first.place_px;
    displaced.push_back({from_px, to_eigen(followed.places[i]) - from_px});
  }
  const LocalMotions motions(std::move(displaced));
  std::vector<Point> points;
  for (std::size_t i = 0; i < last_px.size(); ++i) {
    if (!followed.found[i]) continue;
    Point point = anchor->points[i];
    const Eigen::Vector2d start_px = to_eigen(followed.places[i]),
                          velocity_px_s = (start_px - to_eigen(last_px[i])) / step_s;
    if (window.frames.size() == 2) point.velocity_px_s = velocity_px_s;
    // A velocity between two frames is that halfway.
    const Eigen::Vector2d half_change_px_s = 0.5 * (velocity_px_s - point.velocity_px_s);
    if (window.frames.size() <= 3) {
      point.in_first.path_px = path_during(window.frames.front(), point.velocity_px_s - half_change_px_s);
    }
    const BlurredPoint in_this{start_px, path_during(frame.time, velocity_px_s + half_change_px_s), frame.noise};
    point.velocity_px_s = velocity_px_s;
    // Without the distortion a patch that rotates or grows pulls its point along, and all points of a surface in the
    // same way.
    const Eigen::Matrix2d map =
        Eigen::Matrix2d::Identity() + motions.at(point.in_first.place_px).value_or(LocalMotion{}).slope;
    const std::optional<Alignment> found =
        aligner_.align(anchor->image, point.in_first, frame.pyramid.front(), in_this, map, {});
    if (!found || !agrees(*found)) continue;
    window.tracks[point.track].to_px.push_back(found->place_px);
    point.last_px = to_cv(found->place_px);
    points.push_back(point);
  }
  anchor->points = std::move(points);
}

void FrameTracker::cut() {
  growing_.clear();
  previous_ = {};
}

std::vector<TrackWindow> FrameTracker::take() {
  cut();
  std::vector<TrackWindow> taken;
  for (TrackWindow& window : windows_) {
    window.tracks.erase(std::remove_if(window.tracks.begin(), window.tracks.end(),
                                       [](const PointTrack& track) { return track.to_px.empty(); }),
                        window.tracks.end());
    if (window.frames.size() >= 2) taken.push_back(std::move(window));
  }
  windows_.clear();
  return taken;
}

}  // namespace gyro_deblur
