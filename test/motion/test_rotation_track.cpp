#include "gyro_deblur/rotation_track.hpp"

#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "analytic_motion.hpp"

namespace gyro_deblur::rotation_track_test {
namespace {

using test::AnalyticMotion;
using test::rotation_distance;

constexpr TimeNs kMs = 1'000'000;
const Eigen::Matrix3d kIdentity = Eigen::Matrix3d::Identity();

/// A proper rotation without symmetry, so that a transposed or permuted one is another.
Eigen::Matrix3d some_rotation() {
  return (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitX()) * Eigen::AngleAxisd(-1.9, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()))
      .toRotationMatrix();
}

TEST(So3Exp, AgreesWithAngleAxisAtEverySize) {
  const Eigen::Vector3d axis = Eigen::Vector3d(1, -2, 0.5).normalized();
  for (const double angle : {1e-12, 1e-6, 1e-3, 0.0999, 0.1001, 1.0, 3.0, 6.0}) {
    const Eigen::Matrix3d expected = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    EXPECT_LT((so3_exp(angle * axis).toRotationMatrix() - expected).norm(), 1e-14) << angle;
    EXPECT_NEAR(so3_exp(angle * axis).norm(), 1, 1e-15);
  }
  EXPECT_TRUE(so3_exp(Eigen::Vector3d::Zero()).isApprox(Eigen::Quaterniond::Identity(), 0));
}

Eigen::Quaterniond integrate_finely(const Eigen::Vector3d& w0, const Eigen::Vector3d& w1, double dt, int steps) {
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  for (int i = 0; i < steps; ++i) q = q * so3_exp((w0 + (i + 0.5) / steps * (w1 - w0)) * (dt / steps));
  return q;
}

// Also fails when the sign of the commutator term is that of multiplication from the left.
TEST(IntegrateLinearRate, HasALocalErrorOfFifthOrder) {
  const Eigen::Vector3d w0(2, -1, 3), slope(300, 500, -400);
  double previous = 0;
  for (const double dt : {0.02, 0.01, 0.005}) {
    const Eigen::Vector3d w1 = w0 + slope * dt;
    const Eigen::Matrix3d truth = integrate_finely(w0, w1, dt, 20000).toRotationMatrix();
    const double error = rotation_distance(integrate_linear_rate(w0, w1, dt).toRotationMatrix(), truth);
    const double without = rotation_distance(so3_exp(0.5 * dt * (w0 + w1)).toRotationMatrix(), truth);
    EXPECT_LT(error, 0.05 * without) << dt;
    if (previous > 0) {
      EXPECT_GT(previous / error, 24);  // 2^5, less a margin for the next order
    }
    previous = error;
  }
  EXPECT_LT(previous, 1e-7);
}

TEST(RotationTrack, ConstantRateIsExactBetweenSamplesToo) {
  const AnalyticMotion motion = AnalyticMotion::constant_rate({0.5, -2, 1});
  const RotationTrack track(motion.sample({0, 500 * kMs}, 5 * kMs), {}, kIdentity);
  for (TimeNs t = 0; t <= 500 * kMs; t += 1'234'567) {
    EXPECT_LT(rotation_distance(track.rotation(0, t), motion.rotation(0, t)), 1e-12) << t;
    EXPECT_LT(rotation_distance(track.rotation(t, 0), motion.R_world_cam(0).transpose() * motion.R_world_cam(t)),
              1e-12);
  }
}

// Half-way between two samples a steady acceleration has rotated by less than half of the angle.
TEST(RotationTrack, RateIsLinearBetweenSamples) {
  constexpr double kAcceleration = 100;  // [rad/s^2]
  std::vector<GyroSample> samples;
  for (int k = 0; k <= 10; ++k) samples.push_back({k * 10 * kMs, Eigen::Vector3d(0, kAcceleration * 0.01 * k, 0)});
  const RotationTrack track(samples, {}, kIdentity);
  for (TimeNs t = 0; t <= 100 * kMs; t += 2'500'000) {
    const double turned_rad = 0.5 * kAcceleration * to_seconds(t) * to_seconds(t);
    const Eigen::Matrix3d R_0_t = Eigen::AngleAxisd(turned_rad, Eigen::Vector3d::UnitY()).toRotationMatrix();
    EXPECT_LT(rotation_distance(track.rotation(t, 0), R_0_t), 1e-9) << t;
  }
}

TEST(RotationTrack, FollowsAHandshake) {
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const RotationTrack track(motion.sample({0, 1000 * kMs}, 5 * kMs), {}, kIdentity);
  for (TimeNs t = 0; t + 30 * kMs <= 1000 * kMs; t += 7'654'321) {
    const double error = rotation_distance(track.rotation(t, t + 30 * kMs), motion.rotation(t, t + 30 * kMs));
    EXPECT_LT(error, 1e-4);  // 0.05 px at a focal length of 500 px
  }
}

TEST(RotationTrack, SceneMovesAgainstTheCamera) {
  // Camera axes: x right, y down, z forward. Rotating about +y looks right, so the scene moves left.
  const auto straight_ahead = [](const Eigen::Vector3d& rate, TimeNs from, TimeNs to) -> Eigen::Vector3d {
    const RotationTrack track({{0, rate}, {10 * kMs, rate}}, {}, kIdentity);
    return track.rotation(from, to) * Eigen::Vector3d::UnitZ();
  };
  EXPECT_NEAR(straight_ahead({0, 1, 0}, 0, 10 * kMs).x(), -std::sin(0.01), 1e-12);
  EXPECT_NEAR(straight_ahead({0, 1, 0}, 10 * kMs, 0).x(), std::sin(0.01), 1e-12);
  // Rotating about +x looks up, so the scene moves down.
  EXPECT_NEAR(straight_ahead({1, 0, 0}, 0, 10 * kMs).y(), std::sin(0.01), 1e-12);
}

TEST(RotationTrack, AppliesTheExtrinsicInItsDirection) {
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const Eigen::Matrix3d R_cam_imu = some_rotation();
  const auto samples = motion.sample({0, 200 * kMs}, 2 * kMs, R_cam_imu);
  const RotationTrack right(samples, {}, R_cam_imu);
  const RotationTrack transposed(samples, {}, R_cam_imu.transpose());
  const Eigen::Matrix3d truth = motion.rotation(20 * kMs, 150 * kMs);
  EXPECT_LT(rotation_distance(right.rotation(20 * kMs, 150 * kMs), truth), 1e-4);
  EXPECT_GT(rotation_distance(transposed.rotation(20 * kMs, 150 * kMs), truth), 0.05);
}

TEST(RotationTrack, SubtractsTheBiasOnce) {
  const AnalyticMotion motion = AnalyticMotion::handshake();
  GyroOptions options;
  options.bias_rad_s = {0.08, -0.02, 0.05};
  const auto samples = motion.sample({0, 200 * kMs}, 2 * kMs, some_rotation(), options);
  const Eigen::Matrix3d truth = motion.rotation(0, 200 * kMs);
  const RotationTrack right(samples, options, some_rotation());
  EXPECT_LT(rotation_distance(right.rotation(0, 200 * kMs), truth), 1e-4);
  const RotationTrack none(samples, {}, some_rotation());
  EXPECT_NEAR(rotation_distance(none.rotation(0, 200 * kMs), truth), 0.2 * options.bias_rad_s.norm(), 1e-3);
}

TEST(RotationTrack, CameraClockIsImuClockLessTheOffset) {
  const AnalyticMotion motion = AnalyticMotion::handshake();
  GyroOptions options;
  options.time_offset_ns = -17'552'000;
  const auto samples = motion.sample({0, 300 * kMs}, 2 * kMs, kIdentity, options);
  EXPECT_EQ(samples.front().t_ns, -17'552'000);
  const Eigen::Matrix3d truth = motion.rotation(100 * kMs, 130 * kMs);
  const RotationTrack right(samples, options, kIdentity);
  EXPECT_EQ(right.available().begin_ns, 0);
  EXPECT_EQ(right.available().end_ns, 300 * kMs);
  EXPECT_LT(rotation_distance(right.rotation(100 * kMs, 130 * kMs), truth), 1e-4);
  GyroOptions flipped;
  flipped.time_offset_ns = -options.time_offset_ns;
  const RotationTrack wrong(samples, flipped, kIdentity);
  EXPECT_GT(rotation_distance(wrong.rotation(100 * kMs, 130 * kMs), truth), 5e-3);
}

TEST(RotationTrack, NeverExtrapolates) {
  const AnalyticMotion motion = AnalyticMotion::constant_rate({0, 1, 0});
  const RotationTrack track(motion.sample({100 * kMs, 200 * kMs}, 10 * kMs), {}, kIdentity);
  EXPECT_TRUE(track.covers({100 * kMs, 200 * kMs}));
  EXPECT_FALSE(track.covers({100 * kMs - 1, 200 * kMs}));
  EXPECT_FALSE(track.covers({100 * kMs, 200 * kMs + 1}));
  EXPECT_FALSE(track.covers({150 * kMs, 149 * kMs}));
  EXPECT_NO_THROW(track.rotation(200 * kMs, 100 * kMs));
  EXPECT_THROW(track.rotation(100 * kMs - 1, 150 * kMs), std::out_of_range);
  EXPECT_THROW(track.rotation(150 * kMs, 200 * kMs + 1), std::out_of_range);
  try {
    track.rotation(150 * kMs, 250 * kMs);
    FAIL();
  } catch (const std::out_of_range& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("[0.150000000, 0.250000000] s was asked for"), std::string::npos) << text;
    EXPECT_NE(text.find("[0.100000000, 0.200000000] s is available"), std::string::npos) << text;
  }
}

