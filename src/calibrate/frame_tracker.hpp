// Points followed through a few frames, for calibration.
#pragma once

#include <deque>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "features/blur_alignment.hpp"
#include "features/corner_detector.hpp"
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
/// its own; what is found in later frames is aligned with its surroundings in the first (BlurAligner), so that no drift
/// builds up. Blur is that of a straight path, by the velocities between frames.
class FrameTracker {
 public:
  /// @param max_points  [10, 10000] of each window
  /// Throws OptionError.
  explicit FrameTracker(int max_points = 200);

  /// @param time       later than that of the frame before, unless that was cut off
  /// @param luminance  CV_8UC1, all of the same size
  /// Throws std::invalid_argument for another type or size.
  void add(const FrameTime& time, const cv::Mat& luminance);

  /// The next frame has nothing to do with those before it.
  void cut();

  /// The windows so far, in the order of their first frames, those that still grow among them. Forgets all frames.
  std::vector<TrackWindow> take();

 private:
  struct Frame {
    FrameTime time;
    std::vector<cv::Mat> pyramid;
    double noise = 0;  ///< of BlurredPoint
  };
  /// A track that goes on.
  struct Point {
    std::size_t track;      ///< of the window
    BlurredPoint in_first;  ///< its path from the second frame on
    cv::Point2f last_px;
    Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();  ///< from the frame before the newest to the newest
  };
  struct Anchor {
    std::size_t window;  ///< of windows_
    cv::Mat image;       ///< first frame
    std::vector<Point> points;
  };

  void start(const Frame& frame);
  void follow(const Frame& frame, Anchor* anchor);

  int max_points_;
  std::vector<TrackWindow> windows_;
  std::deque<Anchor> growing_;
  Frame previous_;
  cv::Size size_;
  CornerDetector detector_;
  BlurAligner aligner_;
};

}  // namespace gyro_deblur
