// Textures of the simulated planes: photographs or procedural, prefiltered for every viewing distance.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include <opencv2/core.hpp>

namespace gyro_deblur::sim {

/// A texture and its smaller versions, four to the octave, each filtered so that bilinear sampling does not alias.
class Texture {
 public:
  /// @param base  CV_8UC1 or CV_8UC3 (BGR), at least 16x16
  explicit Texture(const cv::Mat& base);

  int width_px() const { return base_.cols; }
  int height_px() const { return base_.rows; }

  /// The level to sample for a view in which one image pixel spans this many texels of the base (> 0).
  int level_for(double texels_per_pixel) const;
  /// The level as CV_32F grey levels, built at the first call. Not thread-safe.
  const cv::Mat& level(int index);

 private:
  cv::Mat base_;
  int last_level_;
  std::map<int, cv::Mat> levels_;
};

/// Reads a photograph. Throws OptionError with the path when it cannot be read.
cv::Mat load_texture(const std::string& path);

/// Dead leaves: overlapping discs, polygons and text marks, from large to a few pixels with frequency ~ size^-3, which
/// gives the 1/f amplitude spectrum of natural images (Lee, Mumford and Huang, IJCV 2001) and many corners.
/// @return CV_8UC3; equal arguments give equal images
cv::Mat procedural_texture(int width_px, int height_px, std::uint64_t seed);

}  // namespace gyro_deblur::sim
