// What an image shows that does not move with the camera: a lens's rim, a part of the vehicle, a time stamp.
#pragma once

#include <array>
#include <cstddef>
#include <set>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/pixel_mask.hpp"

namespace gyro_deblur {

/// Finds static content in the images of a camera that rotates. Not thread-safe.
///
/// The image is seen in cells. A cell stands still when its grey level is the same in many images between which the
/// scene has moved along an axis. That alone may be sky, or a wall. Static content has an edge as well: the cell
/// differs from its neighbour along that axis in most of these images. An edge of the scene that lies along the axis
/// does not differ along it, and any other edge moves.
class StaticContent {
 public:
  /// For every image first.
  /// @param moved_px  how far the camera's rotation has moved the scene at the image's centre since the image before
  /// @return whether add() is to see the image: the scene has moved by some pixels
  bool move(const Eigen::Vector2d& moved_px);
  /// Takes the image in after that move.
  /// @param luminance  CV_8UC1; of another size than the one before: starts anew
  /// @param mask       empty, or of the image's size: what is masked is not looked for
  void add(const cv::Mat& luminance, const PixelMask& mask);

  /// The edges of what was found are masked; empty: none was found.
  const PixelMask& edges() const { return edges_; }
  /// About how much of the image does not move with the camera, in [0, 1].
  double share() const { return share_; }

  void reset();

 private:
  /// Images between which the scene has moved along one axis.
  struct Axis {
    int images = 0;
    std::set<int> places;         ///< where the scene has been
    cv::Mat least, most;          ///< CV_8UC1: grey levels of each cell
    cv::Mat contrasts;            ///< CV_16UC1: in how many images a cell differs from the one behind its neighbour
    cv::Mat found, static_cells;  ///< CV_8UC1, of the images before: cells at an edge, and all that stand still
  };

  void add_to(Axis& axis, bool is_x, double place_px);
  /// Finds the static cells of the images so far, and forgets these images.
  void decide(Axis& axis, bool is_x, const PixelMask& mask);
  void combine();

  cv::Size size_;
  cv::Mat cells_, cells_before_;  // mean grey levels
  Eigen::Vector2d place_px_ = Eigen::Vector2d::Zero(), step_px_ = Eigen::Vector2d::Zero();
  std::array<Axis, 2> axes_;
  PixelMask edges_;
  double share_ = 0;
};

}  // namespace gyro_deblur
