#include "features/residual_flow.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"
#include "features/corner_following.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::residual_flow_test {
namespace {

using sim::Simulator;

constexpr int kBlockPx = 64;

Simulator simulator_of(const std::string& motion, int frames = 8) {
  return Simulator(sim::parse_scene(YAML::Load("frames: " + std::to_string(frames) + R"(
seed: 5
camera: {size: [640, 480], intrinsics: [400, 400, 320, 240], fps: 20, exposure_time: 0.02, readout_time: 0.015, noise: 2}
imu: {rate: 400}
planes: [{size: [9, 7], position: [0, 0, 2], texture_size: [2400, 1800], texture_seed: 4}]
)" + motion),
                                    "", "residual flow"));
}

enum class Accelerometer { NONE, PRESENT, ALWAYS_ZERO };

RotationTrack rotation_of(const Simulator& simulator, const Eigen::Vector3d& bias_rad_s = Eigen::Vector3d::Zero(),
                          Accelerometer accelerometer = Accelerometer::NONE) {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu()) {
    GyroSample& sample = samples.emplace_back(GyroSample{s.t_ns, s.rate_rad_s + bias_rad_s});
    if (accelerometer == Accelerometer::PRESENT) sample.specific_force_m_s2 = s.specific_force_m_s2;
    if (accelerometer == Accelerometer::ALWAYS_ZERO) sample.specific_force_m_s2.setZero();
  }
  return RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
}

/// The path of a block by its gyroscope and its residual velocity, less the true one [px].
struct Errors {
  std::vector<double> by_gyroscope_px, by_both_px;
  std::size_t certain = 0, blocks = 0;
};

Errors errors_of(Simulator simulator, const CameraMotion& rotation) {
  ResidualFlow flow;
  const BlockGrid grid(640, 480, kBlockPx);
  Errors errors;
  for (int i = 0; i < simulator.frames(); ++i) {
    const RowExposure exposure = simulator.exposure(i);
    const ResidualField residuals = flow.follow(simulator.frame(i).image, simulator.camera(), rotation, exposure, grid);
    if (i == 0) {
      EXPECT_TRUE(residuals.empty()) << "there is nothing to follow from";
    }
    if (i < 2) continue;
    for (int b = 0; b < grid.size(); ++b) {
      const Eigen::Vector2d center_px = grid.center(b), truth_px = simulator.truth_displacement(i, center_px);
      const double y = center_px.y();
      const Eigen::Vector3d ray = simulator.camera().ray(center_px);
      const auto place = [&](TimeNs t_ns) -> Eigen::Vector2d {
        return simulator.camera().project(rotation.rotation(exposure.middle(y), t_ns) * ray);
      };
      const Eigen::Vector2d by_gyroscope_px = place(exposure.end(y)) - place(exposure.start(y));
      if (!truth_px.allFinite() || !by_gyroscope_px.allFinite()) continue;
      ++errors.blocks;
      errors.by_gyroscope_px.push_back((by_gyroscope_px - truth_px).norm());
      Eigen::Vector2d both_px = by_gyroscope_px;
      if (!residuals.empty() && residuals[b] && is_certain(*residuals[b], exposure.timing().exposure_ns)) {
        ++errors.certain;
        both_px += to_seconds(exposure.timing().exposure_ns) * residuals[b]->velocity_px_s;
      }
      errors.by_both_px.push_back((both_px - truth_px).norm());
    }
  }
  return errors;
}

double percentile(std::vector<double> values, double part) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

TEST(ResidualFlow, MeasuresTheTranslationThatTheGyroscopeDoesNot) {
  const Simulator simulator = simulator_of(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [4, 6, 3], frequency: 1.3, phase: 20}]},
  position: {sines: [{amplitude: [0.25, 0.15, 0.2], frequency: 0.8, phase: 70}]}}
)");
  const Errors errors = errors_of(simulator, rotation_of(simulator));
  EXPECT_GT(percentile(errors.by_gyroscope_px, 0.5), 2);
  EXPECT_LT(percentile(errors.by_both_px, 0.5), 0.25);
  EXPECT_LT(percentile(errors.by_both_px, 0.9), 0.6);
}

