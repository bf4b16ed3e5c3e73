// Camera rotations with a closed form, as truth for everything that integrates a gyroscope.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include <Eigen/Geometry>

#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur::test {

/// angle(t) = rate * t + amplitude * sin(2 pi frequency t + phase) about a fixed unit axis.
struct Swing {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
  double rate_rad_s = 0;
  double amplitude_rad = 0;
  double frequency_hz = 0;
  double phase_rad = 0;

  double angle_rad(double t_s) const {
    return rate_rad_s * t_s + amplitude_rad * std::sin(2 * M_PI * frequency_hz * t_s + phase_rad);
  }
  double angular_rate_rad_s(double t_s) const {
    const double omega = 2 * M_PI * frequency_hz;
    return rate_rad_s + amplitude_rad * omega * std::cos(omega * t_s + phase_rad);
  }
  Eigen::Matrix3d rotation(double t_s) const { return Eigen::AngleAxisd(angle_rad(t_s), axis).toRotationMatrix(); }
};

/// R_world_cam(t) = outer(t) * inner(t): two axes that rotate against each other, so rotations do not commute.
class AnalyticMotion : public CameraMotion {
 public:
  AnalyticMotion(const Swing& outer, const Swing& inner) : outer_(outer), inner_(inner) {}
  explicit AnalyticMotion(const Swing& only) : outer_(only) {}

  /// Constant body rate [rad/s] about a fixed axis.
  static AnalyticMotion constant_rate(const Eigen::Vector3d& rate_rad_s) {
    Swing swing;
    swing.rate_rad_s = rate_rad_s.norm();
    if (swing.rate_rad_s > 0) swing.axis = rate_rad_s.normalized();
    return AnalyticMotion(swing);
  }

  /// A hand-held shake: up to about 3 rad/s, changing within tens of milliseconds.
  static AnalyticMotion handshake() {
    return {{Eigen::Vector3d(0.2, 1, 0.1).normalized(), 1.0, 0.12, 2.0, 0.3},
            {Eigen::Vector3d(0.7, -0.1, 0.7).normalized(), 0.3, 0.06, 2.7, 1.1}};
  }

  bool covers(const TimeRange& range) const override { return range_.contains(range); }

  Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const override {
    if (!range_.contains(from_ns) || !range_.contains(to_ns)) throw std::out_of_range("AnalyticMotion");
    return R_world_cam(to_ns).transpose() * R_world_cam(from_ns);
  }

  /// Limits what the motion claims to cover.
  void set_range(const TimeRange& range) { range_ = range; }

  Eigen::Matrix3d R_world_cam(TimeNs t_ns) const {
    const double t_s = to_seconds(t_ns);
    return outer_.rotation(t_s) * inner_.rotation(t_s);
  }

  /// Body rate [rad/s] in camera axes.
  Eigen::Vector3d rate_rad_s(TimeNs t_ns) const {
    const double t_s = to_seconds(t_ns);
    return inner_.rotation(t_s).transpose() * outer_.axis * outer_.angular_rate_rad_s(t_s) +
           inner_.axis * inner_.angular_rate_rad_s(t_s);
  }

  /// What an ideal gyroscope reports: samples every `period_ns` of `range` (camera clock), stamped in the IMU clock.
  std::vector<GyroSample> sample(const TimeRange& range, TimeNs period_ns,
                                 const Eigen::Matrix3d& R_cam_imu = Eigen::Matrix3d::Identity(),
                                 const GyroOptions& options = {}) const {
    std::vector<GyroSample> samples;
    for (TimeNs t_ns = range.begin_ns; t_ns <= range.end_ns; t_ns += period_ns) {
      samples.push_back({t_ns + options.time_offset_ns, R_cam_imu.transpose() * rate_rad_s(t_ns) + options.bias_rad_s});
    }
    return samples;
  }

 private:
  Swing outer_, inner_;
  TimeRange range_{std::numeric_limits<TimeNs>::min(), std::numeric_limits<TimeNs>::max()};
};

/// Angle [rad] of the rotation between two rotation matrices.
inline double rotation_distance(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  // From the chord, which is exact for small angles where the trace is not.
  return 2 * std::asin(std::min(1.0, (a - b).norm() / std::sqrt(8.0)));
}

}  // namespace gyro_deblur::test