TEST(RotationTrack, KnowsNothingWithoutSamplesAndOneInstantWithOne) {
  const RotationTrack none({}, {}, kIdentity);
  EXPECT_TRUE(none.available().empty());
  EXPECT_FALSE(none.covers({0, 0}));
  EXPECT_THROW(none.rotation(0, 0), std::out_of_range);
  const RotationTrack one({{5, Eigen::Vector3d::UnitX()}}, {}, kIdentity);
  EXPECT_TRUE(one.covers({5, 5}));
  EXPECT_FALSE(one.covers({5, 6}));
  EXPECT_TRUE(one.rotation(5, 5).isIdentity());
}

TEST(RotationTrack, DoesNotIntegrateAcrossAHole) {
  const AnalyticMotion motion = AnalyticMotion::constant_rate({0.3, 1, -0.2});
  std::vector<GyroSample> samples = motion.sample({0, 100 * kMs}, 10 * kMs);
  const auto later = motion.sample({151 * kMs, 251 * kMs}, 10 * kMs);  // 51 ms, one more than allowed
  samples.insert(samples.end(), later.begin(), later.end());
  const RotationTrack track(samples, {}, kIdentity);
  EXPECT_TRUE(track.covers({0, 100 * kMs}));
  EXPECT_TRUE(track.covers({151 * kMs, 251 * kMs}));
  EXPECT_FALSE(track.covers({90 * kMs, 100 * kMs + 1}));
  EXPECT_FALSE(track.covers({151 * kMs - 1, 160 * kMs}));
  EXPECT_FALSE(track.covers({120 * kMs, 120 * kMs}));
  EXPECT_FALSE(track.covers({0, 251 * kMs}));
  EXPECT_EQ(track.available().end_ns, 251 * kMs);
  EXPECT_THROW(track.rotation(50 * kMs, 200 * kMs), std::out_of_range);
  EXPECT_LT(rotation_distance(track.rotation(160 * kMs, 240 * kMs), motion.rotation(160 * kMs, 240 * kMs)), 1e-12);

  GyroOptions tolerant;
  tolerant.max_gap_ns = 51 * kMs;
  const RotationTrack across(samples, tolerant, kIdentity);
  EXPECT_TRUE(across.covers({0, 251 * kMs}));
  EXPECT_LT(rotation_distance(across.rotation(0, 251 * kMs), motion.rotation(0, 251 * kMs)), 1e-12);
}

