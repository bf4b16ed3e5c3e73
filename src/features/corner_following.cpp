// Follows corners by pyramidal Lucas-Kanade tracking, forth and back.
#include "features/corner_following.hpp"

#include <cstddef>
#include <utility>

#include <opencv2/video/tracking.hpp>

namespace gyro_deblur {

std::vector<cv::Mat> corner_pyramid(const cv::Mat& image, int window_px, int levels) {
  std::vector<cv::Mat> pyramid;
  constexpr bool kWithDerivatives = true, kReuseInput = true;  // never the input's memory: it is the caller's
  cv::buildOpticalFlowPyramid(image, pyramid, {window_px, window_px}, levels, kWithDerivatives, cv::BORDER_REFLECT_101,
                              cv::BORDER_CONSTANT, !kReuseInput);
  return pyramid;
}

FollowedCorners follow_there_and_back(const std::vector<cv::Mat>& from, const std::vector<cv::Mat>& to,
                                      const std::vector<cv::Point2f>& before, const std::vector<cv::Point2f>& start,
                                      const CornerSearch& search) {
  if (before.empty()) return {};
  const cv::Size window(search.window_px, search.window_px);
  std::vector<uchar> found, found_back;
  std::vector<float> unused;
  std::vector<cv::Point2f> places = start, back;
  cv::calcOpticalFlowPyrLK(from, to, before, places, found, unused, window, search.levels, search.criteria,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  // Backwards the search starts as far from its goal as it did forwards.
  for (std::size_t i = 0; i < places.size(); ++i) back.push_back(places[i] - (start[i] - before[i]));
  cv::calcOpticalFlowPyrLK(to, from, places, back, found_back, unused, window, search.levels, search.criteria,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  FollowedCorners followed{std::move(places), std::vector<char>(before.size())};
  for (std::size_t i = 0; i < before.size(); ++i) {
    followed.found[i] = found[i] && found_back[i] && cv::norm(back[i] - before[i]) <= search.max_round_trip_px;
  }
  return followed;
}

}  // namespace gyro_deblur
