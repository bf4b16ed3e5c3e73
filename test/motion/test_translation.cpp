#include "gyro_deblur/translation.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur {
namespace {

constexpr TimeNs kMs = 1'000'000;
constexpr TimeNs kSecond = 1'000'000'000;
const Eigen::Vector3d kRate(0.4, -1.1, 0.7);      // [rad/s] of the camera, constant
const Eigen::Vector3d kVelocity(0.8, -0.3, 0.5);  // [m/s] at time 0, axes of the camera at time 0
const Eigen::Vector3d kAcceleration(-1.5, 2, 0.7);
const Eigen::Vector3d kPlace(0.11, -0.07, 0.05);  // [m] of the body in the camera

Eigen::Matrix3d some_rotation() {
  return (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(-1.9, Eigen::Vector3d::UnitY()))
      .toRotationMatrix();
}

/// A camera that turns at a constant rate while the body it is fixed to is accelerated evenly.
struct Truth {
  static Eigen::Matrix3d R_0_cam(TimeNs t_ns) { return so3_exp(to_seconds(t_ns) * kRate).toRotationMatrix(); }
  static Eigen::Vector3d velocity(TimeNs t_ns) { return kVelocity + to_seconds(t_ns) * kAcceleration; }
  static Eigen::Vector3d camera_origin(TimeNs t_ns) {
    const double t_s = to_seconds(t_ns);
    return t_s * kVelocity + 0.5 * t_s * t_s * kAcceleration - R_0_cam(t_ns) * kPlace;
  }
  /// Where a point at `depth_m` on a ray of the camera at from_ns is in the camera at to_ns.
  static Eigen::Vector3d moved(const Eigen::Vector3d& ray, double depth_m, TimeNs from_ns, TimeNs to_ns) {
    const Eigen::Vector3d point = camera_origin(from_ns) + R_0_cam(from_ns) * (ray * depth_m);
    return R_0_cam(to_ns).transpose() * (point - camera_origin(to_ns));
  }
  static VelocitySample sample(TimeNs t_ns, const Eigen::Matrix3d& R_cam_body) {
    return {t_ns, R_cam_body.transpose() * R_0_cam(t_ns).transpose() * velocity(t_ns), 0};
  }
};

RotationTrack track(TimeNs from_ns = -kSecond, TimeNs to_ns = kSecond) {
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = from_ns; t_ns <= to_ns; t_ns += 5 * kMs) samples.push_back({t_ns, kRate});
  return RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
}

std::vector<VelocitySample> samples_at(const std::vector<TimeNs>& times_ns) {
  std::vector<VelocitySample> samples;
  for (const TimeNs t_ns : times_ns) samples.push_back(Truth::sample(t_ns, some_rotation()));
  return samples;
}

constexpr TimeRange kFrame{-10 * kMs, 30 * kMs};
constexpr TimeNs kMiddleNs = 10 * kMs;

std::optional<BodyVelocity> fit(const std::vector<VelocitySample>& samples, std::string* reason,
                                const TranslationOptions& options = {}, const RotationTrack& rotation = track()) {
  return fit_velocity(samples, {}, rotation, some_rotation(), kFrame, options, reason);
}

std::string refusal(const std::vector<VelocitySample>& samples, const TranslationOptions& options = {},
                    const RotationTrack& rotation = track()) {
  std::string reason;
  EXPECT_FALSE(fit(samples, &reason, options, rotation)) << reason;
  return reason;
}

void expect_contains(const std::string& text, const std::string& part) {
  EXPECT_NE(text.find(part), std::string::npos) << text;
}

// Samples after the frame, around it, and before it by as much as a stack takes to compute.
TEST(FitVelocity, EvenAccelerationIsFollowedThroughTurningAxes) {
  const std::vector<std::vector<TimeNs>> cases{{-100 * kMs, -50 * kMs, 0, 50 * kMs, 100 * kMs},
                                               {-160 * kMs, -110 * kMs, -60 * kMs},
                                               {-170 * kMs, -150 * kMs, -130 * kMs, -110 * kMs, -100 * kMs},
                                               {40 * kMs, 90 * kMs},
                                               {-200 * kMs, -100 * kMs}};
  for (const std::vector<TimeNs>& times_ns : cases) {
    std::string reason;
    const std::optional<BodyVelocity> fitted = fit(samples_at(times_ns), &reason);
    ASSERT_TRUE(fitted) << reason;
    const Eigen::Matrix3d R_axes_0 = Truth::R_0_cam(kMiddleNs).transpose();
    for (const TimeNs t_ns : {kFrame.begin_ns, kFrame.end_ns}) {
      EXPECT_LT((fitted->at(t_ns) - R_axes_0 * Truth::velocity(t_ns)).norm(), 1e-6) << times_ns.front() / kMs;
    }
  }
}

