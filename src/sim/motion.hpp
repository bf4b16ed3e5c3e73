// How the simulated camera moves: closed-form poses and their exact derivatives. Independent of RotationTrack, so that
// a sign error in the core does not cancel against the same error here.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gyro_deblur::sim {

/// Pose of the camera's optical frame (x right, y down, z forward) in the world.
struct Pose {
  Eigen::Quaterniond R_world_cam = Eigen::Quaterniond::Identity();
  Eigen::Vector3d p_world_m = Eigen::Vector3d::Zero();
};

/// Closed interval of scene time [s].
struct Span {
  double begin_s = -std::numeric_limits<double>::infinity();
  double end_s = std::numeric_limits<double>::infinity();
};

/// A camera motion over scene time [s]; scene time 0 is the first IMU sample. Precondition of every query: t is in
/// span().
class Motion {
 public:
  virtual ~Motion() = default;
  virtual Span span() const { return {}; }
  virtual Pose pose(double t_s) const = 0;
  /// Body rate of the camera frame [rad/s], in camera coordinates: d/dt R_world_cam = R_world_cam [rate]x.
  virtual Eigen::Vector3d rate(double t_s) const = 0;
  /// Second derivative of the position [m/s^2], world coordinates.
  virtual Eigen::Vector3d acceleration(double t_s) const = 0;
};

/// amplitude * sin(2 pi frequency t + phase), within a window under the envelope sin^4(pi (t - begin) / (end - begin)),
/// which is three times continuously differentiable and leaves the rest of the time still.
struct Sine {
  Eigen::Vector3d amplitude = Eigen::Vector3d::Zero();
  double frequency_hz = 0;
  double phase_rad = 0;
  std::optional<Span> window;

  Eigen::Vector3d evaluate(double t_s, int derivative) const;
};

/// offset + rate t + sines, of any unit, with its first two derivatives.
struct VectorCurve {
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
  Eigen::Vector3d rate = Eigen::Vector3d::Zero();
  std::vector<Sine> sines;

  /// @param derivative 0, 1 or 2
  Eigen::Vector3d evaluate(double t_s, int derivative) const;
};

/// Rotation vector [rad] and position [m] as curves.
std::unique_ptr<Motion> make_curve_motion(const VectorCurve& rotation_rad, const VectorCurve& position_m);

/// R_world_cam(t) = R_world_cam_0 Exp(rate t).
/// @param rate_rad_s  camera frame
std::unique_ptr<Motion> make_constant_rate_motion(const Eigen::Quaterniond& R_world_cam_0,
                                                  const Eigen::Vector3d& rate_rad_s, const VectorCurve& position_m);

/// One line of a recorded gyroscope: time since the first line [s] and body rate of the IMU [rad/s].
struct TraceSample {
  double t_s = 0;
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();
};

/// Rates linear between the samples of a trace, integrated in steps of 0.2 ms.
/// @param samples    at least two, strictly increasing
/// @param start_s    time in the trace that becomes scene time 0; inside the trace
/// @param scale      factor on the rates
/// @param R_cam_imu  takes the trace's axes to the camera's
std::unique_ptr<Motion> make_gyro_trace_motion(const std::vector<TraceSample>& samples, double start_s, double scale,
                                               const Eigen::Matrix3d& R_cam_imu,
                                               const Eigen::Quaterniond& R_world_cam_0, const VectorCurve& position_m);

/// One line of a trajectory: time since the first line [s] and pose of the camera.
struct TrajectorySample {
  double t_s = 0;
  Pose pose;
};

/// Passes through every sample: natural cubic spline of the position, cubic Hermite spline of the rotation vector
/// between neighbours with the mean rate of the two intervals at each sample, so that rates are continuous.
/// @param samples  at least two, strictly increasing
/// @param start_s  time in the trajectory that becomes scene time 0
std::unique_ptr<Motion> make_trajectory_motion(const std::vector<TrajectorySample>& samples, double start_s);

/// The camera circles a point and looks at it: angle(t) = rate t + amplitude sin(2 pi frequency t) about `axis`.
struct Orbit {
  Eigen::Vector3d center_m = Eigen::Vector3d(0, 0, 2);
  double radius_m = 2;  ///< at angle 0 the camera is radius in front of (-z of) the centre, with world-aligned axes
  Eigen::Vector3d axis = Eigen::Vector3d::UnitY();  ///< unit vector, world
  double rate_rad_s = 0;
  double amplitude_rad = 0;
  double frequency_hz = 0;
};
std::unique_ptr<Motion> make_orbit_motion(const Orbit& orbit);

/// Reads a gyroscope recording: lines of `t_ns wx wy wz [more]` [ns, rad/s], separated by commas or blanks; lines that
/// start with # are comments. Times are exact to 0.3 us (double). Throws OptionError "FILE:LINE: ..." for malformed,
/// non-finite or unordered lines.
std::vector<TraceSample> load_gyro_trace(const std::string& path);

/// Reads a trajectory: lines of `t x y z qx qy qz qw` [s, m], separated by commas or blanks; # starts a comment.
/// Quaternions must have unit length to within 1 %. Throws OptionError "FILE:LINE: ...".
std::vector<TrajectorySample> load_trajectory(const std::string& path);

}  // namespace gyro_deblur::sim
