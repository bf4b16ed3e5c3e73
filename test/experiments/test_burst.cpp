// The real-world protocol's pieces against motions and homographies that are known.
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "burst.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr int kWidth = 640, kHeight = 480;

// A folder that goes away with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    path_ = std::filesystem::temp_directory_path() /
            (std::string("gyro_deblur_") + ::testing::UnitTest::GetInstance()->current_test_info()->name() + "_" +
             std::to_string(getpid()));
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  std::string string() const { return path_.string(); }
  std::string file(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

// 1, 30 and 1 ms of exposure; the middle frame comes late.
Burst make_burst(double readout_s) {
  Burst burst;
  burst.calibration.width_px = kWidth;
  burst.calibration.height_px = kHeight;
  burst.calibration.fx_px = burst.calibration.fy_px = 500;
  burst.calibration.cx_px = 319.5;
  burst.calibration.cy_px = 239.5;
  burst.config.shutter.readout_ns = to_ns(readout_s);
  burst.config.R_cam_imu = Eigen::Matrix3d::Identity();
  const double stamps_s[] = {100.0, 100.036, 100.066}, exposures_s[] = {0.001, 0.030, 0.001};
  for (int i = 0; i < 3; ++i) {
    burst.frames[i].stamp_ns = to_ns(stamps_s[i]);
    burst.frames[i].exposure_ns = to_ns(exposures_s[i]);
    burst.frames[i].image = cv::Mat(kHeight, kWidth, CV_8UC1, cv::Scalar(10 * i));
    cv::randu(burst.frames[i].image, 0, 255);
  }
  burst.gyro = {{to_ns(99.9), {0.1, -0.2, 1.0 / 3}}, {to_ns(100.2), {1e-9, 2, -3}}};
  return burst;
}

// Where frame i sees a point that is at `start` + velocity (t - t0), t0 being the first frame's stamp.
Eigen::Vector2d seen(const Burst& burst, BurstIndex i, const Eigen::Vector2d& start, const Eigen::Vector2d& velocity) {
  Eigen::Vector2d pixel = start;
  for (int k = 0; k < 100; ++k) {
    pixel = start + velocity * to_seconds(burst.exposure(i).middle(pixel.y()) - burst.frames[FIRST].stamp_ns);
  }
  return pixel;
}

class Interpolation : public ::testing::TestWithParam<double> {};

TEST_P(Interpolation, IsExactForStraightUniformMotion) {
  const Burst burst = make_burst(GetParam());
  for (const Eigen::Vector2d& velocity :
       {Eigen::Vector2d(0, 0), Eigen::Vector2d(1500, 0), Eigen::Vector2d(-300, 2000), Eigen::Vector2d(900, -1800)}) {
    const Eigen::Vector2d start(250, 300);
    const Eigen::Vector2d middle =
        interpolate_to_middle(seen(burst, FIRST, start, velocity), seen(burst, LAST, start, velocity), burst);
    EXPECT_LT((middle - seen(burst, MIDDLE, start, velocity)).norm(), 1e-4) << velocity.transpose();
  }
}

INSTANTIATE_TEST_SUITE_P(Readouts, Interpolation, ::testing::Values(0.0, 0.0245, -0.03));

TEST(Interpolation, WeighsByTimeNotByIndex) {
  const Burst burst = make_burst(0);
  // Mid-exposures at 0.5, 51 and 66.5 ms.
  const Eigen::Vector2d middle = interpolate_to_middle({0, 10}, {66, 10}, burst);
  EXPECT_NEAR(middle.x(), 50.5, 1e-6);
  EXPECT_NEAR(middle.y(), 10, 1e-9);
}

TEST(BurstFolder, ComesBackAsItWasWritten) {
  const TemporaryFolder folder;
  Burst burst = make_burst(0.0245);
  burst.calibration.model = "plumb_bob";
  burst.calibration.coefficients = {0.1, -0.2, 0.001, 1.0 / 3000};
  burst.config.gyro.time_offset_ns = -17'552'000;
  burst.config.gyro.bias_rad_s = {0.01, 0.02, -0.03};
  burst.config.shutter.stamp_row = StampRow::MIDDLE;
  burst.config.shutter.stamp_phase = StampPhase::END;
  burst.config.R_cam_imu = (Eigen::Matrix3d() << 0, -1, 0, -1, 0, 0, 0, 0, -1).finished();
  save_burst(folder.string(), burst);
  const Burst read = load_burst(folder.string());
  EXPECT_TRUE(read.calibration == burst.calibration);
  EXPECT_EQ(read.config.shutter.readout_ns, burst.config.shutter.readout_ns);
  EXPECT_EQ(read.config.shutter.stamp_row, StampRow::MIDDLE);
  EXPECT_EQ(read.config.shutter.stamp_phase, StampPhase::END);
  EXPECT_EQ(read.config.gyro.time_offset_ns, burst.config.gyro.time_offset_ns);
  EXPECT_EQ(read.config.gyro.bias_rad_s, burst.config.gyro.bias_rad_s);
  EXPECT_EQ(*read.config.R_cam_imu, *burst.config.R_cam_imu);
  ASSERT_EQ(read.gyro.size(), burst.gyro.size());
  for (std::size_t i = 0; i < burst.gyro.size(); ++i) {
    EXPECT_EQ(read.gyro[i].t_ns, burst.gyro[i].t_ns);
    EXPECT_EQ(read.gyro[i].rate_rad_s, burst.gyro[i].rate_rad_s);
  }
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(read.frames[i].stamp_ns, burst.frames[i].stamp_ns);
    EXPECT_EQ(read.frames[i].exposure_ns, burst.frames[i].exposure_ns);
    EXPECT_EQ(cv::norm(read.frames[i].image, burst.frames[i].image, cv::NORM_INF), 0);
  }
}