TEST(ResidualFlow, IsTheSameOnAnyNumberOfThreads) {
  const EagerHelpers eager_helpers;
  Simulator simulator = simulator_of(R"(
motion: {type: curve, position: {sines: [{amplitude: [0.25, 0.15, 0.2], frequency: 0.8, phase: 70}]}}
)",
                                     3);
  const RotationTrack rotation = rotation_of(simulator);
  const BlockGrid grid(640, 480, kBlockPx);
  ResidualFlow alone, shared;
  for (int i = 0; i < simulator.frames(); ++i) {
    const cv::Mat image = simulator.frame(i).image;
    const auto follow = [&](ResidualFlow& flow, int threads) {
      return flow.follow(image, simulator.camera(), rotation, simulator.exposure(i), grid, threads);
    };
    const ResidualField one = follow(alone, 1), four = follow(shared, 4);
    ASSERT_EQ(one.size(), four.size());
    ASSERT_EQ(alone.samples().size(), shared.samples().size());
    if (i > 0) {
      EXPECT_GT(alone.samples().size(), 100U);
    }
    for (std::size_t k = 0; k < alone.samples().size(); ++k) {
      EXPECT_EQ(alone.samples()[k].pixel_px, shared.samples()[k].pixel_px);
    }
    for (std::size_t b = 0; b < one.size(); ++b) {
      ASSERT_EQ(one[b].has_value(), four[b].has_value());
      if (one[b]) {
        EXPECT_EQ(one[b]->velocity_px_s, four[b]->velocity_px_s);
      }
    }
  }
}

TEST(Downsample2x, IsWhatOneLoopOverTheImageMakes) {
  const EagerHelpers eager_helpers;
  cv::RNG random(3);
  for (const cv::Size& size : {cv::Size(752, 480), cv::Size(641, 255), cv::Size(40, 65), cv::Size(9, 3)}) {
    cv::Mat image(size, CV_8U), expected;
    random.fill(image, cv::RNG::UNIFORM, 0, 256);
    cv::pyrDown(image, expected);
    const cv::Mat half = downsample2x(image, 4);
    ASSERT_EQ(half.size(), expected.size());
    EXPECT_EQ(cv::norm(half, expected, cv::NORM_INF), 0) << size;
  }
}

TEST(SearchImage, IsHalvedUntilItIsNoWiderThan250Px) {
  const auto expect_scale = [](int width_px, double scale, int searched_px) {
    const SearchImage image = search_image(cv::Mat(200, width_px, CV_8U, cv::Scalar(90)), 1);
    EXPECT_EQ(image.scale, scale) << width_px;
    EXPECT_EQ(image.pyramid.front().cols, searched_px) << width_px;
  };
  expect_scale(250, 1, 250);
  expect_scale(251, 2, 126);
  expect_scale(752, 4, 188);
  expect_scale(1920, 8, 240);
}

TEST(ResidualFlow, KnowsByTheAccelerometerWhatHappensBetweenTwoImages) {
  const Simulator simulator = simulator_of(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [4, 6, 3], frequency: 1.3, phase: 20}]},
  position: {sines: [{amplitude: [0.06, 0.04, 0.03], frequency: 3, phase: 70}]}}
)",
                                           20);
  const Errors without = errors_of(simulator, rotation_of(simulator)),
               with = errors_of(simulator, rotation_of(simulator, {0, 0, 0}, Accelerometer::PRESENT)),
               zeros = errors_of(simulator, rotation_of(simulator, {0, 0, 0}, Accelerometer::ALWAYS_ZERO));
  EXPECT_GT(percentile(without.by_both_px, 0.5), 0.3);
  EXPECT_LT(percentile(with.by_both_px, 0.5), 0.7 * percentile(without.by_both_px, 0.5));
  EXPECT_EQ(zeros.by_both_px, without.by_both_px);
}

TEST(ResidualFlow, LeavesARotatingCameraToItsGyroscope) {
  const Simulator simulator = simulator_of(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [9, 12, 6], frequency: 1.7, phase: 20}]}}
)");
  // The accelerometer feels gravity alone, from all sides.
  for (const Accelerometer accelerometer : {Accelerometer::NONE, Accelerometer::PRESENT}) {
    const Errors errors = errors_of(simulator, rotation_of(simulator, {0, 0, 0}, accelerometer));
    EXPECT_LT(errors.certain, errors.blocks / 50);
    EXPECT_LT(percentile(errors.by_both_px, 0.99), 0.2 + percentile(errors.by_gyroscope_px, 0.99));
  }
}

