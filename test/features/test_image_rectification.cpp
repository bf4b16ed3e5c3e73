#include "features/image_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <opencv2/imgproc.hpp>

#include "analytic_motion.hpp"
#include "euroc_camera.hpp"
#include "features/point_motion.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::image_rectification_test {
namespace {

using sim::Simulator;
using test::AnalyticMotion;

constexpr TimeNs kMs = 1'000'000;
constexpr int kWidth = 752, kHeight = 480;

RowExposure exposure_of(TimeNs readout_ns, TimeNs exposure_ns = 10 * kMs) {
  ShutterTiming timing;
  timing.exposure_ns = exposure_ns;
  timing.readout_ns = readout_ns;
  return RowExposure(300 * kMs, kHeight, timing);
}

FrameBlur plain_field(int block_px = 64) {
  BlurFieldOptions options;
  options.block_size_px = block_px;
  return uniform_blur_field(kWidth, kHeight, 0, 10, options);
}

/// Velocities and offsets as a scene has them: a plane, and scatter.
FrameBlur busy_field(double scatter_px_s, int block_px = 64) {
  FrameBlur field = plain_field(block_px);
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> u(-1, 1);
  const BlockStatus statuses[] = {BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::REJECTED,
                                  BlockStatus::TOO_CURVED};
  for (int i = 0; i < field.grid.size(); ++i) {
    BlockBlur& block = field.blocks[i];
    const Eigen::Vector2d at_px = field.grid.center(i);
    block.status = statuses[i % 4];
    block.chord_middle_px = Eigen::Vector2f(0.2F + 0.2F * static_cast<float>(u(rng)), 0);
    block.mean_place_px = Eigen::Vector2f(0.1F, 0.1F * static_cast<float>(u(rng)));
    if (i % 5 == 0) continue;  // none here
    const double x = at_px.x() / kWidth, y = at_px.y() / kHeight;
    block.residual =
        ResidualVelocity{{60 * x - 20 * y + scatter_px_s * u(rng), 40 * y - 30 * x + scatter_px_s * u(rng)}, 1};
  }
  return field;
}

std::vector<Eigen::Vector2d> everywhere(int count) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> x(0, kWidth - 1), y(0, kHeight - 1);
  std::vector<Eigen::Vector2d> points;
  for (int i = 0; i < count; ++i) points.emplace_back(x(rng), y(rng));
  return points;
}

bool inside(const Eigen::Vector2d& p) {
  return p.x() >= 0 && p.y() >= 0 && p.x() <= kWidth - 1 && p.y() <= kHeight - 1;
}

/// Inside, less squares in the corners.
bool inside_but_corners(const Eigen::Vector2d& p, double corner_px) {
  return inside(p) &&
         (std::min(p.x(), kWidth - 1 - p.x()) >= corner_px || std::min(p.y(), kHeight - 1 - p.y()) >= corner_px);
}

double percentile(std::vector<double> values, double part) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// How far from where the image shows a point the map looks for it [px], by the exact rule for points.
std::vector<double> disagreement(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                                 const RowExposure& exposure, TimeNs reference_ns, double corner_px = 0) {
  const GlobalShutterMap map = global_shutter_map(field, camera, motion, exposure, reference_ns);
  const std::vector<Eigen::Vector2d> shown = everywhere(20000);
  const auto points = rectify_points(shown, field, camera, motion, exposure, reference_ns);
  std::vector<double> distance;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    if (!points[i].rectified || !inside_but_corners(points[i].rectified_px, corner_px)) continue;
    distance.push_back((map.at(points[i].rectified_px) - shown[i]).norm());
  }
  return distance;
}

class GlobalShutterAgrees : public testing::TestWithParam<std::tuple<RectifyTo, int>> {};

TEST_P(GlobalShutterAgrees, WithRectifiedPoints) {
  const auto& [rectify_to, readout_ms] = GetParam();
  const RowExposure exposure = exposure_of(readout_ms * kMs);
  const TimeNs reference_ns = exposure.reference_time(rectify_to);
  const Camera camera(test::euroc_camera());
  // Rotation of 2 to 3 rad/s alone: nothing but the distance of the nodes is left.
  const auto rotated = disagreement(plain_field(), camera, AnalyticMotion::handshake(), exposure, reference_ns);
  EXPECT_GT(rotated.size(), 15000u);
  EXPECT_LT(percentile(rotated, 1), 0.02);
  const auto moved = disagreement(busy_field(5), camera, AnalyticMotion::handshake(), exposure, reference_ns);
  EXPECT_GT(moved.size(), 10000u);
  EXPECT_LT(percentile(moved, 0.9), 0.02);
  EXPECT_LT(percentile(moved, 1), 0.1);
  // Neighbours that differ as an object and what is behind it.
  const auto torn = disagreement(busy_field(150), camera, AnalyticMotion::handshake(), exposure, reference_ns);
  EXPECT_LT(percentile(torn, 0.5), 0.1);
}

