// Follows corners by pyramidal Lucas-Kanade tracking, forth and back.
#include "features/corner_following.hpp"

#include <algorithm>
#include <cstddef>
#include <utility>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "base/parallel.hpp"

namespace gyro_deblur {

cv::Mat downsample2x(const cv::Mat& image, int threads) {
  // A band of rows, and what the filter of five rows reaches beyond it.
  constexpr int kBandRows = 64, kMargin = 1;
  cv::Mat half((image.rows + 1) / 2, (image.cols + 1) / 2, image.type());
  const int bands = (half.rows + kBandRows - 1) / kBandRows;
  parallel_for(bands, threads, 1, [&](int band) {
    const int begin = band * kBandRows, end = std::min(begin + kBandRows, half.rows);
    const int first = std::max(begin - kMargin, 0), last = std::min(end + kMargin, half.rows);
    thread_local cv::Mat rows;
    cv::pyrDown(image.rowRange(2 * first, std::min(2 * last, image.rows)), rows);
    rows.rowRange(begin - first, end - first).copyTo(half.rowRange(begin, end));
  });
  return half;
}

// These values left the smallest error of optical flow on recorded flights (experiments/optical_flow).
SearchImage search_image(const cv::Mat& luminance, int threads) {
  constexpr int kLargestWidthPx = 250;
  SearchImage image;
  cv::Mat small = luminance;
  for (; small.cols > kLargestWidthPx; image.scale *= 2) small = downsample2x(small, threads);
  image.pyramid = corner_pyramid(small, kSearchWindowPx, kSearchLevels);
  return image;
}

CornerSearch corner_search() {
  constexpr int kIterations = 6;
  constexpr double kLeastStepPx = 0.03;  // corners are less accurate there
  constexpr double kMaxRoundTripPx = 0.4;
  return {kSearchWindowPx, kSearchLevels,
          cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, kIterations, kLeastStepPx),
          kMaxRoundTripPx};
}

cv::Mat shrink_mask(const cv::Mat& used, const cv::Size& size, int window_px) {
  constexpr int kWholly = 255;
  cv::Mat share, usable;
  cv::resize(used, share, size, 0, 0, cv::INTER_AREA);
  cv::erode(share == kWholly, usable, cv::getStructuringElement(cv::MORPH_RECT, {window_px, window_px}));
  return usable;
}

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