TEST(ResidualFlow, MendsABiasThatNobodyTold) {
  const Simulator simulator = simulator_of(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [6, 8, 4], frequency: 1.3, phase: 20}]}}
)");
  const Errors errors = errors_of(simulator, rotation_of(simulator, {0.05, -0.05, 0.05}));
  EXPECT_GT(percentile(errors.by_gyroscope_px, 0.5), 0.4);
  EXPECT_LT(percentile(errors.by_both_px, 0.5), 0.25);
}

class StillCamera : public ::testing::Test {
 protected:
  static constexpr TimeNs kPeriodNs = 50'000'000;

  static CameraCalibration calibration() {
    CameraCalibration calibration;
    calibration.width_px = 640;
    calibration.height_px = 480;
    calibration.fx_px = calibration.fy_px = 400;
    calibration.cx_px = 319.5;
    calibration.cy_px = 239.5;
    return calibration;
  }

  StillCamera() {
    std::vector<GyroSample> samples;
    for (TimeNs t_ns = -kPeriodNs; t_ns < 100 * kPeriodNs; t_ns += 5'000'000) samples.push_back({t_ns, {0, 0, 0}});
    rotation_ = RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
    cv::extractChannel(sim::procedural_texture(900, 700, 3), texture_, 1);
  }

  ResidualField follow(TimeNs stamp_ns, const cv::Mat& image) {
    ShutterTiming timing;
    timing.exposure_ns = 10'000'000;
    return flow_.follow(image, camera_, rotation_, RowExposure(stamp_ns, 480, timing), grid_);
  }
  cv::Mat view(int x, int y) const { return texture_(cv::Rect(x, y, 640, 480)); }

  Camera camera_{calibration()};
  RotationTrack rotation_{{}, GyroOptions{}, Eigen::Matrix3d::Identity()};
  BlockGrid grid_{640, 480, kBlockPx};
  cv::Mat texture_;
  ResidualFlow flow_;
};

TEST_F(StillCamera, SeesAShiftAsAVelocity) {
  for (int i = 0; i < 4; ++i) {
    const ResidualField residuals = follow(i * kPeriodNs, view(100 - 6 * i, 80 + 4 * i));
    if (i < 2) continue;
    ASSERT_EQ(residuals.size(), static_cast<std::size_t>(grid_.size()));
    double sum_px = 0;
    for (const auto& residual : residuals) {
      ASSERT_TRUE(residual);
      const Eigen::Vector2d velocity_px_s = Eigen::Vector2d(6, -4) / to_seconds(kPeriodNs);
      const double error_px = to_seconds(kPeriodNs) * (residual->velocity_px_s - velocity_px_s).norm();
      EXPECT_LT(error_px, 0.3);
      EXPECT_LT(residual->stddev_px_s, 10);
      sum_px += error_px;
    }
    EXPECT_LT(sum_px / grid_.size(), 0.1);
  }
}

// Between a picture and itself nothing moves: what comes after is followed from when it was exposed.
TEST_F(StillCamera, KnowsAgainWhatItFoundForAPicture) {
  const auto exposure_of = [](TimeNs stamp_ns) {
    ShutterTiming timing;
    timing.exposure_ns = 10'000'000;
    return RowExposure(stamp_ns, 480, timing);
  };
  EXPECT_FALSE(flow_.found_for(exposure_of(0), grid_));
  std::optional<ResidualField> found;
  for (int i = 0; i < 4; ++i) {
    const ResidualField residuals = follow(i * kPeriodNs, view(100 - 6 * i, 80 + 4 * i));
    found = flow_.found_for(exposure_of(i * kPeriodNs), grid_);
    ASSERT_TRUE(found);
    ASSERT_EQ(found->size(), residuals.size());
    for (std::size_t b = 0; b < residuals.size(); ++b) {
      ASSERT_EQ((*found)[b].has_value(), residuals[b].has_value());
      if (residuals[b]) {
        EXPECT_EQ((*found)[b]->velocity_px_s, residuals[b]->velocity_px_s);
      }
    }
    EXPECT_FALSE(flow_.found_for(exposure_of(i * kPeriodNs + 1), grid_)) << "another picture";
  }
  EXPECT_TRUE(flow_.found_for(exposure_of(3 * kPeriodNs), BlockGrid(640, 480, kBlockPx / 2))->empty())
      << "other blocks";
  flow_.reset();
  EXPECT_FALSE(flow_.found_for(exposure_of(3 * kPeriodNs), grid_));
}

