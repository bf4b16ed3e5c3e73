// Motion around a point, by that of its neighbours.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

namespace gyro_deblur {

/// Displacement [px] around a point: at it, and what it changes by for each pixel away from it.
struct LocalMotion {
  Eigen::Vector2d displacement_px = Eigen::Vector2d::Zero();
  Eigen::Matrix2d slope = Eigen::Matrix2d::Zero();
};

/// Where points were, and by how much they were displaced.
struct DisplacedPoint {
  Eigen::Vector2d place_px, displacement_px;
};

/// The motion around any place of an image, by the displaced points near it.
class LocalMotions {
 public:
  /// @param points  finite
  explicit LocalMotions(std::vector<DisplacedPoint> points);

  /// Plane through the displacements of the nearest points, robust against those of another depth or object. Nothing
  /// where there are fewer than six.
  /// @param expected_slope  in directions in which the points do not extend, the slope stays near it
  std::optional<LocalMotion> at(const Eigen::Vector2d& place_px,
                                const Eigen::Matrix2d& expected_slope = Eigen::Matrix2d::Zero()) const;

 private:
  /// Indices of at most twelve points, valid until the thread's next call.
  const std::vector<int>& nearest_to(const Eigen::Vector2d& place_px) const;

  std::vector<DisplacedPoint> points_;
  Eigen::ArrayXf x_px_, y_px_;  // of their places, in columns for SIMD
};

}  // namespace gyro_deblur