INSTANTIATE_TEST_SUITE_P(All, GlobalShutterAgrees,
                         testing::Combine(testing::Values(RectifyTo::FIRST_ROW, RectifyTo::MIDDLE_ROW,
                                                          RectifyTo::LAST_ROW, RectifyTo::STAMP),
                                          testing::Values(20, -20)));

TEST(GlobalShutterMap, IsExactUpToFiveRadiansPerSecond) {
  const RowExposure exposure = exposure_of(20 * kMs);
  for (const Eigen::Vector3d& rate_rad_s :
       {Eigen::Vector3d(0, 5, 0), Eigen::Vector3d(5, 0, 0), Eigen::Vector3d(0, 0, 5)}) {
    for (const int block_px : {32, 64, 100}) {
      const auto distance_px = [&](double corner_px) {
        return percentile(
            disagreement(plain_field(block_px), Camera(test::euroc_camera()), AnalyticMotion::constant_rate(rate_rad_s),
                         exposure, exposure.reference_time(RectifyTo::MIDDLE_ROW), corner_px),
            1);
      };
      EXPECT_LT(distance_px(96), 0.02) << rate_rad_s.transpose() << ", blocks of " << block_px << " px";
      EXPECT_LT(distance_px(0), 0.25) << "in the corners, where the lens distorts most";
    }
  }
}

