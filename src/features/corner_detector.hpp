// New corners, away from those that are followed.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "features/corner_simd.hpp"
#include "features/corner_strength.hpp"

namespace gyro_deblur {

/// Where corners may start.
struct CornerRequest {
  int count;                                  ///< at most
  double min_distance_px;                     ///< > 0: from each other and from those that are followed
  int margin_px;                              ///< from the image's edge; less than 8 counts as 8
  const cv::Mat& allowed;                     ///< CV_8UC1 of the image's size, not 0 where one may be; or empty
  const std::vector<Eigen::Vector2d>& taken;  ///< those that are followed
};

/// Strongest gradients in both directions, in an image of half the size: noise makes fewer corners of its own there.
/// Keeps its buffers. Not thread-safe.
class CornerDetector {
 public:
  /// @param luminance  CV_8UC1
  /// @return pixels of the image, strongest first; none weaker than a hundredth of the strongest
  std::vector<Eigen::Vector2d> detect(const cv::Mat& luminance, const CornerRequest& request);

 private:
  struct Peak {
    float strength;
    int x, y;
  };

  /// Makes free_ and blocks_with_free_.
  void mark_free(const CornerRequest& request);
  /// Calls body(first, end) for columns of a row, from left to right: those of all blocks that have a free pixel within
  /// `around` rows, and `around` columns more on either side.
  template <typename Body>
  void for_each_free_run(int y, int around, Body&& body) const;
  /// Makes strengths_ of what is free, and of its neighbours.
  void rate(const cv::Mat& luminance);
  void find_peaks();

  int width_ = 0, height_ = 0;  // of the half image
  CornerStrengths strengths_;   // of the half image
  cv::Mat1b free_;              // of half the size: not 0 where a corner keeps its distance
  // Few pixels are free where most of the tracks live on. One word for each row, and in it a bit for each block.
  std::vector<std::uint64_t> blocks_with_free_;
  int block_width_ = 0;
  std::vector<int> columns_;
  std::vector<Peak> peaks_;
  const CornerSimd& simd_ = select_for_cpu<CornerSimd>();
};

}  // namespace gyro_deblur
