// What an odometry and a depth of the scene say about the camera's translation during a frame.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <nav_msgs/Odometry.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/Range.h>
#include <Eigen/Geometry>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/translation.hpp"
#include "gyro_deblur/types.hpp"

namespace gyro_deblur {

/// Everything needed to add the translation to one frame.
struct TranslationJob {
  std::vector<VelocitySample> velocities;  ///< camera clock
  std::vector<ForceSample> forces;         ///< camera clock; empty when the body is not the IMU
  Eigen::Matrix3d R_cam_body = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p_cam_body_m = Eigen::Vector3d::Zero();
  double depth_m = 0;
  TranslationOptions options;
  std::vector<GyroSample> samples;  ///< of the gyroscope: over the frame and all velocities
};

/// Keeps the newest messages of an odometry and of a depth. Not thread-safe.
class TranslationInput {
 public:
  /// Takes a message in. Returns nothing, or one line that says why it is refused: not finite, an invalid covariance or
  /// orientation, or not newer than the one before. A stamp that goes back by more than time_jump_ns starts anew.
  std::optional<std::string> add(const nav_msgs::Odometry& odometry, const Config& config);
  /// The same; a depth that is not in the message's own range is refused as well (REP 117).
  std::optional<std::string> add(const sensor_msgs::Range& depth, const Config& config);

  /// Takes the acceleration of an IMU message in, where it has one.
  void add(const sensor_msgs::Imu& imu);

  void clear();
  /// Only what add has taken from messages of the IMU, whose clock was set back.
  void forget_forces() { forces_.clear(); }

  /// True once an odometry has come: from then on a frame without translation has a reason.
  bool expected() const { return expected_; }

  /// Poses of the body in the camera's frame, where tf has them: (camera frame, body frame).
  using Transform = std::function<std::optional<Eigen::Isometry3d>(const std::string&, const std::string&)>;

  /// What there is for a frame, without samples of the gyroscope.
  /// @param frame         camera clock
  /// @param R_cam_imu     in use
  /// @param imu_frame     a body of this name is the IMU
  /// @param reason        set to one line when nothing is returned; must not be null
  std::optional<TranslationJob> around(const TimeRange& frame, const Config& config, const std::string& camera_frame,
                                       const std::string& imu_frame, const Eigen::Matrix3d& R_cam_imu,
                                       const Transform& transform, std::string* reason) const;

 private:
  struct Depth {
    TimeNs stamp_ns;
    double depth_m;
  };
  std::deque<VelocitySample> velocities_;  // t_ns: as stamped, in the odometry's clock
  std::deque<ForceSample> forces_;         // t_ns: IMU clock, body axes: the IMU's
  std::deque<Depth> depths_;               // camera clock
  std::string body_frame_;                 // empty: the IMU
  bool expected_ = false;
};

}  // namespace gyro_deblur
