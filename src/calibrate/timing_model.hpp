// Model of the timing calibration: where the gyroscope's rotation takes the points of a window.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "calibrate/frame_tracker.hpp"
#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Fewer pairs of frames do not determine anything.
constexpr std::size_t kMinPairs = 10;

/// The values that are estimated.
struct TimingState {
  double time_offset_s, readout_s;
  Eigen::Vector3d bias_rad_s;
  Eigen::Matrix3d R_cam_imu;
};

/// A point of a window's first frame.
struct Anchor {
  Eigen::Vector2d px;
  Eigen::Vector3d ray;  ///< camera axes
};

/// One of them found in a later frame.
struct Sighting {
  std::size_t anchor;
  std::size_t frame;  ///< of the window, from 1
  Eigen::Vector2d px;
};

/// Usable points of a window.
struct WindowPoints {
  const TrackWindow* window = nullptr;
  std::vector<Anchor> anchors;
  std::vector<Sighting> sightings;  ///< ordered by anchor, then by frame
};

/// How the camera gets from an anchor's row to a sighting's.
struct Passage {
  Eigen::Matrix3d R_to_reference;  ///< axes of the middle of the first frame to those of the sighting's row
  Eigen::VectorXd shares;          ///< of the positions in the frames after the first, in its displacement
};

class TimingModel {
 public:
  /// Keeps references.
  TimingModel(const Camera& camera, const std::vector<GyroSample>& samples, const TimingOptions& options)
      : camera_(camera), samples_(samples), options_(options) {}

  const Camera& camera() const { return camera_; }

  RotationTrack track(const TimingState& state) const;

  /// Middle of the exposure of a row of a frame, camera clock.
  TimeNs time_of(const FrameTime& frame, double row_px, double readout_s) const;
  TimeNs middle_of(const FrameTime& frame, double readout_s) const;

  /// Rays of the anchors of all sightings, rotated by the gyroscope from the mean of their row's exposure into camera
  /// axes at the mean of the sighting's; NaN where it does not cover the time between.
  std::vector<Eigen::Vector3d> rotated_rays(const WindowPoints& points, const RotationTrack& gyro,
                                            const TimingState& state) const;

  /// The path of the camera is a cubic through its positions at the middles of four neighbouring frames (a parabola or
  /// a line in windows that are shorter).
  std::vector<Passage> passages(const WindowPoints& points, const RotationTrack& gyro, const TimingState& state) const;

  /// Seconds from the middle of the first frame to that of each after it.
  Eigen::VectorXd frame_times_s(const WindowPoints& points, const TimingState& state) const;

  /// @name The values in the order of a step; those that are not estimated are left out.
  /// @{
  Eigen::Index values() const { return static_cast<Eigen::Index>(steps_of_differentiation().size()); }
  std::vector<double> steps_of_differentiation() const;
  TimingState moved(const TimingState& state, const Eigen::VectorXd& step) const;
  bool estimates_rotation() const { return !options_.R_cam_imu; }
  /// @}

 private:
  RowExposure rows_of(const FrameTime& frame, double readout_s) const;

  const Camera& camera_;
  const std::vector<GyroSample>& samples_;
  const TimingOptions& options_;
};

/// Derivatives of rotated rays by the values, near one state.
class TimingDerivatives {
 public:
  /// Keeps a reference to the model.
  TimingDerivatives(const TimingModel& model, const TimingState& state);

  /// By numeric differentiation in three rows of every frame, and a parabola between them.
  /// @param rotated_rays  see TimingModel
  /// @return for each sighting the derivative of its rotated ray: 3 x values
  std::vector<Eigen::Matrix3Xd> of(const WindowPoints& points, const std::vector<Eigen::Vector3d>& rotated_rays) const;

 private:
  struct Side {
    TimingState state;
    RotationTrack gyro;
  };
  const TimingModel& model_;
  Side center_;
  std::vector<double> steps_;
  std::vector<Side> ahead_, behind_;  ///< by each value's step
};

}  // namespace gyro_deblur