// A frame is the same bit by bit whether or not somebody else needs to look further back.
TEST(RotationTrack, SamplesBeforeTheOriginChangeNothingAfterIt) {
  const AnalyticMotion motion = AnalyticMotion::handshake();
  constexpr std::size_t kOrigin = 60;
  for (const bool with_hole : {false, true}) {
    std::vector<GyroSample> samples = motion.sample({0, 500 * kMs}, 5 * kMs);
    if (with_hole) samples.erase(samples.begin() + 70, samples.begin() + 85);
    const std::vector<GyroSample> newer(samples.begin() + kOrigin, samples.end());
    const RotationTrack alone(newer, {}, kIdentity), whole(samples, {}, kIdentity, kOrigin);
    EXPECT_EQ(whole.available().begin_ns, 0);
    for (TimeNs t = 300 * kMs; t <= 500 * kMs; t += 1'234'567) {
      for (TimeNs to = 300 * kMs; to <= 500 * kMs; to += 7'654'321) {
        const TimeRange range{std::min(t, to), std::max(t, to)};
        ASSERT_EQ(alone.covers(range), whole.covers(range)) << t << ' ' << to;
        if (!alone.covers(range)) continue;
        EXPECT_EQ(alone.rotation(t, to), whole.rotation(t, to)) << t << ' ' << to;
      }
    }
    // What lies before it is as right as ever, also to what lies after it.
    EXPECT_LT(rotation_distance(whole.rotation(20 * kMs, 310 * kMs), motion.rotation(20 * kMs, 310 * kMs)), 1e-4);
    EXPECT_LT(rotation_distance(whole.rotation(0, 300 * kMs),
                                motion.R_world_cam(300 * kMs).transpose() * motion.R_world_cam(0)),
              1e-4);
  }
  EXPECT_THROW(RotationTrack(motion.sample({0, 10 * kMs}, 5 * kMs), {}, kIdentity, 3), std::invalid_argument);
}