TEST_F(StillCamera, SeesNothingAtRest) {
  for (int i = 0; i < 3; ++i) {
    for (const auto& residual : follow(i * kPeriodNs, view(100, 80))) {
      EXPECT_TRUE(!residual || !is_certain(*residual, 10'000'000));
    }
  }
}

// An object with far more texture than a wall, half of which is bare.
TEST_F(StillCamera, GivesAnObjectsMotionToTheObjectAlone) {
  constexpr double kFaint = 1.0 / 16;
  constexpr int kTexturedCols = 320;
  cv::Mat wall;
  view(100, 80).convertTo(wall, CV_8U, kFaint, 100);
  wall.colRange(kTexturedCols, wall.cols).setTo(108);
  const cv::Point step_px(6, -4);
  int object_blocks = 0, certain_object_blocks = 0, wall_blocks = 0;
  for (int i = 0; i < 5; ++i) {
    const cv::Rect object(cv::Point(280, 160) + i * step_px, cv::Size(240, 190));
    cv::Mat image = wall.clone();
    texture_(cv::Rect(cv::Point(0, 0), object.size())).copyTo(image(object));
    const ResidualField residuals = follow(i * kPeriodNs, image);
    if (i < 2) continue;
    ASSERT_EQ(residuals.size(), static_cast<std::size_t>(grid_.size()));
    for (int b = 0; b < grid_.size(); ++b) {
      ASSERT_TRUE(residuals[b]);
      const cv::Rect block = grid_.rect(b);
      const cv::Rect reach(block.tl() - cv::Point(kBlockPx / 2, kBlockPx / 2),
                           block.size() + cv::Size(kBlockPx, kBlockPx));
      const bool is_certain_of_it = is_certain(*residuals[b], 50'000'000);
      if ((block & object) == block) {
        ++object_blocks;
        certain_object_blocks += is_certain_of_it ? 1 : 0;
        const Eigen::Vector2d moved_px = to_seconds(kPeriodNs) * residuals[b]->velocity_px_s;
        EXPECT_LT((moved_px - Eigen::Vector2d(step_px.x, step_px.y)).norm(), 0.5) << "block " << b;
      } else if ((reach & object).empty()) {
        ++wall_blocks;
        EXPECT_FALSE(is_certain_of_it) << "image " << i << ", block " << b << " at " << block;
      }
    }
  }
  EXPECT_GT(object_blocks, 10);
  EXPECT_GE(certain_object_blocks, 0.75 * object_blocks) << "where it has little texture it may be left";
  EXPECT_GT(wall_blocks, 100);
}

TEST_F(StillCamera, KnowsNothingAcrossACutOrALongBreakOrWithoutTexture) {
  follow(0, view(100, 80));
  cv::Mat other;
  cv::flip(view(150, 120), other, -1);
  std::size_t certain = 0;
  for (const auto& residual : follow(kPeriodNs, other)) certain += residual && is_certain(*residual, 10'000'000);
  EXPECT_LE(certain, static_cast<std::size_t>(grid_.size()) / 20);
  EXPECT_TRUE(follow(20 * kPeriodNs, view(100, 80)).empty()) << "a second later";
  EXPECT_TRUE(follow(19 * kPeriodNs, view(100, 80)).empty()) << "back in time";
  const cv::Mat wall(480, 640, CV_8UC1, cv::Scalar(90));
  for (int i = 20; i < 23; ++i) {
    for (const auto& residual : follow(i * kPeriodNs, wall)) EXPECT_FALSE(residual && i > 20);
  }
}

}  // namespace
}  // namespace gyro_deblur::residual_flow_test
