// The blur of one image: a grid of blocks, each blurred along a straight or curved path of its own.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// What became of one block of the image. Values equal the constants of gyro_deblur/BlurField.msg.
enum class BlockStatus : std::uint8_t {
  SHARP = 0,       ///< extent is, or may be, below min_extent_px: copied unchanged
  DEBLURRED = 1,   ///< deconvolved (before validation: to be deconvolved)
  REJECTED = 2,    ///< the image contradicts the predicted blur: copied unchanged, keypoints not rectified
  TOO_LARGE = 3,   ///< extent above max_extent_px: copied unchanged
  NO_GYRO = 4,     ///< no usable gyroscope samples, or beyond the range of the lens model: copied unchanged
  TOO_CURVED = 5,  ///< curved path, too long for the 2-D filter or no time for it: copied unchanged
  NOISY = 6,       ///< filtering would add more noise than it removes blur: copied unchanged
  MASKED = 7,      ///< no pixel of it is used, see PixelMask: copied unchanged
  /// Its pixels, or those that its filter would read, are masked in part or do not move with the camera in part: copied
  /// unchanged.
  STATIC_EDGE = 8,
};

/// All there are.
constexpr std::array<BlockStatus, 9> kBlockStatuses{
    BlockStatus::SHARP,     BlockStatus::DEBLURRED, BlockStatus::REJECTED,
    BlockStatus::TOO_LARGE, BlockStatus::NO_GYRO,   BlockStatus::TOO_CURVED,
    BlockStatus::NOISY,     BlockStatus::MASKED,    BlockStatus::STATIC_EDGE};

/// Name of the status, e.g. "DEBLURRED". Never null.
const char* to_string(BlockStatus status);

/// Whether the blur of a block with this status is known.
constexpr bool has_known_blur(BlockStatus status) {
  return status != BlockStatus::NO_GYRO && status != BlockStatus::MASKED;
}

/// Division of an image into blocks of block_size_px; the last column and row are what is left.
class BlockGrid {
 public:
  BlockGrid() = default;
  /// Preconditions: sizes >= 1.
  BlockGrid(int width_px, int height_px, int block_size_px);

  int width_px() const { return width_px_; }
  int height_px() const { return height_px_; }
  int block_size_px() const { return block_size_px_; }
  int cols() const { return cols_; }
  int rows() const { return rows_; }
  int size() const { return cols_ * rows_; }

  /// Blocks are numbered row by row. Precondition: 0 <= index < size().
  cv::Rect rect(int index) const;
  /// Centre of the block [px], pixel centres at integers.
  Eigen::Vector2d center(int index) const;
  /// Index of the block that holds the pixel; coordinates outside the image are clamped to it.
  int index_at(double x_px, double y_px) const;

  /// Four blocks whose centres are around a pixel, and their shares in a bilinear interpolation, which sum to 1; beyond
  /// the outermost centres those on the border.
  struct Neighbour {
    int index;
    double share;
  };
  std::array<Neighbour, 4> around(const Eigen::Vector2d& pixel_px) const;

  /// Calls f(index) for a block and its neighbours, row by row.
  template <typename F>
  void for_each_around(int index, const F& f) const {
    const int block_row = index / cols_, block_col = index % cols_;
    for (int row = std::max(block_row - 1, 0); row <= std::min(block_row + 1, rows_ - 1); ++row) {
      for (int col = std::max(block_col - 1, 0); col <= std::min(block_col + 1, cols_ - 1); ++col) {
        f(row * cols_ + col);
      }
    }
  }

  /// Throws std::invalid_argument that begins with `who` unless the luminance is CV_8UC1 of the grid's size.
  void require_luminance(const cv::Mat& luminance, const char* who) const;

 private:
  int width_px_ = 0, height_px_ = 0, block_size_px_ = 1, cols_ = 0, rows_ = 0;
};

/// Angle [rad] of an undirected line, folded into [0, pi). Finite input.
double axial_angle(double dx, double dy);

