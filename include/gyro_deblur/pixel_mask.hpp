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
  /// Eroded mask: CV_8UC1, 255 where every pixel of the (2 half_px + 1)^2 window around is used, else 0; empty: all are
  /// used. Precondition: half_px >= 0.
  cv::Mat with_used_window(int half_px) const;
  /// True if both share their pixels. An equal mask with pixels of its own counts as different.
  bool is_same(const PixelMask& other) const { return used_.data == other.used_.data; }
  /// Number of masked pixels in the rectangle [px]; pixels outside of the image count as used.
  int masked_in(const cv::Rect& rect) const;

 private:
  cv::Mat used_;
  cv::Mat masked_sums_;  // integral image
};

/// Sets the status of blocks without a used pixel to MASKED, unless all blocks are NO_GYRO.
/// Throws std::invalid_argument if the mask is neither empty nor of the field's size.
void mark_masked(const PixelMask& mask, FrameBlur* field);

/// How far filters read beyond their block.
struct FilterReach {
  double length_factor = 4;  ///< length of a 1-D filter in extents, FilterOptions::length_factor
  bool in_2d = false;        ///< all blocks have a 2-D filter, as those of engine "fourier"
};

/// Sets the status of DEBLURRED blocks to STATIC_EDGE if a pixel of theirs, or one that their filter would read, is
/// masked: a filter makes rings of an edge that is not blurred. A 2-D filter reads a block's neighbours on all sides:
/// where a 1-D filter would not read a masked pixel, paths that deviate from their line by at most
/// kMaxStraightDeviationPx lose their curved_path_px instead.
/// Throws std::invalid_argument if the mask is neither empty nor of the field's size.
void mark_static_edges(const PixelMask& mask, const FilterReach& reach, FrameBlur* field);

}  // namespace gyro_deblur
