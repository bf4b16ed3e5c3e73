#include "calibrate/frame_tracker.hpp"

#include <cmath>
#include <stdexcept>
#include <utility>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

const cv::Size kWindow(21, 21);
/// With the window above, steps of about 300 px from frame to frame are followed.
constexpr int kPyramidLevels = 4;

}  // namespace

void FrameTrackerOptions::validate() const {
  require_range("max_points", max_points, 10, 10000);
  require_range("max_return", max_return_px, 1e-6, 10, "px");
}

FrameTracker::FrameTracker(const FrameTrackerOptions& options) : options_(options) { options.validate(); }

std::vector<PointPair> FrameTracker::next(const cv::Mat& luminance) {
  if (luminance.type() != CV_8UC1 || luminance.empty() ||
      (!previous_.empty() && luminance.size() != previous_.size())) {
    throw std::invalid_argument("FrameTracker: frames have to be CV_8UC1 and of one size");
  }
  std::vector<cv::Mat> pyramid;
  cv::buildOpticalFlowPyramid(luminance, pyramid, kWindow, kPyramidLevels);
  std::vector<PointPair> pairs;
  if (!previous_.empty()) {
    constexpr double kQuality = 0.01;
    // Spread over the image: rows are what a rolling shutter is seen in.
    const double min_distance_px = 0.5 * std::sqrt(static_cast<double>(luminance.total()) / options_.max_points);
    std::vector<cv::Point2f> from, to, back;
    cv::goodFeaturesToTrack(previous_, from, options_.max_points, kQuality, min_distance_px);
    if (!from.empty()) {
      const cv::TermCriteria until(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 30, 0.003);
      cv::cornerSubPix(previous_, from, cv::Size(3, 3), cv::Size(-1, -1), until);
      std::vector<unsigned char> found, found_back;
      cv::calcOpticalFlowPyrLK(pyramid_, pyramid, from, to, found, cv::noArray(), kWindow, kPyramidLevels, until);
      cv::calcOpticalFlowPyrLK(pyramid, pyramid_, to, back, found_back, cv::noArray(), kWindow, kPyramidLevels, until);
      const cv::Rect2f inside(0, 0, static_cast<float>(luminance.cols - 1), static_cast<float>(luminance.rows - 1));
      for (std::size_t i = 0; i < from.size(); ++i) {
        if (found[i] == 0 || found_back[i] == 0 || !inside.contains(to[i])) continue;
        if (cv::norm(back[i] - from[i]) > options_.max_return_px) continue;
        pairs.push_back({Eigen::Vector2d(from[i].x, from[i].y), Eigen::Vector2d(to[i].x, to[i].y)});
      }
    }
  }
  luminance.copyTo(previous_);
  pyramid_ = std::move(pyramid);
  return pairs;
}

}  // namespace gyro_deblur
