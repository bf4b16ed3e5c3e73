#include "ros/translation_input.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

/// Four seconds of the fastest odometry; the gyroscope's buffer is hardly longer.
constexpr std::size_t kMaxVelocities = 4000;
/// More than a minute, the largest scene_depth_max_age, at 30 Hz.
constexpr std::size_t kMaxDepths = 2000;

/// Unit quaternions are printed and summed with errors of this size.
constexpr double kQuaternionTolerance = 1e-2;

/// Largest standard deviation [m/s] of the linear velocity; 0 when it is not told, nothing when it makes no sense.
std::optional<double> stddev_m_s(const nav_msgs::Odometry& odometry) {
  double variance = 0;
  for (const std::size_t diagonal : {0u, 7u, 14u}) {  // of the 6x6 matrix
    const double value = odometry.twist.covariance[diagonal];
    if (!(value >= 0) || !std::isfinite(value)) return std::nullopt;
    variance = std::max(variance, value);
  }
  return std::sqrt(variance);
}

}  // namespace

std::vector<RefusedMessage> TranslationInput::add(const nav_msgs::Odometry& odometry, const Config& config) {
  expected_ = true;
  VelocitySample sample;
  sample.t_ns = to_time_ns(odometry.header.stamp);
  const auto refuse = [&sample](const char* why) { return std::vector<RefusedMessage>{{sample.t_ns, why}}; };
  const auto& v = odometry.twist.twist.linear;
  sample.velocity_m_s = {v.x, v.y, v.z};
  if (!sample.velocity_m_s.allFinite()) return refuse("its linear velocity is not finite");
  const std::optional<double> stddev = stddev_m_s(odometry);
  if (!stddev) return refuse("the covariance of its linear velocity is negative or not finite");
  sample.stddev_m_s = *stddev;
  if (config.odometry_twist_frame == TwistFrame::PARENT) {
    const auto& q = odometry.pose.pose.orientation;
    const Eigen::Quaterniond R_parent_body(q.w, q.x, q.y, q.z);
    if (!(std::abs(R_parent_body.norm() - 1) < kQuaternionTolerance)) {
      return refuse("its orientation is not a unit quaternion");
    }
    sample.velocity_m_s = R_parent_body.normalized().conjugate() * sample.velocity_m_s;
  }
  const std::vector<RefusedMessage> refused = velocities_.add(sample, config.time_jump_ns, kMaxVelocities);
  // Only a message that was taken says whose velocity it is. Some stacks name the world in both places; what they
  // estimate is the pose of the IMU.
  if (std::prev(velocities_.end())->t_ns == sample.t_ns) {
    body_frame_ = odometry.child_frame_id == odometry.header.frame_id ? std::string() : odometry.child_frame_id;
  }
  return refused;
}

std::vector<RefusedMessage> TranslationInput::add(const sensor_msgs::Range& depth, const Config& config) {
  const TimeNs stamp_ns = to_time_ns(depth.header.stamp);
  const auto refuse = [stamp_ns](const char* why) { return std::vector<RefusedMessage>{{stamp_ns, why}}; };
  const double depth_m = static_cast<double>(depth.range);
  if (!std::isfinite(depth_m) || !(depth_m > 0)) return refuse("its range is not a finite number above 0");
  if (depth.max_range > 0 && (depth.range < depth.min_range || depth.range > depth.max_range)) {
    return refuse("its range is outside [min_range, max_range]");
  }
  return depths_.add({stamp_ns, depth_m}, config.time_jump_ns, kMaxDepths);
}

void TranslationInput::add(const sensor_msgs::Imu& imu) {
  const auto& a = imu.linear_acceleration;
  const ForceSample sample{to_time_ns(imu.header.stamp), {a.x, a.y, a.z}};
  // What is not before a sample that was taken was given back for it.
  while (!forces_.empty() && forces_.back().t_ns >= sample.t_ns) forces_.pop_back();
  if (imu.linear_acceleration_covariance[0] == -1 || !sample.force_m_s2.allFinite()) return;
  forces_.push_back(sample);
  if (forces_.size() > kMaxVelocities) forces_.pop_front();
}

void TranslationInput::clear() {
  velocities_.clear();
  forces_.clear();
  depths_.clear();
  expected_ = false;
}

std::optional<TranslationJob> TranslationInput::around(const TimeRange& frame, const Config& config,
                                                       const std::string& camera_frame, const std::string& imu_frame,
                                                       const Eigen::Matrix3d& R_cam_imu, const Transform& transform,
                                                       std::string* reason) const {
  const auto refuse = [reason](const std::string& text) -> std::optional<TranslationJob> {
    *reason = text;
    return std::nullopt;
  };
  TranslationJob job;
  job.options = config.translation;
  const TimeNs middle_ns = frame.begin_ns + (frame.end_ns - frame.begin_ns) / 2;
  job.depth_m = config.translation.scene_depth_m;
  if (!depths_.empty()) {
    const auto nearest = std::min_element(depths_.begin(), depths_.end(), [middle_ns](const Depth& a, const Depth& b) {
      return std::abs(a.t_ns - middle_ns) < std::abs(b.t_ns - middle_ns);
    });
    if (std::abs(nearest->t_ns - middle_ns) <= config.translation.depth_max_age_ns) job.depth_m = nearest->depth_m;
  }
  if (job.depth_m <= 0) {
    return refuse(depths_.empty() ? "no depth of the scene: neither a message nor parameter scene_depth"
                                  : "the newest depth of the scene is older than scene_depth_max_age");
  }

  const TimeNs reach_ns = velocity_reach_ns(config.translation);
  if (body_frame_.empty() || body_frame_ == imu_frame) {
    for (ForceSample force : forces_) {
      force.t_ns -= config.gyro.time_offset_ns;
      if (std::abs(force.t_ns - middle_ns) <= reach_ns) job.forces.push_back(force);
    }
  }
  const std::string& body_frame = body_frame_.empty() ? imu_frame : body_frame_;
  if (body_frame == imu_frame && config.R_cam_imu) {
    job.R_cam_body = R_cam_imu;
    job.p_cam_body_m = config.p_cam_imu_m;
  } else {
    const std::optional<Eigen::Isometry3d> T_cam_body = transform ? transform(camera_frame, body_frame) : std::nullopt;
    if (!T_cam_body) {
      return refuse(std::string("no transform from the ") +
                    (body_frame_.empty() ? "IMU's frame \"" : "odometry's child frame \"") + body_frame +
                    "\" to camera frame \"" + camera_frame + "\"");
    }
    job.R_cam_body = T_cam_body->linear();
    job.p_cam_body_m = T_cam_body->translation();
  }

  const TimeNs to_camera_ns = config.odometry_clock == OdometryClock::IMU ? -config.gyro.time_offset_ns : 0;
  std::optional<VelocitySample> nearest;
  for (VelocitySample sample : velocities_) {
    sample.t_ns += to_camera_ns;
    const TimeNs away_ns = std::abs(sample.t_ns - middle_ns);
    if (away_ns <= reach_ns) job.velocities.push_back(sample);
    if (!nearest || away_ns < std::abs(nearest->t_ns - middle_ns)) nearest = sample;
  }
  // So that its age can be told.
  if (job.velocities.empty() && nearest) job.velocities.push_back(*nearest);
  return job;
}

}  // namespace gyro_deblur