// Readings of an accelerometer with gravity and a bias that it does not know.
std::vector<ForceSample> forces_of(const Eigen::Vector3d& gravity_m_s2, double scale = 1) {
  std::vector<ForceSample> forces;
  for (TimeNs t_ns = -kSecond; t_ns <= kSecond; t_ns += 5 * kMs) {
    // A jerk that no line follows: the acceleration above, and a swing of 3 Hz.
    const double phase = 6 * M_PI * to_seconds(t_ns);
    const Eigen::Vector3d force = kAcceleration + 8 * std::cos(phase) * Eigen::Vector3d::UnitX() - gravity_m_s2;
    forces.push_back({t_ns, scale * (some_rotation().transpose() * Truth::R_0_cam(t_ns).transpose() * force)});
  }
  return forces;
}

TEST(FitVelocity, TheAccelerometerCarriesLateVelocitiesOn) {
  const auto velocity = [](TimeNs t_ns) -> Eigen::Vector3d {
    const double omega = 6 * M_PI;
    return Truth::velocity(t_ns) + 8 / omega * std::sin(omega * to_seconds(t_ns)) * Eigen::Vector3d::UnitX();
  };
  std::vector<VelocitySample> samples;
  for (TimeNs t_ns = -900 * kMs; t_ns <= -150 * kMs; t_ns += 50 * kMs) {
    samples.push_back({t_ns, some_rotation().transpose() * Truth::R_0_cam(t_ns).transpose() * velocity(t_ns), 0});
  }
  const Eigen::Vector3d gravity(0.5, 9.7, -1.1);
  const auto error_m_s = [&](const std::vector<ForceSample>& forces) {
    std::string reason;
    const std::optional<BodyVelocity> fitted =
        fit_velocity(samples, forces, track(), some_rotation(), kFrame, TranslationOptions{}, &reason);
    EXPECT_TRUE(fitted) << reason;
    if (!fitted) return std::numeric_limits<double>::quiet_NaN();
    return (fitted->at(kMiddleNs) - Truth::R_0_cam(kMiddleNs).transpose() * velocity(kMiddleNs)).norm();
  };
  EXPECT_LT(error_m_s(forces_of(gravity)), 0.01);
  const double without = error_m_s({});
  EXPECT_GT(without, 0.3);
  // In units of g it is not believed.
  EXPECT_EQ(error_m_s(forces_of(gravity, 1 / 9.81)), without);
}

TEST(FitVelocity, NoiseOfAFastOdometryIsAveraged) {
  std::vector<VelocitySample> samples;
  int sign = 1;
  for (TimeNs t_ns = -150 * kMs; t_ns <= -20 * kMs; t_ns += 5 * kMs, sign = -sign) {
    samples.push_back(Truth::sample(t_ns, some_rotation()));
    samples.back().velocity_m_s += sign * 0.02 * Eigen::Vector3d::Ones();
  }
  std::string reason;
  const std::optional<BodyVelocity> fitted = fit(samples, &reason);
  ASSERT_TRUE(fitted) << reason;
  EXPECT_LT((fitted->at(kMiddleNs) - Truth::R_0_cam(kMiddleNs).transpose() * Truth::velocity(kMiddleNs)).norm(), 0.02);
}

