#include "features/residual_rotation.hpp"

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "features/residual_flow.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::residual_rotation_test {
namespace {

Camera wide_lens() {
  CameraCalibration calibration;
  calibration.width_px = 752;
  calibration.height_px = 480;
  calibration.fx_px = calibration.fy_px = 400;
  calibration.cx_px = 370;
  calibration.cy_px = 235;
  calibration.model = "plumb_bob";
  calibration.coefficients = {-0.25, 0.06, 1e-3, -5e-4};
  return Camera(calibration);
}

const BlockGrid kGrid(752, 480, 64);
const RowExposure kExposure(1'000'000'000, 480, ShutterTiming{20'000'000, 10'000'000});

RotationTrack rotating(const Eigen::Vector3d& rate_rad_s) {
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = 900'000'000; t_ns <= 1'200'000'000; t_ns += 5'000'000) samples.push_back({t_ns, rate_rad_s});
  return RotationTrack(samples, GyroOptions(), Eigen::Matrix3d::Identity());
}

/// What a camera sees that rotates and moves before a plane at depth 1 across its axis.
ResidualField field_of(const Camera& camera, const Eigen::Vector3d& rate_rad_s, const Eigen::Vector3d& velocity_m_s) {
  constexpr double kStepS = 1e-4;
  ResidualField field;
  for (int i = 0; i < kGrid.size(); ++i) {
    const Eigen::Vector3d ray = camera.ray(kGrid.center(i));
    const auto after = [&](double s) { return camera.project(so3_exp(-s * rate_rad_s) * (ray - s * velocity_m_s)); };
    field.push_back(ResidualVelocity{(after(kStepS) - after(-kStepS)) / (2 * kStepS), 5});
  }
  return field;
}

TEST(FitResidualRotation, FindsTheRateThatAFieldHasInCommon) {
  const Camera camera = wide_lens();
  const Eigen::Vector3d rate_rad_s(0.05, -0.03, 0.08), known_rad_s(1, -2, 0.5);
  ResidualField field = field_of(camera, rate_rad_s, Eigen::Vector3d::Zero());
  auto rotation = fit_residual_rotation(field, kGrid, camera, rotating(known_rad_s), kExposure);
  ASSERT_TRUE(rotation);
  EXPECT_LT((rotation->rate_rad_s - rate_rad_s).norm(), 1e-5);
  EXPECT_LT((rotation->known_rad_s - known_rad_s).norm(), 1e-6);
  EXPECT_LT(rotation->energy_less_rotation_px2_s2, 1e-4 * rotation->energy_px2_s2);
  EXPECT_GT(rotation->energy_less_translation_px2_s2, 0.05 * rotation->energy_px2_s2);
  // An object that moves by itself, and blocks of which nothing is known.
  for (int i = 0; i < kGrid.size(); ++i) {
    if (i % kGrid.cols() < 3) field[i]->velocity_px_s += Eigen::Vector2d(300, 100);
    if (i % 5 == 0) field[i].reset();
  }
  rotation = fit_residual_rotation(field, kGrid, camera, rotating(known_rad_s), kExposure);
  ASSERT_TRUE(rotation);
  EXPECT_LT((rotation->rate_rad_s - rate_rad_s).norm(), 2e-3);
}

TEST(FitResidualRotation, DistinguishesTranslationBeforeAPlaneFromRotation) {
  const Camera camera = wide_lens();
  const auto rotation = fit_residual_rotation(field_of(camera, Eigen::Vector3d::Zero(), {0.2, 0.1, 0.1}), kGrid, camera,
                                              rotating({0, 0, 0}), kExposure);
  ASSERT_TRUE(rotation);
  EXPECT_LT(rotation->energy_less_translation_px2_s2, 1e-4 * rotation->energy_px2_s2);
  EXPECT_GT(rotation->energy_less_rotation_px2_s2, 100 * rotation->energy_less_translation_px2_s2);
}

TEST(FitResidualRotation, WantsHalfOfTheBlocksAndTheMotion) {
  const Camera camera = wide_lens();
  ResidualField field = field_of(camera, {0.05, 0, 0}, Eigen::Vector3d::Zero());
  EXPECT_FALSE(fit_residual_rotation({}, kGrid, camera, rotating({0, 0, 0}), kExposure));
  EXPECT_FALSE(fit_residual_rotation(field, kGrid, camera, rotating({0, 0, 0}),
                                     RowExposure(9'000'000'000, 480, ShutterTiming{20'000'000, 0})));
  for (int i = 0; i < kGrid.size() / 2 + 1; ++i) field[i].reset();
  EXPECT_FALSE(fit_residual_rotation(field, kGrid, camera, rotating({0, 0, 0}), kExposure));
}

/// Residual rotations of a camera that rotates to and fro, 20 a second, with the noise that they have.
class GyroErrorWatchTest : public testing::Test {
 protected:
  static Eigen::Vector3d known_rad_s(double t_s) {
    return {std::sin(6 * t_s), 1.5 * std::cos(4 * t_s), 0.8 * std::sin(5 * t_s + 1)};
  }
  /// @param error  residual rate from known rate and its change
  template <typename Error>
  void add(double seconds, Error error) {
    std::mt19937 random(3);
    std::normal_distribution<double> noise(0, 0.01);
    for (double t_s = 0; t_s < seconds; t_s += 0.05) {
      ResidualRotation rotation;
      rotation.known_rad_s = known_rad_s(t_s);
      const Eigen::Vector3d change = (known_rad_s(t_s + 1e-3) - known_rad_s(t_s - 1e-3)) / 2e-3;
      rotation.rate_rad_s =
          error(rotation.known_rad_s, change) + Eigen::Vector3d(noise(random), noise(random), noise(random));
      rotation.energy_px2_s2 = 10;
      rotation.energy_less_rotation_px2_s2 = 1;
      rotation.energy_less_translation_px2_s2 = translation_;
      watch_.add(to_ns(t_s), rotation);
    }
  }
  GyroErrorWatch watch_;
  double translation_ = 2;
};

TEST_F(GyroErrorWatchTest, FindsABias) {
  const Eigen::Vector3d bias_rad_s(0.03, -0.04, 0.02);
  const auto error = [&](const Eigen::Vector3d&, const Eigen::Vector3d&) -> Eigen::Vector3d { return -bias_rad_s; };
  add(4.9, error);
  EXPECT_FALSE(watch_.find()) << "too soon";
  watch_.clear();
  add(6, error);
  const auto found = watch_.find();
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::BIAS);
  EXPECT_LT((found->vector - bias_rad_s).norm(), 0.005);
  EXPECT_NEAR(found->seconds, 6, 0.06);
  translation_ = 0.5;  // explains it better
  watch_.clear();
  add(6, error);
  EXPECT_FALSE(watch_.find());
}

TEST_F(GyroErrorWatchTest, FindsAWrongExtrinsic) {
  const Eigen::Vector3d rotation_rad(0.06, 0.08, -0.05);
  add(8,
      [&](const Eigen::Vector3d& rate, const Eigen::Vector3d&) -> Eigen::Vector3d { return rotation_rad.cross(rate); });
  const auto found = watch_.find();
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::EXTRINSIC);
  EXPECT_LT((found->vector - rotation_rad).norm(), 0.01);
}

TEST_F(GyroErrorWatchTest, FindsAWrongTimeOffset) {
  add(8, [&](const Eigen::Vector3d&, const Eigen::Vector3d& change) -> Eigen::Vector3d { return 0.02 * change; });
  const auto found = watch_.find();
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::TIME_OFFSET);
  EXPECT_NEAR(found->time_offset_s, 0.02, 0.002);
}

TEST_F(GyroErrorWatchTest, FindsNothingInNoiseOrInWhatDoesNotLast) {
  add(9, [](const Eigen::Vector3d&, const Eigen::Vector3d&) -> Eigen::Vector3d { return {0, 0, 0}; });
  EXPECT_FALSE(watch_.find());
  watch_.clear();
  int frame = 0;
  add(9, [&](const Eigen::Vector3d&, const Eigen::Vector3d&) -> Eigen::Vector3d {
    ++frame;
    return 0.1 * Eigen::Vector3d(std::sin(0.04 * frame), 0.5, std::cos(0.03 * frame));
  });
  EXPECT_FALSE(watch_.find());
}

/// What is found of a simulated camera of 320x240 after six seconds.
/// @param late_ns   stamps of the gyroscope, beyond what `time_offset` says
/// @param rotation_rad  by which the known rates have to be rotated to be the camera's
std::optional<GyroError> found_in(const std::string& motion, const Eigen::Vector3d& bias_rad_s, TimeNs late_ns = 0,
                                  const Eigen::Vector3d& rotation_rad = Eigen::Vector3d::Zero()) {
  sim::Simulator simulator(sim::parse_scene(YAML::Load(R"(
frames: 120
seed: 5
camera: {size: [320, 240], intrinsics: [200, 200, 159.5, 119.5], fps: 20, exposure_time: 0.02, readout_time: 0.01, noise: 2}
imu: {rate: 200, gyro_noise: 0.003}
planes: [{size: [12, 9], position: [0, 0, 2], texture_size: [2400, 1800], texture_seed: 4}]
)" + motion),
                                            "", "residual rotation"));
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu()) samples.push_back({s.t_ns + late_ns, s.rate_rad_s + bias_rad_s});
  const RotationTrack rotation(samples, GyroOptions{}, so3_exp(-rotation_rad).toRotationMatrix());
  ResidualFlow flow;
  const BlockGrid grid(320, 240, 32);
  GyroErrorWatch watch;
  for (int i = 0; i < simulator.frames(); ++i) {
    const RowExposure exposure = simulator.exposure(i);
    const ResidualField residuals = flow.follow(simulator.frame(i).image, simulator.camera(), rotation, exposure, grid);
    const auto fitted = fit_residual_rotation(residuals, grid, simulator.camera(), rotation, exposure);
    if (fitted) watch.add(exposure.middle(120), *fitted);
  }
  return watch.find();
}

constexpr char kRotating[] =
    "motion: {type: curve, rotation: {sines: [{amplitude: [6, 8, 4], frequency: 1.3, phase: 20}]}}";

TEST(GyroErrorOfImages, IsABiasThatNobodyTold) {
  const Eigen::Vector3d bias_rad_s(0.05, -0.05, 0.05);
  const auto found = found_in(kRotating, bias_rad_s);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::BIAS);
  EXPECT_LT((found->vector - bias_rad_s).cwiseAbs().maxCoeff(), 0.01) << found->vector.transpose();
}