TEST(RotationTrack, SaturatedSampleReachesTheRangeOnOneAxis) {
  GyroOptions options;
  options.range_rad_s = 10;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double sign : {-1.0, 1.0}) {
      GyroSample sample{0, Eigen::Vector3d::Constant(0.5)};
      sample.rate_rad_s[axis] = sign * 9.98;
      EXPECT_FALSE(is_saturated(sample, options)) << axis;
      for (const double magnitude : {9.991, 10.0, 12.0}) {
        sample.rate_rad_s[axis] = sign * magnitude;
        EXPECT_TRUE(is_saturated(sample, options)) << axis << ' ' << magnitude;
        EXPECT_FALSE(is_saturated(sample, {})) << "the range is not known";
      }
    }
  }
  // Each axis has the range, not the length of the vector.
  EXPECT_FALSE(is_saturated({0, Eigen::Vector3d::Constant(9)}, options));
}

TEST(RotationTrack, KnowsNothingNextToASaturatedSample) {
  const AnalyticMotion motion = AnalyticMotion::constant_rate({0.3, 1, -0.2});
  std::vector<GyroSample> samples = motion.sample({0, 200 * kMs}, 10 * kMs);
  GyroOptions options;
  options.range_rad_s = 2;
  options.bias_rad_s = {0, 0.5, 0};  // the sensor clips what it reads, bias included
  for (GyroSample& sample : samples) sample.rate_rad_s += options.bias_rad_s;
  samples[10].rate_rad_s.y() = -2;
  const RotationTrack track(samples, options, kIdentity);
  EXPECT_TRUE(track.covers({0, 90 * kMs}));
  EXPECT_TRUE(track.covers({110 * kMs, 200 * kMs}));
  EXPECT_FALSE(track.covers({80 * kMs, 90 * kMs + 1}));
  EXPECT_FALSE(track.covers({110 * kMs - 1, 120 * kMs}));
  EXPECT_FALSE(track.covers({95 * kMs, 99 * kMs}));
  EXPECT_FALSE(track.covers({0, 200 * kMs}));
  EXPECT_THROW(track.rotation(50 * kMs, 150 * kMs), std::out_of_range);
  EXPECT_LT(rotation_distance(track.rotation(110 * kMs, 200 * kMs), motion.rotation(110 * kMs, 200 * kMs)), 1e-12);
  GyroOptions unchecked = options;
  unchecked.range_rad_s = 0;
  EXPECT_TRUE(RotationTrack(samples, unchecked, kIdentity).covers({0, 200 * kMs}));
}

TEST(RotationTrack, RefusesBadInput) {
  const Eigen::Vector3d w = Eigen::Vector3d::Zero();
  EXPECT_THROW(RotationTrack({{1, w}, {1, w}}, {}, kIdentity), std::invalid_argument);
  EXPECT_THROW(RotationTrack({{2, w}, {1, w}}, {}, kIdentity), std::invalid_argument);
  EXPECT_THROW(RotationTrack({{1, Eigen::Vector3d::Constant(std::nan(""))}}, {}, kIdentity), std::invalid_argument);
  GyroOptions bad;
  bad.max_gap_ns = 0;
  EXPECT_THROW(RotationTrack({{1, w}}, bad, kIdentity), OptionError);
  EXPECT_THROW(RotationTrack({{1, w}}, {}, -kIdentity), OptionError);
}

std::string rotation_error(const Eigen::Matrix3d& R) {
  try {
    require_rotation("R_cam_imu", R);
  } catch (const OptionError& error) {
    return error.what();
  }
  return {};
}

TEST(RequireRotation, ProjectsPrintedMatricesAndRefusesOthers) {
  const Eigen::Matrix3d R = some_rotation();
  EXPECT_LT((require_rotation("R", R) - R).norm(), 1e-14);
  const Eigen::Matrix3d printed = (R * 1000).array().round() / 1000;
  const Eigen::Matrix3d projected = require_rotation("R", printed);
  EXPECT_LT((projected * projected.transpose() - kIdentity).norm(), 1e-14);
  EXPECT_LT(rotation_distance(projected, R), 1e-3);

  EXPECT_NE(rotation_error(1.01 * R).find("not orthonormal"), std::string::npos);
  EXPECT_NE(rotation_error(Eigen::Matrix3d::Zero()).find("not orthonormal"), std::string::npos);
  EXPECT_NE(rotation_error(Eigen::Matrix3d::Constant(std::nan(""))).find("R_cam_imu"), std::string::npos);
  Eigen::Matrix3d mirrored = R;
  mirrored.row(1) *= -1;
  const std::string message = rotation_error(mirrored);
  EXPECT_EQ(message.rfind("R_cam_imu has determinant -1: it mirrors", 0), 0u) << message;
  EXPECT_NE(message.find("+1"), std::string::npos) << message;
}

