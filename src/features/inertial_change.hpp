// How residual velocities change, by the accelerometer, within the time between two images.
#pragma once

#include <optional>

#include <Eigen/Core>

#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Means over the times between images show that a velocity changes, at a constant rate. How the rate varies, the
/// accelerometer measures, in metres; how much the scene moves in the image for a metre is found by comparing how the
/// acceleration changes in both. A constant acceleration cancels everywhere, and with it gravity and the sensor's bias.
/// Not thread-safe.
class InertialChange {
 public:
  /// Over the time between the image before and the newest one.
  struct Step {
    std::optional<VelocityGain> gain;
    Eigen::Matrix3d R_now_before = Eigen::Matrix3d::Identity();  ///< axes at the image before to those at the newest
    double step_s = 0;                                           ///< > 0, from instant to instant of the two axes
    /// How the acceleration of the scene's residual velocities changed since the step before, in the newest image;
    /// nothing where that is not known.
    std::optional<Eigen::Vector2d> acceleration_changed_px_s2;
    /// Derivative of the projection in the middle of the image [px], by the ray (x, y, 1).
    Eigen::Matrix<double, 2, 3> px_per_ray = Eigen::Matrix<double, 2, 3>::Zero();
  };

  /// Takes a step in.
  /// @return what residual velocities are at its end beyond their mean extrapolated at a constant rate [px/s], at the
  ///         mean of one over the scene's depth; 0 where that is not known, or nothing can be compared in this step
  Eigen::Vector2d beyond_even(const Step& step);

  void clear() { *this = {}; }

  /// Mean of one over the scene's depth, as far as known [1/m]; >= 0.
  double inverse_depth_1_m() const;

 private:
  std::optional<VelocityGain> gain_;                  // of the step before, in the axes at its end
  double step_s_ = 0;                                 // of the step before
  std::optional<Eigen::Vector3d> acceleration_m_s2_;  // from the mean before that to its mean, likewise
  double explained_ = 0, energy_ = 0;                 // of the comparisons so far, the older the less
  double noise_energy_ = 0;                           // added to the energy
};

}  // namespace gyro_deblur