// Message of the OptionError that load_burst throws after `edit` changed the description.
template <typename Edit>
std::string error_after(const Edit& edit) {
  const TemporaryFolder folder;
  save_burst(folder.string(), make_burst(0.02));
  YAML::Node node = YAML::LoadFile(folder.file("burst.yaml"));
  edit(node);
  std::ofstream(folder.file("burst.yaml")) << node;
  try {
    load_burst(folder.string());
  } catch (const OptionError& error) {
    return error.what();
  }
  return "";
}

TEST(BurstFolder, RefusesWhatIsWrongByName) {
  EXPECT_NE(error_after([](YAML::Node& n) { n.remove("stamps"); }).find("stamps is missing"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["config"].remove("R_cam_imu"); }).find("R_cam_imu"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["config"]["exposure"] = 1; }).find("config.exposure"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["size"][0] = 320; }).find("320x480"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["exposure_times"][1] = 30; }).find("exposure_times"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["stamps"][1] = n["stamps"][0]; }).find("stamps do not increase"),
            std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["images"][2] = "absent.png"; }).find("absent.png"), std::string::npos);
  EXPECT_NE(error_after([](YAML::Node& n) { n["gyro"][1] = "x"; }).find("gyro[1]"), std::string::npos);
}

TEST(PairHomography, IsFoundAmongWrongMatches) {
  const Homography H(1.05, -0.13, -40, 0.16, 1.05, -60, 2e-5, 2.2e-5, 1);
  constexpr int kPoints = 200;
  cv::RNG rng(7);
  BurstPoints points1, points2;
  points1.descriptors.create(kPoints, 128, CV_32F);
  rng.fill(points1.descriptors, cv::RNG::UNIFORM, 0, 255);
  points2.descriptors = points1.descriptors.clone();
  const auto random_point = [&rng] {
    const double x = rng.uniform(0.0, 640.0), y = rng.uniform(0.0, 480.0);
    return cv::Point2d(x, y);
  };
  for (int i = 0; i < kPoints; ++i) {
    const cv::Point2d p = random_point();
    points1.middle_px.emplace_back(p);
    const bool wrong = i % 3 == 0;
    points2.middle_px.emplace_back(wrong ? random_point() : project(H, p));
  }
  const PairHomography found = estimate_pair_homography(points1, points2, {});
  EXPECT_EQ(found.matches, kPoints);
  EXPECT_GE(found.inliers, kPoints * 2 / 3);
  EXPECT_LT(found.residual_px, 0.5);
  for (const cv::Point2d& corner : {cv::Point2d(0, 0), cv::Point2d(639, 0), cv::Point2d(0, 479), cv::Point2d(639, 479)})
    EXPECT_LT(cv::norm(project(found.H_2_1, corner) - project(H, corner)), 0.2);
}