/// Samples of an IMU in a hand that rotates and shakes, and its velocity in the axes of the world.
struct ShakenImu {
  static Eigen::Vector3d velocity_m_s(double t_s) {
    return {0.5 * std::sin(17 * t_s), 0.3 * std::cos(11 * t_s), 0.1 * t_s};
  }
  static Eigen::Vector3d place_m(double t_s) {
    return {-0.5 / 17 * std::cos(17 * t_s), 0.3 / 11 * std::sin(11 * t_s), 0.05 * t_s * t_s};
  }
  static Eigen::Vector3d specific_force_m_s2(double t_s) {
    return {0.5 * 17 * std::cos(17 * t_s), -0.3 * 11 * std::sin(11 * t_s), 0.1 + 9.81};
  }
  std::vector<GyroSample> samples(const Eigen::Matrix3d& R_cam_imu) const {
    std::vector<GyroSample> samples = motion.sample({0, 200 * kMs}, 4 * kMs, R_cam_imu);
    for (GyroSample& sample : samples) {
      sample.specific_force_m_s2 = R_cam_imu.transpose() * motion.R_world_cam(sample.t_ns).transpose() *
                                   specific_force_m_s2(to_seconds(sample.t_ns));
    }
    return samples;
  }
  AnalyticMotion motion = AnalyticMotion::handshake();
};

TEST(VelocityGain, IsTheIntegralOfTheAccelerometer) {
  const ShakenImu imu;
  const RotationTrack track(imu.samples(some_rotation()), {}, some_rotation());
  for (const auto& [from_ns, to_ns] : {std::pair(20 * kMs, 68 * kMs), {21 * kMs, 67 * kMs}, {0, 200 * kMs}}) {
    const auto gain = track.velocity_gain(from_ns, to_ns);
    ASSERT_TRUE(gain);
    const double from_s = to_seconds(from_ns), to_s = to_seconds(to_ns), step_s = to_s - from_s;
    const Eigen::Vector3d pull_m_s(0, 0, 9.81 * step_s);  // of gravity, the other way round
    const Eigen::Matrix3d R_cam_world = imu.motion.R_world_cam(to_ns).transpose();
    const Eigen::Vector3d total_m_s = imu.velocity_m_s(to_s) - imu.velocity_m_s(from_s) + pull_m_s,
                          mean_m_s = (imu.place_m(to_s) - imu.place_m(from_s)) / step_s - imu.velocity_m_s(from_s) +
                                     pull_m_s / 2;
    EXPECT_LT((gain->total_m_s - R_cam_world * total_m_s).norm(), 1e-3);
    EXPECT_LT((gain->mean_m_s - R_cam_world * mean_m_s).norm(), 1e-3);
  }
}

TEST(VelocityGain, IsNoneWithoutAnAccelerometerOrBeyondWhatIsCovered) {
  const ShakenImu imu;
  std::vector<GyroSample> samples = imu.samples(kIdentity);
  EXPECT_FALSE(RotationTrack(imu.motion.sample({0, 200 * kMs}, 4 * kMs), {}, kIdentity).velocity_gain(0, 50 * kMs));
  const RotationTrack track(samples, {}, kIdentity);
  EXPECT_FALSE(track.velocity_gain(-1, 50 * kMs));
  EXPECT_FALSE(track.velocity_gain(50 * kMs, 200 * kMs + 1));
  EXPECT_FALSE(track.velocity_gain(50 * kMs, 50 * kMs));
  EXPECT_FALSE(track.velocity_gain(50 * kMs, 20 * kMs));
  samples[10].specific_force_m_s2.y() = -170;  // beyond any sensor
  const RotationTrack spoilt(samples, {}, kIdentity);
  EXPECT_FALSE(spoilt.velocity_gain(20 * kMs, 60 * kMs));
  EXPECT_TRUE(spoilt.velocity_gain(48 * kMs, 100 * kMs)) << "behind it";
}

}  // namespace
}  // namespace gyro_deblur::rotation_track_test