/// Image motion of a block that the rotation does not explain: translation over depth, a moving object, a bias of the
/// gyroscope.
struct ResidualVelocity {
  Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();
  double stddev_px_s = 0;  ///< of each component
};

/// One for each block of a grid, row by row, nothing where it is not known; or empty: known nowhere.
using ResidualField = std::vector<std::optional<ResidualVelocity>>;

/// The rotation that fits the residual velocities of one image best. One image is no evidence: translation in front of
/// a wall looks much the same.
struct ResidualRotation {
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();   ///< rate in addition to `known_rad_s`, axes of the camera
  Eigen::Vector3d known_rad_s = Eigen::Vector3d::Zero();  ///< rate that is known, in the same axes
  /// Mean square of the residual velocities, weighted by their uncertainty: as they are, less this rotation, and less
  /// the nearest translation before a plane across the optical axis.
  double energy_px2_s2 = 0, energy_less_rotation_px2_s2 = 0, energy_less_translation_px2_s2 = 0;
};

/// Instants at which a path is known, evenly from the start to the end of the exposure of the row that the point is in.
constexpr int kPathInstants = 9;

/// Straight path: places [px] of a scene point at kPathInstants along the line of its blur, relative to the place at
/// mid-exposure. Uniform in between.
using Path1d = std::array<float, kPathInstants>;

/// Places [px] of a scene point at kPathInstants, relative to the place at mid-exposure. Straight and uniform in
/// between.
using Path2d = std::array<Eigen::Vector2f, kPathInstants>;

/// Largest width or height [px] of a path for the 2-D filter: its tiles have at most 1024 px
/// (doc/design/blur_model.md).
constexpr float kMax2dExtentPx = 596;

/// Blur of one block along a straight or curved path.
struct BlockBlur {
  float angle_rad = 0;  ///< axial, [0, pi), x right, y down
  /// >= 0: length of the path within the exposure; at non-uniform speed how much of its line it covers.
  float extent_px = 0;
  BlockStatus status = BlockStatus::SHARP;
  /// Set if the speed is non-uniform (even_path_px()): the path along the line.
  std::optional<Path1d> nonuniform_path_px = std::nullopt;
  /// Set if the path is curved, or far from uniform speed (kStraightPathShare): all of it.
  std::optional<Path2d> curved_path_px = std::nullopt;
  /// Midpoint of the path's ends, and its mean in time, relative to the place at mid-exposure.
  Eigen::Vector2f chord_middle_px = Eigen::Vector2f::Zero();
  Eigen::Vector2f mean_place_px = Eigen::Vector2f::Zero();
  /// Nothing if it is not known or not certain, see is_certain().
  std::optional<ResidualVelocity> residual = std::nullopt;
  /// Ratio of noise to texture [cycles^2/px^2], by which the filter is chosen; 0: not known.
  float noise_to_texture = 0;
  /// Variance of the noise after filtering over that before; 1: not known.
  float noise_gain = 1;

  /// From where a scene point is at mid-exposure to where the output image shows it [px]. The filter of a box moves the
  /// point towards the middle of its line, more for longer blur. The filters of non-uniform and curved paths keep the
  /// place at mid-exposure. Across the line, and in unfiltered blocks, blur stays centred on its mean.
  Eigen::Vector2d apparent_offset_px() const;
};

/// The blur of an image. The status of a block is the only record of what may be deblurred and rectified.
struct FrameBlur {
  BlockGrid grid;
  std::vector<BlockBlur> blocks;  ///< grid.size(), row by row
  TimeNs exposure_ns = 0;
  TimeNs readout_ns = 0;
  std::optional<double> noise;  ///< standard deviation in the image [grey levels of 8 bits]; nothing: not known
  double contrast = 0;          ///< standard deviation of the grey levels [8 bits]; 0: not known
  bool images_alone = false;    ///< no rotation is known: residual velocities are the whole motion

  std::size_t count(BlockStatus status) const;
  /// Every block that is to be deblurred becomes REJECTED: the image stays as it came.
  void reject_all();
};

}  // namespace gyro_deblur