TEST(FitVelocity, RefusesWithAReason) {
  expect_contains(refusal({}), "no odometry");
  expect_contains(refusal(samples_at({-400 * kMs, -300 * kMs})), "odometry_max_age = 0.2");
  expect_contains(refusal(samples_at({-100 * kMs})), "fewer than two");

  std::vector<VelocitySample> uncertain = samples_at({-100 * kMs, -50 * kMs});
  for (VelocitySample& sample : uncertain) sample.stddev_m_s = 0.6;
  expect_contains(refusal(uncertain), "odometry_max_stddev = 0.5");
  for (VelocitySample& sample : uncertain) sample.stddev_m_s = std::numeric_limits<double>::quiet_NaN();
  expect_contains(refusal(uncertain), "odometry_max_stddev");

  std::vector<VelocitySample> jumped = samples_at({-150 * kMs, -100 * kMs, -50 * kMs});
  jumped.back().velocity_m_s += Eigen::Vector3d(3, 0, 0);
  expect_contains(refusal(jumped), "jumps by");

  TranslationOptions slow;
  slow.max_speed_m_s = 0.1;
  expect_contains(refusal(samples_at({-100 * kMs, -50 * kMs}), slow), "odometry_max_speed = 0.1");

  expect_contains(refusal(samples_at({-100 * kMs, -50 * kMs}), {}, track(-kSecond, 0)), "do not cover");
  // Without the gyroscope between them and the frame their axes are not known.
  expect_contains(refusal(samples_at({-100 * kMs, -50 * kMs}), {}, track(-20 * kMs, kSecond)), "fewer than two");
}

TEST(FitVelocity, AVelocityThatJumpedCountsOnceASecondOneAgrees) {
  std::vector<VelocitySample> samples = samples_at({-150 * kMs, -100 * kMs, -50 * kMs});
  samples.front().velocity_m_s += Eigen::Vector3d(5, 0, 0);
  std::string reason;
  const std::optional<BodyVelocity> fitted = fit(samples, &reason);
  ASSERT_TRUE(fitted) << reason;
  EXPECT_LT((fitted->at(0) - Truth::R_0_cam(kMiddleNs).transpose() * Truth::velocity(0)).norm(), 1e-6);
}

TEST(TranslatedMotion, MovesPointsOfThePlaneAsTheirPosesSay) {
  const RotationTrack rotation = track();
  std::string reason;
  const std::optional<BodyVelocity> fitted = fit(samples_at({-160 * kMs, -110 * kMs, -60 * kMs}), &reason);
  ASSERT_TRUE(fitted) << reason;
  constexpr double kDepth_m = 1.7;
  const TranslatedMotion motion(rotation, *fitted, kPlace, kDepth_m);
  for (const auto& [from_ns, to_ns] :
       std::vector<std::pair<TimeNs, TimeNs>>{{-10 * kMs, 30 * kMs}, {30 * kMs, -10 * kMs}, {5 * kMs, 5 * kMs}}) {
    ASSERT_TRUE(motion.covers({std::min(from_ns, to_ns), std::max(from_ns, to_ns)}));
    for (const double x : {-0.6, 0.0, 0.7}) {
      const Eigen::Vector3d ray(x, 0.3, 1);
      const Eigen::Vector2d expected = Truth::moved(ray, kDepth_m, from_ns, to_ns).hnormalized();
      const Eigen::Vector2d moved = (motion.homography(from_ns, to_ns) * ray).hnormalized();
      EXPECT_LT((moved - expected).norm(), 1e-7);
      // The test would see every part missing.
      if (from_ns == to_ns) continue;
      const Eigen::Vector2d rotated = (rotation.homography(from_ns, to_ns) * ray).hnormalized();
      EXPECT_GT((rotated - expected).norm(), 5e-3);
      const TranslatedMotion in_the_camera(rotation, *fitted, Eigen::Vector3d::Zero(), kDepth_m);
      EXPECT_GT(((in_the_camera.homography(from_ns, to_ns) * ray).hnormalized() - expected).norm(), 5e-4);
    }
  }
  EXPECT_FALSE(motion.covers({0, 2 * kSecond}));
  EXPECT_FALSE(motion.covers({}));
}

TEST(TranslatedMotion, RefusesADepthThatIsNone) {
  const RotationTrack rotation = track();
  for (const double depth_m :
       {0.0, -1.0, std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    EXPECT_THROW(TranslatedMotion(rotation, BodyVelocity{}, kPlace, depth_m), std::invalid_argument) << depth_m;
  }
  BodyVelocity unknown;
  unknown.velocity_m_s.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(TranslatedMotion(rotation, unknown, kPlace, 1), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur
