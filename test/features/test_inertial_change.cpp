#include "features/inertial_change.hpp"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gyro_deblur::inertial_change_test {
namespace {

constexpr double kStepS = 0.05, kInverseDepth = 0.4, kFocalPx = 400;

/// A camera that swings sideways before a wall, in axes that rotate by a step's rotation with every image.
class Swing {
 public:
  /// @param sensor_scale  of the accelerometer
  explicit Swing(double sensor_scale = 1, const Eigen::Vector3d& rotation_rad = Eigen::Vector3d::Zero())
      : sensor_scale_(sensor_scale),
        rotation_(Eigen::AngleAxisd(rotation_rad.norm(), rotation_rad.stableNormalized())) {
    px_per_ray_ << kFocalPx, 0, 0, 0, kFocalPx, 0;
  }

  InertialChange::Step step(int i, bool with_accelerometer = true) const {
    InertialChange::Step step;
    step.step_s = kStepS;
    step.R_now_before = rotation_.toRotationMatrix().transpose();
    step.px_per_ray = px_per_ray_;
    if (with_accelerometer) {
      const double end_s = i * kStepS, begin_s = end_s - kStepS;
      const Eigen::Vector3d pull_m_s2(1, -9.7, 0.8);  // gravity and bias
      VelocityGain gain;
      gain.total_m_s = velocity(end_s) - velocity(begin_s) + kStepS * pull_m_s2;
      gain.mean_m_s = mean(i) - velocity(begin_s) + kStepS / 2 * pull_m_s2;
      gain.total_m_s = sensor_scale_ * (axes(i) * gain.total_m_s);
      gain.mean_m_s = sensor_scale_ * (axes(i) * gain.mean_m_s);
      step.gain = gain;
    }
    step.acceleration_changed_px_s2 = in_image(i, (mean(i) - 2 * mean(i - 1) + mean(i - 2)) / kStepS);
    return step;
  }
  /// What is to be found.
  Eigen::Vector2d beyond_even(int i) const {
    return in_image(i, velocity(i * kStepS) - mean(i) - 0.5 * (mean(i) - mean(i - 1)));
  }

 private:
  static constexpr double kOmega = 2 * M_PI * 2.5;
  static Eigen::Vector3d velocity(double t_s) {
    return {0.8 * std::sin(kOmega * t_s), 0.5 * std::sin(0.8 * kOmega * t_s + 1), 0.3 * std::sin(kOmega * t_s + 2)};
  }
  static Eigen::Vector3d place(double t_s) {
    return {-0.8 / kOmega * std::cos(kOmega * t_s), -0.5 / (0.8 * kOmega) * std::cos(0.8 * kOmega * t_s + 1),
            -0.3 / kOmega * std::cos(kOmega * t_s + 2)};
  }
  static Eigen::Vector3d mean(int i) { return (place(i * kStepS) - place((i - 1) * kStepS)) / kStepS; }
  /// World to camera.
  Eigen::Matrix3d axes(int i) const {
    return Eigen::AngleAxisd(rotation_.angle() * i, rotation_.axis()).toRotationMatrix().transpose();
  }
  Eigen::Vector2d in_image(int i, const Eigen::Vector3d& world_m_s) const {
    return -kInverseDepth * px_per_ray_ * (axes(i) * world_m_s);
  }

  double sensor_scale_;
  Eigen::AngleAxisd rotation_;
  Eigen::Matrix<double, 2, 3> px_per_ray_;
};

/// Root of the mean square of what is left of what there was to find, over that, from image `from` on.
double left_over(const Swing& swing, int from = 10) {
  InertialChange change;
  double left = 0, all = 0;
  for (int i = 1; i < 40; ++i) {
    const Eigen::Vector2d found = change.beyond_even(swing.step(i));
    if (i < from) continue;
    left += (found - swing.beyond_even(i)).squaredNorm();
    all += swing.beyond_even(i).squaredNorm();
  }
  return std::sqrt(left / all);
}

TEST(InertialChange, IsFoundDespiteGravityAndBias) {
  EXPECT_LT(left_over(Swing()), 0.02);
  InertialChange change;
  for (int i = 1; i < 20; ++i) change.beyond_even(Swing().step(i));
  EXPECT_NEAR(change.inverse_depth_1_m(), kInverseDepth, 0.02 * kInverseDepth);
}

TEST(InertialChange, NeedsAFewImagesForTheDepth) {
  InertialChange change;
  for (int i = 1; i < 3; ++i) EXPECT_EQ(change.beyond_even(Swing().step(i)), Eigen::Vector2d::Zero());
  EXPECT_LT(left_over(Swing(), 4), 0.3);
}

TEST(InertialChange, RotatesWithTheCamera) {
  // 4 rad/s. Gravity rotates as well.
  EXPECT_LT(left_over(Swing(1, {0.1, 0.05, 0.15})), 0.05);
}

TEST(InertialChange, OfASensorThatContradictsTheImagesIsNone) {
  InertialChange change;
  for (int i = 1; i < 40; ++i) EXPECT_EQ(change.beyond_even(Swing(-1).step(i)).norm(), 0);
  EXPECT_EQ(change.inverse_depth_1_m(), 0);
}

TEST(InertialChange, WithoutAnAccelerometerIsNone) {
  InertialChange change;
  const Swing swing;
  for (int i = 1; i < 20; ++i) change.beyond_even(swing.step(i));
  EXPECT_EQ(change.beyond_even(swing.step(20, false)).norm(), 0);
  EXPECT_EQ(change.beyond_even(swing.step(21)).norm(), 0) << "of the step before nothing is known";
  EXPECT_EQ(change.beyond_even(swing.step(22)).norm(), 0) << "nothing to compare with";
  EXPECT_GT(change.beyond_even(swing.step(23)).norm(), 0);
  change.clear();
  EXPECT_EQ(change.inverse_depth_1_m(), 0);
}

TEST(InertialChange, IsNoneWhereNothingIsComparedAndItsDepthFades) {
  InertialChange change;
  const Swing swing;
  for (int i = 1; i < 20; ++i) change.beyond_even(swing.step(i));
  EXPECT_GT(change.inverse_depth_1_m(), 0.9 * kInverseDepth);
  for (int i = 20; i < 80; ++i) {
    InertialChange::Step dark = swing.step(i);
    dark.acceleration_changed_px_s2.reset();
    EXPECT_EQ(change.beyond_even(dark).norm(), 0);
  }
  EXPECT_LT(change.inverse_depth_1_m(), 0.8 * kInverseDepth);
}

TEST(InertialChange, BeyondTheLensModelIsNone) {
  InertialChange change;
  const Swing swing;
  for (int i = 1; i < 20; ++i) change.beyond_even(swing.step(i));
  InertialChange::Step step = swing.step(20);
  step.px_per_ray(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(change.beyond_even(step).norm(), 0);
  EXPECT_TRUE(std::isfinite(change.inverse_depth_1_m()));
}

TEST(InertialChange, OfGravityIsNoneWhateverTheStep) {
  InertialChange change;
  for (const double step_s : {0.05, 0.05, 0.0575, 0.05, 0.1, 0.05, 0.2}) {
    InertialChange::Step step = Swing().step(1);
    step.step_s = step_s;
    step.gain = VelocityGain{Eigen::Vector3d(3, -9, 1) * step_s, Eigen::Vector3d(3, -9, 1) * step_s / 2};
    step.acceleration_changed_px_s2 = Eigen::Vector2d(100, 100);
    EXPECT_LT(change.beyond_even(step).norm(), 1e-9);
  }
}

}  // namespace
}  // namespace gyro_deblur::inertial_change_test