TEST(GyroErrorOfImages, IsAWrongTimeOffset) {
  const auto found = found_in(kRotating, Eigen::Vector3d::Zero(), 15'000'000);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::TIME_OFFSET);
  EXPECT_NEAR(found->time_offset_s, 0.015, 0.003);
}

TEST(GyroErrorOfImages, IsAWrongExtrinsic) {
  // Rates about one axis do not determine a rotation about it.
  const std::string motion = R"(
motion: {type: curve, rotation: {sines: [{amplitude: [6, 0, 4], frequency: 1.3}, {amplitude: [0, 8, 3], frequency: 0.9}]}}
)";
  const Eigen::Vector3d rotation_rad(0.08, -0.1, 0.12);
  const auto found = found_in(motion, Eigen::Vector3d::Zero(), 0, rotation_rad);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, GyroError::Kind::EXTRINSIC);
  EXPECT_LT((found->vector - rotation_rad).norm(), 0.04) << found->vector.transpose();
}

TEST(GyroErrorOfImages, IsNoneOfAGoodGyroscope) { EXPECT_FALSE(found_in(kRotating, Eigen::Vector3d::Zero())); }

TEST(GyroErrorOfImages, IsNoneOfACameraThatMovesToAndFro) {
  EXPECT_FALSE(found_in(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [4, 6, 3], frequency: 1.3, phase: 20}]},
  position: {sines: [{amplitude: [0.25, 0.15, 0.2], frequency: 0.8, phase: 70}]}}
)",
                        Eigen::Vector3d::Zero()));
}

TEST(GyroErrorOfImages, IsNoneOfACameraThatPassesAWall) {
  EXPECT_FALSE(found_in(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [2, 2, 2], frequency: 0.7, phase: 20}]},
  position: {offset: [-1.5, 0, 0], rate: [0.45, 0.05, 0]}}
)",
                        Eigen::Vector3d::Zero()));
}

TEST(GyroErrorOfImages, IsNoneOfACameraThatCirclesWhatItSees) {
  // There translation cancels rotation: the residual rotation is proportional to the rate, but along it.
  EXPECT_FALSE(
      found_in("motion: {type: orbit, center: [0, 0, 2], radius: 2, axis: [0, 1, 0], amplitude: 15, frequency: 0.8}",
               Eigen::Vector3d::Zero()));
}

}  // namespace
}  // namespace gyro_deblur::residual_rotation_test
