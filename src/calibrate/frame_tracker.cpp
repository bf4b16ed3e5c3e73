// Tracks points through a few frames and rejects those that do not move with their neighbours.
#include "calibrate/frame_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>

#include <opencv2/imgproc.hpp>

#include "base/require_range.hpp"
#include "features/corner_following.hpp"

namespace gyro_deblur {
namespace {

constexpr int kPatchPx = 21;
/// With the window above, steps of about 300 px from frame to frame are followed.
constexpr int kPyramidLevels = 4;
/// Frames that a window has at most.
constexpr std::size_t kWindowFrames = 4;
/// How far from its start a point may end up when followed back.
constexpr double kMaxReturnPx = 0.3;

const cv::TermCriteria& until() {
  static const cv::TermCriteria criteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.003);
  return criteria;
}

/// How the surroundings of each point are distorted between two frames: the affine map that fits its neighbours best.
std::vector<cv::Matx22d> local_distortions(const std::vector<cv::Point2f>& from, const std::vector<cv::Point2f>& to) {
  constexpr std::size_t kNeighbours = 12, kFewest = 6;
  constexpr double kMostDistortion = 0.5;
  std::vector<cv::Matx22d> distortions(from.size(), cv::Matx22d::eye());
  std::vector<std::size_t> order(from.size());
  for (std::size_t i = 0; i < from.size(); ++i) {
    std::iota(order.begin(), order.end(), std::size_t{0});
    const std::size_t count = std::min(kNeighbours + 1, order.size());
    if (count < kFewest + 1) continue;
    std::partial_sort(
        order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count), order.end(),
        [&](std::size_t a, std::size_t b) { return cv::norm(from[a] - from[i]) < cv::norm(from[b] - from[i]); });
    cv::Point2d from_mean, to_mean;
    for (std::size_t k = 0; k < count; ++k) {
      from_mean += cv::Point2d(from[order[k]]) / static_cast<double>(count);
      to_mean += cv::Point2d(to[order[k]]) / static_cast<double>(count);
    }
    cv::Matx22d moment = cv::Matx22d::zeros(), cross = cv::Matx22d::zeros();
    for (std::size_t k = 0; k < count; ++k) {
      const cv::Point2d a = cv::Point2d(from[order[k]]) - from_mean, b = cv::Point2d(to[order[k]]) - to_mean;
      moment += cv::Matx22d(a.x * a.x, a.x * a.y, a.x * a.y, a.y * a.y);
      cross += cv::Matx22d(b.x * a.x, b.x * a.y, b.y * a.x, b.y * a.y);
    }
    bool invertible = false;
    const cv::Matx22d A = cross * moment.inv(cv::DECOMP_LU, &invertible);
    if (invertible && cv::norm(A - cv::Matx22d::eye()) < kMostDistortion) distortions[i] = A;
  }
  return distortions;
}

/// Half of the side of a tile of a mosaic: the window, and room to move.
constexpr int kTileReach = 16;
constexpr int kTile = 2 * kTileReach + 1;

/// The distorted surroundings of all points, side by side.
cv::Mat mosaic(const cv::Mat& image, const std::vector<cv::Point2f>& points,
               const std::vector<cv::Matx22d>& distortions) {
  const int rows = kTile * static_cast<int>(points.size());
  cv::Mat map_x(rows, kTile, CV_32F), map_y(rows, kTile, CV_32F), result;
  for (int y = 0; y < rows; ++y) {
    const auto i = static_cast<std::size_t>(y / kTile);
    for (int x = 0; x < kTile; ++x) {
      const cv::Vec2d offset =
          distortions[i] * cv::Vec2d(static_cast<double>(x) - kTileReach, static_cast<double>(y % kTile) - kTileReach);
      map_x.at<float>(y, x) = points[i].x + static_cast<float>(offset[0]);
      map_y.at<float>(y, x) = points[i].y + static_cast<float>(offset[1]);
    }
  }
  cv::remap(image, result, map_x, map_y, cv::INTER_CUBIC, cv::BORDER_REFLECT_101);
  return result;
}