TEST(PairHomography, SaysThatThereIsNone) {
  BurstPoints none;
  EXPECT_THROW(estimate_pair_homography(none, none, {}), std::runtime_error);
}

// A camera that rotates evenly in front of a wall, seen from another place for `view` 1.
sim::Simulator make_simulator(int view) {
  const std::string motion = view == 0 ? "{type: constant_rate, rate: [10, 25, 5], orientation: [-2, -4, 0]}"
                                       : "{type: constant_rate, rate: [-15, 20, 0], orientation: [2, 0, 6], "
                                         "position: {offset: [0.2, -0.1, 0.1]}}";
  return sim::Simulator(sim::parse_scene(
      YAML::Load(
          "{frames: 3, lead_time: 0.1, camera: {size: [640, 480], intrinsics: [500, 500, 319.5, 239.5], "
          "fps: 30, exposure_time: [0.001, 0.03, 0.001], readout_time: 0.025, noise: 2}, "
          "planes: [{size: [6, 5], position: [0, 0, 2], texture_size: [2400, 2000], texture_seed: 4}], motion: " +
          motion + "}"),
      "", "test.yaml"));
}

TEST(Simulator, ScenePointsComeBackToTheirPixels) {
  const sim::Simulator simulator = make_simulator(0);
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(10, 20), Eigen::Vector2d(600, 470), Eigen::Vector2d(320, 100)}) {
    const auto point = simulator.scene_point(MIDDLE, pixel);
    ASSERT_TRUE(point.has_value());
    EXPECT_NEAR(point->z(), 2, 1e-9);
    EXPECT_LT((simulator.pixel_of(MIDDLE, *point) - pixel).norm(), 1e-4);
  }
  EXPECT_FALSE(simulator.pixel_of(MIDDLE, {0, 0, -1}).allFinite());
}

TEST(Protocol, AgreesWithTheSimulatorWhereMotionIsUniform) {
  sim::Simulator simulators[] = {make_simulator(0), make_simulator(1)};
  BurstPoints points[2];
  for (int v = 0; v < 2; ++v) {
    Burst burst = make_burst(0);
    burst.config.shutter = simulators[v].scene().timing(MIDDLE);
    for (const BurstIndex i : {FIRST, MIDDLE, LAST}) {
      const sim::Frame frame = simulators[v].frame(i);
      burst.frames[i] = {frame.image, frame.stamp_ns, frame.timing.exposure_ns};
    }
    points[v] = interpolated_points(burst, {});
  }
  const PairHomography found = estimate_pair_homography(points[0], points[1], {});
  double sum = 0, count = 0;
  for (double x = 60; x < kWidth; x += 65) {
    for (double y = 60; y < kHeight; y += 60) {
      const auto point = simulators[0].scene_point(MIDDLE, {x, y});
      ASSERT_TRUE(point.has_value());
      const Eigen::Vector2d truth = simulators[1].pixel_of(MIDDLE, *point);
      const cv::Point2d p = project(found.H_2_1, {x, y});
      sum += (Eigen::Vector2d(p.x, p.y) - truth).norm();
      ++count;
    }
  }
  // A rolling shutter leaves no exact homography.
  EXPECT_LT(sum / count, 0.7);
}

}  // namespace
}  // namespace gyro_deblur::experiments
