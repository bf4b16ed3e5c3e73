// Changes of residual velocities, from the accelerometer.
#include "features/inertial_change.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gyro_deblur {

double InertialChange::inverse_depth_1_m() const {
  return energy_ > 0 ? std::max(explained_ / (energy_ + noise_energy_), 0.0) : 0;
}

Eigen::Vector2d InertialChange::beyond_even(const Step& step) {
  constexpr double kMemoryS = 0.5;  // the scene's depth stays much the same for so long
  const double kept = std::exp(-step.step_s / kMemoryS);
  explained_ *= kept;
  energy_ *= kept;
  const bool usable = step.gain && step.px_per_ray.allFinite();
  const std::optional<VelocityGain> before = std::exchange(gain_, usable ? step.gain : std::nullopt);
  const std::optional<Eigen::Vector3d> acceleration_before_m_s2 = std::exchange(acceleration_m_s2_, std::nullopt);
  const double between_means_s = 0.5 * (std::exchange(step_s_, step.step_s) + step.step_s);
  if (!before || !gain_) return Eigen::Vector2d::Zero();
  const Eigen::Vector3d from_mean_to_end_m_s = step.R_now_before * (before->total_m_s - before->mean_m_s);
  const Eigen::Vector3d acceleration_m_s2 = (from_mean_to_end_m_s + gain_->mean_m_s) / between_means_s;
  acceleration_m_s2_ = acceleration_m_s2;
  if (!acceleration_before_m_s2 || !step.acceleration_changed_px_s2) return Eigen::Vector2d::Zero();
  // A camera that moves to the right sees its scene move to the left.
  const Eigen::Vector2d expected_px_m_s2 =
      -step.px_per_ray * (acceleration_m_s2 - step.R_now_before * *acceleration_before_m_s2);
  // Standard deviation of a change of acceleration, by noise and by the distance between accelerometer and camera. 0.6
  // m/s^2 corresponds to 4 cm at the angular acceleration of a hand.
  constexpr double kAccelerationStddev_m_s2 = 0.6;
  noise_energy_ = kAccelerationStddev_m_s2 * kAccelerationStddev_m_s2 * step.px_per_ray.squaredNorm() / 2;
  explained_ += expected_px_m_s2.dot(*step.acceleration_changed_px_s2);
  energy_ += expected_px_m_s2.squaredNorm();
  const Eigen::Vector3d beyond_m_s = gain_->total_m_s - gain_->mean_m_s - step.step_s / 2 * acceleration_m_s2;
  return -inverse_depth_1_m() * step.px_per_ray * beyond_m_s;
}

}  // namespace gyro_deblur