/// Moves the points to where their surroundings fit best, distortion allowed for: without that, a patch that rotates or
/// grows pulls its point along, and all points of a surface in the same way.
/// @param to  [in] where they are to within some pixels [out]
std::vector<char> align(const cv::Mat& from_image, const cv::Mat& to_image, const std::vector<cv::Point2f>& from,
                        std::vector<cv::Point2f>* to) {
  if (from.empty()) return {};
  const std::vector<cv::Matx22d> distortions = local_distortions(from, *to);
  const std::vector<cv::Matx22d> none(from.size(), cv::Matx22d::eye());
  const cv::Mat from_tiles = mosaic(from_image, from, none), to_tiles = mosaic(to_image, *to, distortions);
  std::vector<cv::Point2f> centers;
  for (std::size_t i = 0; i < from.size(); ++i) {
    centers.emplace_back(static_cast<float>(kTileReach), static_cast<float>(kTile * static_cast<int>(i) + kTileReach));
  }
  FollowedCorners followed =
      follow_there_and_back(corner_pyramid(from_tiles, kPatchPx, 0), corner_pyramid(to_tiles, kPatchPx, 0), centers,
                            centers, {kPatchPx, 0, until(), kMaxReturnPx});
  for (std::size_t i = 0; i < from.size(); ++i) {
    const cv::Point2f& found = followed.places[i];
    const cv::Vec2d moved = distortions[i] * cv::Vec2d(found.x - centers[i].x, found.y - centers[i].y);
    (*to)[i] += cv::Point2f(static_cast<float>(moved[0]), static_cast<float>(moved[1]));
  }
  return std::move(followed.found);
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
  std::vector<cv::Mat> pyramid = corner_pyramid(luminance, kPatchPx, kPyramidLevels);
  for (Anchor& anchor : growing_) {
    windows_[anchor.window].frames.push_back(time);
    follow(&anchor, pyramid, luminance.size());
  }
  if (!growing_.empty() && windows_[growing_.front().window].frames.size() >= kWindowFrames) growing_.pop_front();
  start(time, luminance, pyramid);
  previous_ = std::move(pyramid);
}

void FrameTracker::start(const FrameTime& time, const cv::Mat& luminance, const std::vector<cv::Mat>& pyramid) {
  constexpr double kQuality = 0.01;
  // Spread over the image: rows are what a rolling shutter is seen in.
  const double min_distance_px = 0.5 * std::sqrt(static_cast<double>(luminance.total()) / max_points_);
  Anchor anchor{windows_.size(), pyramid, {}, {}, {}};
  cv::goodFeaturesToTrack(luminance, anchor.points, max_points_, kQuality, min_distance_px);
  TrackWindow window;
  window.frames = {time};
  if (!anchor.points.empty()) cv::cornerSubPix(luminance, anchor.points, cv::Size(3, 3), cv::Size(-1, -1), until());
  for (const cv::Point2f& point : anchor.points) {
    anchor.tracks.push_back(window.tracks.size());
    window.tracks.push_back({Eigen::Vector2d(point.x, point.y)});
  }
  anchor.last = anchor.points;
  windows_.push_back(std::move(window));
  growing_.push_back(std::move(anchor));
}

void FrameTracker::follow(Anchor* anchor, const std::vector<cv::Mat>& pyramid, const cv::Size& size) {
  const auto keep = [anchor](const std::vector<char>& good, std::vector<cv::Point2f>* to) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < good.size(); ++i) {
      if (!good[i]) continue;
      anchor->points[kept] = anchor->points[i];
      anchor->tracks[kept] = anchor->tracks[i];
      (*to)[kept] = (*to)[i];
      ++kept;
    }
    anchor->points.resize(kept);
    anchor->tracks.resize(kept);
    to->resize(kept);
  };
  FollowedCorners followed = follow_there_and_back(previous_, pyramid, anchor->last, anchor->last,
                                                   {kPatchPx, kPyramidLevels, until(), kMaxReturnPx});
  std::vector<cv::Point2f>& to = followed.places;
  keep(followed.found, &to);
  std::vector<char> good = align(anchor->pyramid[0], pyramid[0], anchor->points, &to);
  // What is beyond the border is made up.
  const int reach = kPatchPx / 2;
  const cv::Rect2f inside(static_cast<float>(reach), static_cast<float>(reach),
                          static_cast<float>(size.width - 2 * reach), static_cast<float>(size.height - 2 * reach));
  for (std::size_t i = 0; i < to.size(); ++i) {
    good[i] = good[i] && inside.contains(anchor->points[i]) && inside.contains(to[i]);
  }
  keep(good, &to);
  for (std::size_t i = 0; i < to.size(); ++i) {
    windows_[anchor->window].tracks[anchor->tracks[i]].to_px.emplace_back(to[i].x, to[i].y);
  }
  anchor->last = std::move(to);
}

void FrameTracker::cut() {
  growing_.clear();
  previous_.clear();
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
