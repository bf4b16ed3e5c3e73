// Pixels that do not show the scene: a lens's rim, a part of the vehicle.
#pragma once

#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Which pixels of an image are used. Copies share their pixels, which do not change.
class PixelMask {
 public:
  PixelMask() = default;  ///< all are used

  /// @param used  CV_8UC1 of the image's size, 0: the pixel is masked, as OpenCV's detectors have it; copied
  /// Throws std::invalid_argument for another type, and where no pixel is used.
  explicit PixelMask(const cv::Mat& used);

  bool empty() const { return used_.empty(); }
  cv::Size size() const { return used_.size(); }
  /// CV_8UC1: 255 where a pixel is used, 0 where it is masked; empty: all are used.
  const cv::Mat& pixels() const { return used_; }
  /// Precondition: a pixel of the image.
  bool uses(const cv::Point& pixel) const { return used_.empty() || used_.at<uchar>(pixel) != 0; }
  /// CV_8UC1: 255 where all pixels to half_px (>= 0) on either side are used, else 0; empty: all are used.
  cv::Mat with_used_window(int half_px) const;
  /// Both share their pixels; an equal copy is another mask.
  bool is_same(const PixelMask& other) const { return used_.data == other.used_.data; }
  /// How many pixels of the rectangle are masked; outside of the image none is.
  int masked_in(const cv::Rect& rect) const;

 private:
  cv::Mat used_;
  cv::Mat masked_sums_;  // integral image
};

/// Blocks without a used pixel become MASKED, unless all blocks are NO_GYRO: then nothing is known of the image.
/// Precondition: the mask is empty or of the field's size.
void mark_masked(const PixelMask& mask, FrameBlur* field);

/// What a block's filter reads, to either side of the block.
struct FilterReach {
  double length_factor = 4;  ///< FilterOptions::length_factor
  bool in_2d = false;        ///< all blocks have a 2-D filter, see Engine::prefers_2d()
};

/// DEBLURRED blocks become STATIC_EDGE where a pixel that they have, or that their filter would read, is masked: what
/// does not move with the camera is not blurred, and comes out as rings all over the reach of a filter.
/// Precondition: the mask is empty or of the field's size.
void mark_static_edges(const PixelMask& mask, const FilterReach& reach, FrameBlur* field);

}  // namespace gyro_deblur
