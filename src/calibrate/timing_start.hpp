// Start of the estimation: the offset by correlation, the rotation in closed form.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "calibrate/timing_model.hpp"

namespace gyro_deblur {

/// The rotations between the first two frames of windows, by images and gyroscope, as if the camera did not translate.
class TimingStart {
 public:
  /// Keeps references.
  TimingStart(const TimingModel& model, const std::vector<WindowPoints>& windows);

  /// Rotation vector of the camera from the first frame to the second [rad], by the images, one for each window.
  const std::vector<Eigen::Vector3d>& image_rotations() const { return image_rotations_; }
  /// The same by the gyroscope; NaN where it does not cover the time.
  std::vector<Eigen::Vector3d> gyro_rotations(const TimingState& state) const;

  /// Moves the state's offset to where the angular speeds correlate best, and returns the correlation [-1, 1].
  /// @param search_ns  how far
  /// Throws TimingError when they do not agree anywhere.
  double search_offset(TimeNs search_ns, TimingState* state) const;

  /// Sets the state's rotation (Wahba's problem on the rotation vectors). Throws TimingError when it is open.
  void find_rotation(TimingState* state) const;

 private:
  const TimingModel& model_;
  const std::vector<WindowPoints>& windows_;
  std::vector<Eigen::Vector3d> image_rotations_;
};

}  // namespace gyro_deblur