TEST(GlobalShutterMap, RowsThatTheMotionDoesNotCoverMoveWithTheNearestThatItDoes) {
  const RowExposure exposure = exposure_of(20 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const Camera camera(test::euroc_camera());
  AnalyticMotion motion = AnalyticMotion::handshake();
  const GlobalShutterMap whole = global_shutter_map(plain_field(), camera, motion, exposure, reference_ns);
  motion.set_range({exposure.middle(100), exposure.end(kHeight - 1)});
  const GlobalShutterMap part = global_shutter_map(plain_field(), camera, motion, exposure, reference_ns);
  ASSERT_FALSE(part.empty());
  double largest_step_px = 0, largest_covered_px = 0;
  for (int y = 1; y < kHeight; ++y) {
    const Eigen::Vector2d here = part.at({300, y}), above = part.at({300, y - 1.0});
    largest_step_px = std::max(largest_step_px, (here - above - Eigen::Vector2d(0, 1)).norm());
    if (y > 150) largest_covered_px = std::max(largest_covered_px, (here - whole.at({300, y})).norm());
  }
  EXPECT_LT(largest_step_px, 0.2);      // 2 rad/s are 0.04 px from row to row: nothing is torn
  EXPECT_LT(largest_covered_px, 0.02);  // and what is covered is as ever
  EXPECT_GT((part.at({300, 20}) - whole.at({300, 20})).norm(), 0.5);
  motion.set_range({exposure.end(kHeight - 1), exposure.end(kHeight - 1) + 2 * kMs});
  EXPECT_TRUE(global_shutter_map(plain_field(), camera, motion, exposure, reference_ns).empty());
}

TEST(GlobalShutterMap, WhatIsBeyondTheLensModelMovesWithWhatIsWithin) {
  CameraCalibration c = test::euroc_camera();
  c.fx_px = c.fy_px = 700;
  c.coefficients = {-0.4, 0, 0, 0};  // reaches 426 px: the corners are beyond
  const Camera camera(c);
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const RowExposure exposure = exposure_of(20 * kMs);
  const GlobalShutterMap map = global_shutter_map(plain_field(), camera, motion, exposure, exposure.middle(240));
  ASSERT_FALSE(camera.ray({0, 0}).allFinite());
  for (const Eigen::Vector2d& corner : {Eigen::Vector2d(0, 0), Eigen::Vector2d(751, 0), Eigen::Vector2d(0, 479)}) {
    const Eigen::Vector2d move = map.at(corner) - corner;
    EXPECT_TRUE(move.allFinite());
    EXPECT_LT(move.norm(), 40);
  }
}

TEST(ToGlobalShutter, TakesPixelsFromWhereTheMapSays) {
  const RowExposure exposure = exposure_of(20 * kMs);
  for (const int block_px : {64, 100}) {
    const GlobalShutterMap map =
        global_shutter_map(busy_field(50, block_px), Camera(test::euroc_camera()), AnalyticMotion::handshake(),
                           exposure, exposure.reference_time(RectifyTo::MIDDLE_ROW));
    // Ramps, which bilinear sampling does not change: pixels say where they come from, to a 64th of a pixel.
    cv::Mat x(kHeight, kWidth, CV_16UC1), y(kHeight, kWidth, CV_16UC1);
    for (int row = 0; row < kHeight; ++row) {
      for (int col = 0; col < kWidth; ++col) {
        x.at<std::uint16_t>(row, col) = static_cast<std::uint16_t>(64 * col);
        y.at<std::uint16_t>(row, col) = static_cast<std::uint16_t>(64 * row);
      }
    }
    const cv::Mat moved_x = to_global_shutter(x, map), moved_y = to_global_shutter(y, map);
    double largest_px = 0;
    for (int row = 0; row < kHeight; ++row) {
      for (int col = 0; col < kWidth; ++col) {
        const Eigen::Vector2d from = map.at({col, row});
        if (!inside(from)) continue;
        const Eigen::Vector2d got(moved_x.at<std::uint16_t>(row, col) / 64.0,
                                  moved_y.at<std::uint16_t>(row, col) / 64.0);
        largest_px = std::max(largest_px, (got - from).cwiseAbs().maxCoeff());
      }
    }
    // cv::remap has 32nds of a pixel, and the result is rounded.
    EXPECT_LT(largest_px, 1.0 / 64 + 1.0 / 128 + 0.002);
  }
}

TEST(ToGlobalShutter, ChannelsAndThreadsMakeNoDifference) {
  const RowExposure exposure = exposure_of(20 * kMs);
  const GlobalShutterMap map =
      global_shutter_map(plain_field(), Camera(test::euroc_camera()), AnalyticMotion::handshake(), exposure,
                         exposure.reference_time(RectifyTo::MIDDLE_ROW));
  for (const int depth : {CV_8U, CV_16U}) {
    cv::Mat color(kHeight, kWidth, CV_MAKETYPE(depth, 4));
    cv::RNG rng(4);
    rng.fill(color, cv::RNG::UNIFORM, 0, depth == CV_8U ? 256 : 65536);
    const cv::Mat moved = to_global_shutter(color, map, 1);
    ASSERT_EQ(moved.type(), color.type());
    EXPECT_EQ(cv::norm(moved, to_global_shutter(color, map, 2), cv::NORM_INF), 0);
    for (int channel = 0; channel < 4; ++channel) {
      cv::Mat plane, moved_plane;
      cv::extractChannel(color, plane, channel);
      cv::extractChannel(moved, moved_plane, channel);
      EXPECT_LE(cv::norm(moved_plane, to_global_shutter(plane, map), cv::NORM_INF), 1);
    }
  }
  EXPECT_THROW(to_global_shutter(cv::Mat(10, 10, CV_8UC1), map), std::invalid_argument);
  EXPECT_THROW(to_global_shutter(cv::Mat(kHeight, kWidth, CV_32FC1), map), std::invalid_argument);
  EXPECT_THROW(to_global_shutter(cv::Mat(kHeight, kWidth, CV_8UC1), {}), std::invalid_argument);
}

TEST(ToGlobalShutter, WhatLiesOutsideTheImageIsBlack) {
  const RowExposure exposure = exposure_of(20 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const Camera camera(test::euroc_camera());
  // 2 rad/s about y: 9 px at the first and the last row, one to each side.
  const GlobalShutterMap map =
      global_shutter_map(plain_field(), camera, AnalyticMotion::constant_rate({0, 2, 0}), exposure, reference_ns);
  cv::Mat image(kHeight, kWidth, CV_8UC1, cv::Scalar(100));
  image.col(0).setTo(200);
  image.col(kWidth - 1).setTo(200);
  const cv::Mat moved = to_global_shutter(image, map);
  int outside = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (const int x : {0, 2, 4, kWidth - 5, kWidth - 3, kWidth - 1}) {
      const Eigen::Vector2d from = map.at({x, y});
      if (from.x() > -1.1 && from.x() < kWidth + 0.1) continue;
      ++outside;
      EXPECT_EQ(moved.at<uchar>(y, x), 0);
    }
  }
  EXPECT_GT(outside, 500);
}

TEST(ToGlobalShutter, NothingMovesWhereAllRowsAreExposedAtTheReference) {
  const RowExposure global = exposure_of(0), rolling = exposure_of(20 * kMs);
  for (const RectifyTo to : {RectifyTo::FIRST_ROW, RectifyTo::MIDDLE_ROW, RectifyTo::LAST_ROW}) {
    EXPECT_TRUE(is_global_shutter(global, global.reference_time(to)));
    EXPECT_FALSE(is_global_shutter(rolling, rolling.reference_time(to)));
  }
  EXPECT_FALSE(is_global_shutter(global, global.reference_time(RectifyTo::STAMP)));  // half an exposure earlier
}

Simulator simulator_of(const std::string& motion) {
  return Simulator(sim::parse_scene(YAML::Load(R"(
frames: 3
seed: 5
camera: {size: [752, 480], intrinsics: [460, 460, 376, 240], fps: 20, exposure_time: 0.02, readout_time: 0.02}
imu: {rate: 400}
planes:
  - {size: [9, 7], position: [0, 0, 3], texture_size: [2400, 1800], texture_seed: 4}
  - {size: [1.2, 1.4], position: [0.4, 0.1, 1.5], texture_size: [800, 900], texture_seed: 5}
)" + motion),
                                    "", "global shutter"));
}

RotationTrack rotation_of(const Simulator& simulator) {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu()) samples.push_back({s.t_ns, s.rate_rad_s});
  return RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
}

