// Points followed through a few frames, for calibration.
#pragma once

#include <deque>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// A frame's time, camera clock, and exposure.
struct FrameTime {
  TimeNs stamp_ns = 0;
  TimeNs exposure_ns = 0;  ///< [0, 1 s]; 0 when it is not known: an estimated time offset then contains half of it
};

/// Where one point of the scene is in some frames, in the pixels of the images as they arrive.
struct PointTrack {
  Eigen::Vector2d from_px;               ///< in the first frame
  std::vector<Eigen::Vector2d> to_px{};  ///< in those after it, one after the other, until it is lost
};

/// A few frames, one after the other, and the points of the first that are found again.
struct TrackWindow {
  std::vector<FrameTime> frames;
  std::vector<PointTrack> tracks;  ///< each in the second frame at least
};

/// Follows corners by pyramidal Lucas-Kanade, there and back as a check. Every frame starts a window with corners of
/// its own; what is found in later frames is aligned with its surroundings in the first, so that no drift builds up.
class FrameTracker {
 public:
  /// @param max_points  [10, 10000] of each window
  /// Throws OptionError.
  explicit FrameTracker(int max_points = 200);

  /// @param luminance  CV_8UC1, all of the same size
  /// Throws std::invalid_argument for another type or size.
  void add(const FrameTime& time, const cv::Mat& luminance);

  /// The next frame has nothing to do with those before it.
  void cut();

  /// The windows so far, in the order of their first frames, those that still grow among them. Forgets all frames.
  std::vector<TrackWindow> take();

 private:
  struct Anchor {
    std::size_t window;  ///< of windows_
    std::vector<cv::Mat> pyramid;
    std::vector<cv::Point2f> points, last;  ///< in the first frame and in the newest, of the tracks that go on
    std::vector<std::size_t> tracks;        ///< of the window
  };

  void start(const FrameTime& time, const cv::Mat& luminance, const std::vector<cv::Mat>& pyramid);
  void follow(Anchor* anchor, const std::vector<cv::Mat>& pyramid, const cv::Size& size);

  int max_points_;
  std::vector<TrackWindow> windows_;
  std::deque<Anchor> growing_;
  std::vector<cv::Mat> previous_;  ///< pyramid of the frame before
  cv::Size size_;
};

}  // namespace gyro_deblur
