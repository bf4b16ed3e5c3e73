// Translation over depth (paper eq. 1): the velocity of an odometry added to the rotation of the gyroscope.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// One velocity of an odometry.
struct VelocitySample {
  TimeNs t_ns = 0;                                         ///< camera clock
  Eigen::Vector3d velocity_m_s = Eigen::Vector3d::Zero();  ///< of the body's origin, in the body's axes
  double stddev_m_s = 0;                                   ///< of its least certain axis; 0: not known
};

/// One reading of an accelerometer at the body's origin.
struct ForceSample {
  TimeNs t_ns = 0;                                       ///< camera clock
  Eigen::Vector3d force_m_s2 = Eigen::Vector3d::Zero();  ///< acceleration less gravity, in the body's axes
};

/// Velocity of the body's origin over a stretch of time: v(t) = velocity + acceleration (t - t_ns), in the axes that
/// the camera has at axes_ns.
struct BodyVelocity {
  TimeNs axes_ns = 0;  ///< camera clock
  TimeNs t_ns = 0;     ///< camera clock
  Eigen::Vector3d velocity_m_s = Eigen::Vector3d::Zero();
  Eigen::Vector3d acceleration_m_s2 = Eigen::Vector3d::Zero();

  Eigen::Vector3d at(TimeNs time_ns) const;
  /// Path of the body's origin [m] between two times.
  Eigen::Vector3d displacement(TimeNs from_ns, TimeNs to_ns) const;
};

/// The velocity around `frame`: between the two samples that enclose its middle, else extrapolated from the newest
/// ones. Between the samples' times and the frame the gyroscope turns the axes, and the accelerometer, where there is
/// one, tells how the velocity changes: gravity and its bias follow from the samples themselves (the slope of a line
/// through the last second of velocity less integrated force). Without one a line through the samples of the last 0.1 s
/// (at least two) has to do.
/// @param samples   increasing in time
/// @param forces    increasing in time; empty, or of something that is no accelerometer in m/s^2: not used
/// @param rotation  samples between which and the frame it has holes are left out
/// @param reason    set, when nothing is returned, to one line with the values: too old, too uncertain, a jump, too
///                  fast, too few, or a gyroscope that does not cover the frame; must not be null
std::optional<BodyVelocity> fit_velocity(const std::vector<VelocitySample>& samples,
                                         const std::vector<ForceSample>& forces, const RotationTrack& rotation,
                                         const Eigen::Matrix3d& R_cam_body, const TimeRange& frame,
                                         const TranslationOptions& options, std::string* reason);

/// How far from the middle of a frame samples are of use to fit_velocity.
TimeNs velocity_reach_ns(const TranslationOptions& options);

/// Rotation of the gyroscope and translation over a scene that lies at one depth: paper eq. 1 with n along the optical
/// axis. The scene lies at that depth as seen from the camera at the `from` of each query, so that a point on the way
/// from a block's centre is at the block's depth.
class TranslatedMotion : public CameraMotion {
 public:
  /// @param rotation      has to outlive this
  /// @param p_cam_body_m  origin of the body in camera coordinates: a rotation about it moves the camera
  /// @param depth_m       > 0, along the optical axis
  /// Throws std::invalid_argument for a depth or velocity that is not usable.
  TranslatedMotion(const RotationTrack& rotation, const BodyVelocity& velocity, const Eigen::Vector3d& p_cam_body_m,
                   double depth_m);

  bool covers(const TimeRange& range) const override;
  Eigen::Matrix3d homography(TimeNs from_ns, TimeNs to_ns) const override;
  Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const override { return rotation_.homography(from_ns, to_ns); }

 private:
  const RotationTrack& rotation_;
  BodyVelocity velocity_;
  Eigen::Vector3d p_cam_body_m_;
  double depth_m_;
};

}  // namespace gyro_deblur
