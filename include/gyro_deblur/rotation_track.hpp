// How the camera moved: the interface the blur field is computed from, and its gyroscope implementation.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include <Eigen/Geometry>

#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// What an accelerometer says of the camera's velocity over a stretch of time, in the axes that the camera has at its
/// end. It says it of itself, not of the camera, and gravity is still in it.
struct VelocityGain {
  Eigen::Vector3d total_m_s;  ///< velocity at the end less that at the begin
  Eigen::Vector3d mean_m_s;   ///< mean velocity less that at the begin
};

/// How the camera moved over a stretch of the camera clock, as far as its IMU measures it: all that the blur field and
/// the rectification know of it.
class CameraMotion {
 public:
  virtual ~CameraMotion() = default;

  /// True when the motion is known everywhere in `range` (camera clock); false for an empty range.
  virtual bool covers(const TimeRange& range) const = 0;

  /// The R of paper eq. 1: takes the direction of a scene point in the camera frame at `from_ns` to its direction in
  /// the camera frame at `to_ns`. Camera clock; from may be later than to. Throws std::out_of_range with the range
  /// asked for and the range available.
  virtual Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const = 0;

  /// Nothing where no accelerometer covers the time, or to is not after from.
  virtual std::optional<VelocityGain> velocity_gain(TimeNs /*from_ns*/, TimeNs /*to_ns*/) const { return std::nullopt; }
};

/// True when the sample reaches options.range_rad_s on an axis, or all but reaches it: the true rate may be any beyond
/// it. Never when the range is not known.
bool is_saturated(const GyroSample& sample, const GyroOptions& options);

/// Orientation of the camera by integration of the gyroscope (paper section III-A): rates linear between samples,
/// integrated on SO(3), also to the times in between. (The paper's SLERP, section III-B, takes the rate there to be
/// constant, which is wrong by up to 2 px of path for a hand.) Never extrapolates, and knows nothing between a
/// saturated sample and its neighbours.
class RotationTrack : public CameraMotion {
 public:
  /// @param samples    strictly increasing in time (IMU clock), rates finite; may be empty
  /// @param options    bias, time offset, longest gap and range; validated
  /// @param R_cam_imu  takes IMU coordinates to camera coordinates; a rotation (see require_rotation)
  /// @param origin     index of the sample that the others are integrated from, both ways: samples before it change no
  ///                   bit of what lies after it
  /// Throws OptionError for bad options or rotation, std::invalid_argument for unordered samples or a wrong index.
  RotationTrack(const std::vector<GyroSample>& samples, const GyroOptions& options, const Eigen::Matrix3d& R_cam_imu,
                std::size_t origin = 0);

  bool covers(const TimeRange& range) const override;
  Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const override;
  std::optional<VelocityGain> velocity_gain(TimeNs from_ns, TimeNs to_ns) const override;

  /// From the first to the last sample (camera clock), holes included.
  TimeRange available() const;

 private:
  void require_covered(const TimeRange& range) const;  // throws std::out_of_range
  Eigen::Quaterniond interpolate(TimeNs t_ns) const;   // precondition: available().contains(t_ns)

  struct Knot {
    TimeNs t_ns;                          // camera clock
    Eigen::Quaterniond R_0_cam;           // camera(t) -> camera(origin)
    Eigen::Vector3d rate_rad_s;           // camera frame
    Eigen::Vector3d specific_force_m_s2;  // camera frame; not finite where not known
    bool follows_hole;
  };
  std::vector<Knot> knots_;
  std::vector<TimeRange> holes_;  // open intervals longer than max_gap_ns or with a saturated end, camera clock
};

/// Exp: rotation vector [rad] to quaternion; exact for small angles.
Eigen::Quaterniond so3_exp(const Eigen::Vector3d& rotation_rad);

/// The matrix [v]x, which takes w to the cross product of v and w.
Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v);

/// Increment Exp(integral of w) of the body orientation over dt_s for a body rate that goes linearly from w0 to w1
/// (Magnus expansion, local error O(dt^5)).
Eigen::Quaterniond integrate_linear_rate(const Eigen::Vector3d& w0_rad_s, const Eigen::Vector3d& w1_rad_s, double dt_s);

/// Returns R projected to the nearest rotation when it is one to within 1e-3 (calibrations are printed with few
/// digits). Throws OptionError that names `name`, the determinant and what is expected otherwise; det = -1 has a
/// message of its own.
Eigen::Matrix3d require_rotation(const char* name, const Eigen::Matrix3d& R);

}  // namespace gyro_deblur
