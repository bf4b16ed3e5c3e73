// A rolling-shutter image as a global shutter would have seen it (paper section III-C, for every pixel).
#pragma once

#include <opencv2/core.hpp>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Where a global-shutter image takes its pixels from: known at nodes, cubic between them.
class GlobalShutterMap {
 public:
  /// Between nodes. The centres of blocks of 32 px and its multiples are among them.
  static constexpr int kStepPx = 16;

  /// Nothing is known.
  bool empty() const { return nodes_px_.empty(); }
  cv::Size size() const { return size_; }

  /// Where the image as it arrived shows what the global-shutter image shows at `pixel_px`; may lie beyond its border.
  /// Preconditions: not empty, a pixel of the image.
  Eigen::Vector2d at(const Eigen::Vector2d& pixel_px) const;

 private:
  friend GlobalShutterMap global_shutter_map(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                                             const RowExposure& exposure, TimeNs reference_ns, int threads);
  friend cv::Mat to_global_shutter(const cv::Mat& image, const GlobalShutterMap& map, int threads);
  /// Where the pixels of rows [begin, begin + x_px.rows) come from: CV_32FC1 as wide as whole cells of nodes.
  void fill(int begin, cv::Mat* x_px, cv::Mat* y_px) const;

  cv::Size size_;
  cv::Mat nodes_px_;  // CV_32FC2; one step more than what encloses the image on all sides
};

/// True when all rows are exposed at once, around the reference time: the image is what a map would make of it, except
/// for BlockBlur::apparent_offset_px(), which is not worth resampling it.
bool is_global_shutter(const RowExposure& exposure, TimeNs reference_ns);

/// Map that moves every row to `reference_ns`. The inverse of rectify_points(), which moves q to p if this map takes p
/// from q (accuracy: doc/guides/topics.md#global-shutter-images). Blocks that rectify_points() does not move follow
/// their neighbours: an image has to stay whole. For the same reason rows whose time to the reference `motion` does not
/// cover are moved as far as the nearest row that it covers, and what is beyond the lens model as what is nearest
/// within. Empty where `motion` covers no row, or nothing lies within the lens model.
/// @param field    of the whole image (at least one block)
/// @param threads  at most; 0: one for each core
GlobalShutterMap global_shutter_map(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                                    const RowExposure& exposure, TimeNs reference_ns, int threads = 0);

/// The image resampled by the map, once and bilinearly. Pixels that the map takes from outside the image are black,
/// which shows where the image ends.
/// @param image  CV_8U or CV_16U of the map's size, 1, 3 or 4 channels, sides below 32767 px; not a Bayer mosaic
/// Throws std::invalid_argument when image and map do not fit, or the map is empty.
cv::Mat to_global_shutter(const cv::Mat& image, const GlobalShutterMap& map, int threads = 0);

}  // namespace gyro_deblur
