// Corners followed from an image into the next one, and back; smaller images for that.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

namespace gyro_deblur {

/// How Lucas-Kanade searches, in pixels of the pyramids' largest image.
struct CornerSearch {
  int window_px;  ///< odd: side of the patch that is compared
  int levels;     ///< halvings of the image
  cv::TermCriteria criteria;
  double max_round_trip_px;  ///< how far from its start a corner may end up when followed back
};

/// Half the size, smoothed, as cv::pyrDown() makes it: pixel (x, y) is at (2 x, 2 y).
/// @param threads  at most; 0: one for each core
cv::Mat downsample2x(const cv::Mat& image, int threads);

/// An image that corners are searched in: halved until it is no wider than 250 px. In a larger one blur is longer, and
/// the search takes longer.
struct SearchImage {
  double scale = 1;              ///< pixels of the whole image in one of it; a power of 2
  std::vector<cv::Mat> pyramid;  ///< of corner_pyramid()
};

/// @param luminance  CV_8UC1
/// @param threads    at most; 0: one for each core
SearchImage search_image(const cv::Mat& luminance, int threads);

/// How corners are searched in a SearchImage.
constexpr int kSearchWindowPx = 9, kSearchLevels = 2;
CornerSearch corner_search();

/// Where a corner of a smaller image may be: 255, so that no masked pixel is in its window, else 0.
/// @param used  of a PixelMask
/// @param size  of the smaller image
cv::Mat shrink_mask(const cv::Mat& used, const cv::Size& size, int window_px);

/// With derivatives, for follow_there_and_back(); a copy of the image's pixels.
/// @param image  CV_8UC1
std::vector<cv::Mat> corner_pyramid(const cv::Mat& image, int window_px, int levels);

/// Corners in the next image.
struct FollowedCorners {
  std::vector<cv::Point2f> places;  ///< one for each corner
  std::vector<char> found;          ///< and it came back to where it was
};

/// @param from   of the image before
/// @param to     of the next one, of the same size
/// @param before  corners in the image before
/// @param start   where each is looked for; may lie outside the image
FollowedCorners follow_there_and_back(const std::vector<cv::Mat>& from, const std::vector<cv::Mat>& to,
                                      const std::vector<cv::Point2f>& before, const std::vector<cv::Point2f>& start,
                                      const CornerSearch& search);

}  // namespace gyro_deblur