/// How far from where the frame shows them the map looks for scene points that are inside it at the reference [px].
std::vector<double> errors_of(const Simulator& simulator, int frame, const GlobalShutterMap& map, TimeNs reference_ns) {
  std::vector<double> errors;
  for (const Eigen::Vector2d& shown : everywhere(4000)) {
    const Eigen::Vector2d at_reference = simulator.truth_rectified(frame, shown, reference_ns);
    if (at_reference.allFinite() && inside(at_reference)) errors.push_back((map.at(at_reference) - shown).norm());
  }
  return errors;
}

TEST(GlobalShutterOfSimulation, ARotatingCameraIsRight) {
  Simulator simulator = simulator_of("motion: {type: constant_rate, rate: [40, 90, 60]}\n");
  const RowExposure exposure = simulator.exposure(1);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const GlobalShutterMap map =
      global_shutter_map(plain_field(), simulator.camera(), rotation_of(simulator), exposure, reference_ns);
  const std::vector<double> errors = errors_of(simulator, 1, map, reference_ns);
  EXPECT_GT(errors.size(), 3000u);
  EXPECT_LT(percentile(errors, 1), 0.03);
  // The picture is that of a global shutter, less the loss of resampling; unmoved it is another.
  const cv::Mat truth = simulator.global_shutter(reference_ns), rolling = simulator.sharp(1);
  const cv::Mat moved = to_global_shutter(rolling, map);
  const cv::Rect middle(40, 40, kWidth - 80, kHeight - 80);
  const auto rms = [&](const cv::Mat& image) {
    return cv::norm(image(middle), truth(middle), cv::NORM_L2) / std::sqrt(middle.area());
  };
  EXPECT_GT(rms(rolling), 3 * rms(moved));
}

TEST(GlobalShutterOfSimulation, ResidualVelocitiesTakeWhatTranslationMoves) {
  Simulator simulator = simulator_of(R"(
motion: {type: curve, rotation: {sines: [{amplitude: [4, 6, 3], frequency: 1.3, phase: 20}]},
  position: {sines: [{amplitude: [0.25, 0.15, 0.2], frequency: 0.8, phase: 70}]}}
)");
  const RotationTrack rotation = rotation_of(simulator);
  const RowExposure exposure = simulator.exposure(1);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  FrameBlur field = plain_field();
  const auto errors = [&](const FrameBlur& with) {
    return errors_of(simulator, 1, global_shutter_map(with, simulator.camera(), rotation, exposure, reference_ns),
                     reference_ns);
  };
  const std::vector<double> by_rotation = errors(field);
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d center_px = field.grid.center(i);
    const TimeNs start_ns = exposure.start(center_px.y()), end_ns = exposure.end(center_px.y());
    const Eigen::Vector3d ray = simulator.camera().ray(center_px);
    const auto place = [&](TimeNs t_ns) -> Eigen::Vector2d {
      return simulator.camera().project(rotation.rotation(exposure.middle(center_px.y()), t_ns) * ray);
    };
    const Eigen::Vector2d missing_px = simulator.truth_displacement(1, center_px) - (place(end_ns) - place(start_ns));
    field.blocks[i].residual = ResidualVelocity{missing_px / to_seconds(end_ns - start_ns), 1};
  }
  const std::vector<double> by_both = errors(field);
  EXPECT_GT(percentile(by_rotation, 0.5), 0.5);
  EXPECT_LT(percentile(by_both, 0.5), 0.05);
  EXPECT_LT(percentile(by_both, 0.9), 0.6);
}

}  // namespace
}  // namespace gyro_deblur::image_rectification_test
