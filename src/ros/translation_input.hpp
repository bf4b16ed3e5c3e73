// What an odometry and a depth of the scene say about the camera's translation during a frame.
#pragma once

#include <cstddef>
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
#include "gyro_deblur/time.hpp"
#include "gyro_deblur/translation.hpp"
#include "ros/stamp_rule.hpp"

namespace gyro_deblur {

/// Everything needed to add the translation to one frame.
struct TranslationJob {
  std::vector<VelocitySample> velocities;  ///< camera clock
  std::vector<ForceSample> forces;         ///< camera clock; empty when the body is not the IMU
  Eigen::Matrix3d R_cam_body = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p_cam_body_m = Eigen::Vector3d::Zero();
  double depth_m = 0;
  TranslationOptions options;
};

/// A message that is not used.
struct RefusedMessage {
  TimeNs stamp_ns;
  std::string why;  ///< one line
};

/// The newest messages of one stream, in the order of their stamps, as StampRule takes them with translation_stamps.
/// Not thread-safe.
/// @tparam Message  has a member t_ns
template <typename Message>
class StampedStream {
 public:
  /// Takes a message in. Returns which messages are refused for their stamps: this one, those before it that were held
  /// back, or the one that was the newest.
  std::vector<RefusedMessage> add(const Message& message, TimeNs time_jump_ns, std::size_t capacity) {
    const auto ruling = rule_.add(message, translation_stamps(time_jump_ns));
    if (ruling.newest_refused) messages_.pop_back();
    if (ruling.reset) messages_.clear();
    for (const Message& taken : ruling.taken) {
      messages_.push_back(taken);
      if (messages_.size() > capacity) messages_.pop_front();
    }
    std::vector<RefusedMessage> refused;
    for (const auto& [each, why] : ruling.refused) {
      refused.push_back({each.t_ns, why == Misfit::AHEAD ? "its stamp is ahead of those that came after it"
                                                         : "its stamp is not after that of the one before"});
    }
    return refused;
  }

  void clear() {
    messages_.clear();
    rule_.clear();
  }
  bool empty() const { return messages_.empty(); }
  typename std::deque<Message>::const_iterator begin() const { return messages_.begin(); }
  typename std::deque<Message>::const_iterator end() const { return messages_.end(); }

 private:
  std::deque<Message> messages_;
  StampRule<Message> rule_;
};

/// Keeps the newest messages of an odometry and of a depth. Not thread-safe.
class TranslationInput {
 public:
  /// Takes a message in. Returns which messages are refused: this one when it is not finite or has an invalid
  /// covariance or orientation, and whichever has a wrong stamp, see StampedStream.
  std::vector<RefusedMessage> add(const nav_msgs::Odometry& odometry, const Config& config);
  /// The same; a depth that is not in the message's own range is refused as well (REP 117).
  std::vector<RefusedMessage> add(const sensor_msgs::Range& depth, const Config& config);

  /// Takes the acceleration of an IMU message in, where it has one. Precondition: GyroSource has taken the message,
  /// which it does not where the stamp is far from those around it; when the clock was set back, forget_forces first.
  void add(const sensor_msgs::Imu& imu);

  void clear();
  /// Only what add has taken from messages of the IMU, whose clock was set back.
  void forget_forces() { forces_.clear(); }

  /// True once an odometry has come: from then on a frame without translation has a reason.
  bool expected() const { return expected_; }

  /// Poses of the body in the camera's frame, where tf has them: (camera frame, body frame).
  using Transform = std::function<std::optional<Eigen::Isometry3d>(const std::string&, const std::string&)>;

  /// What there is for a frame, but for samples of the gyroscope.
  /// @param frame         camera clock
  /// @param R_cam_imu     in use
  /// @param imu_frame     a body of this name is the IMU
  /// @param reason        set to one line when nothing is returned; must not be null
  std::optional<TranslationJob> around(const TimeRange& frame, const Config& config, const std::string& camera_frame,
                                       const std::string& imu_frame, const Eigen::Matrix3d& R_cam_imu,
                                       const Transform& transform, std::string* reason) const;

 private:
  struct Depth {
    TimeNs t_ns;
    double depth_m;
  };
  StampedStream<VelocitySample> velocities_;  // t_ns: as stamped, in the odometry's clock
  std::deque<ForceSample> forces_;            // t_ns: IMU clock, body axes: the IMU's
  StampedStream<Depth> depths_;               // camera clock
  std::string body_frame_;                    // empty: the IMU
  bool expected_ = false;
};

}  // namespace gyro_deblur
