#include "gyro_deblur/blur_field.hpp"

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "analytic_motion.hpp"
#include "axial_difference.hpp"
#include "base/median.hpp"
#include "blur/path_2d.hpp"
#include "euroc_camera.hpp"

namespace gyro_deblur::blur_field_test {
namespace {

using test::AnalyticMotion;
using test::axial_difference;

constexpr TimeNs kMs = 1'000'000;
constexpr double kDeg = M_PI / 180;

CameraCalibration pinhole(int width_px = 640, int height_px = 480, double f_px = 500) {
  CameraCalibration c;
  c.width_px = width_px;
  c.height_px = height_px;
  c.fx_px = c.fy_px = f_px;
  c.cx_px = 0.5 * (width_px - 1);
  c.cy_px = 0.5 * (height_px - 1);
  return c;
}

ShutterTiming timing(TimeNs exposure_ns, TimeNs readout_ns) {
  ShutterTiming t;
  t.exposure_ns = exposure_ns;
  t.readout_ns = readout_ns;
  return t;
}

TEST(BlockGrid, LastColumnAndRowAreWhatIsLeft) {
  const BlockGrid grid(130, 70, 64);
  EXPECT_EQ(grid.cols(), 3);
  EXPECT_EQ(grid.rows(), 2);
  EXPECT_EQ(grid.size(), 6);
  EXPECT_EQ(grid.rect(0), cv::Rect(0, 0, 64, 64));
  EXPECT_EQ(grid.rect(2), cv::Rect(128, 0, 2, 64));
  EXPECT_EQ(grid.rect(5), cv::Rect(128, 64, 2, 6));
  EXPECT_EQ(grid.center(0), Eigen::Vector2d(31.5, 31.5));
  EXPECT_EQ(grid.center(5), Eigen::Vector2d(128.5, 66.5));
  int area = 0;
  for (int i = 0; i < grid.size(); ++i) area += grid.rect(i).area();
  EXPECT_EQ(area, 130 * 70);
  EXPECT_EQ(BlockGrid(128, 64, 64).size(), 2);
  EXPECT_EQ(BlockGrid(1, 1, 64).rect(0), cv::Rect(0, 0, 1, 1));
  EXPECT_THROW(BlockGrid(0, 1, 8), std::invalid_argument);
  EXPECT_THROW(BlockGrid(1, 1, 0), std::invalid_argument);
}

TEST(BlockGrid, FindsTheBlockOfAPixel) {
  const BlockGrid grid(130, 70, 64);
  EXPECT_EQ(grid.index_at(0, 0), 0);
  EXPECT_EQ(grid.index_at(63.49, 63.49), 0);
  EXPECT_EQ(grid.index_at(63.5, 0), 1);
  EXPECT_EQ(grid.index_at(0, 63.5), 3);
  EXPECT_EQ(grid.index_at(129.4, 69.4), 5);
  EXPECT_EQ(grid.index_at(-1e300, -5), 0);
  EXPECT_EQ(grid.index_at(1e300, 1e300), 5);
  for (int i = 0; i < grid.size(); ++i) EXPECT_EQ(grid.index_at(grid.center(i).x(), grid.center(i).y()), i);
}

TEST(AxialAngle, IsFoldedIntoHalfARevolution) {
  EXPECT_DOUBLE_EQ(axial_angle(1, 0), 0);
  EXPECT_DOUBLE_EQ(axial_angle(-1, 0), 0);
  EXPECT_DOUBLE_EQ(axial_angle(-1, -0.0), 0);
  EXPECT_DOUBLE_EQ(axial_angle(0, 1), M_PI / 2);
  EXPECT_DOUBLE_EQ(axial_angle(0, -1), M_PI / 2);
  EXPECT_DOUBLE_EQ(axial_angle(1, 1), M_PI / 4);
  EXPECT_DOUBLE_EQ(axial_angle(-1, 1), 3 * M_PI / 4);
  EXPECT_DOUBLE_EQ(axial_angle(0, 0), 0);
  for (const double dy : {-1e-20, -1e-15, -1e-9}) {
    EXPECT_GE(axial_angle(1, dy), 0);
    EXPECT_LT(axial_angle(1, dy), M_PI);
    EXPECT_LT(axial_difference(axial_angle(1, dy), 0), 1e-8);
  }
}

TEST(BlockGrid, ABlockAndItsNeighboursComeRowByRow) {
  const BlockGrid grid(250, 130, 64);  // 4 x 3 blocks
  const auto around = [](const BlockGrid& of, int index) {
    std::vector<int> blocks;
    of.for_each_around(index, [&](int block) { blocks.push_back(block); });
    return blocks;
  };
  EXPECT_EQ(around(grid, 5), (std::vector<int>{0, 1, 2, 4, 5, 6, 8, 9, 10}));
  EXPECT_EQ(around(grid, 0), (std::vector<int>{0, 1, 4, 5}));
  EXPECT_EQ(around(grid, 7), (std::vector<int>{2, 3, 6, 7, 10, 11}));
  EXPECT_EQ(around(BlockGrid(8, 8, 8), 0), std::vector<int>{0});
}

TEST(ClassifyBlur, DecidesByExtent) {
  const BlurFieldOptions options;  // 3 to 150 px
  EXPECT_EQ(classify_blur(0, 0, options).status, BlockStatus::SHARP);
  EXPECT_EQ(classify_blur(2.99, 0, options).status, BlockStatus::SHARP);
  EXPECT_EQ(classify_blur(0, 3, options).status, BlockStatus::DEBLURRED);
  EXPECT_EQ(classify_blur(90, -120, options).status, BlockStatus::DEBLURRED);
  EXPECT_EQ(classify_blur(90, -120.1, options).status, BlockStatus::TOO_LARGE);
  const BlockBlur blur = classify_blur(-3, 4, options);
  EXPECT_FLOAT_EQ(blur.extent_px, 5);
  EXPECT_NEAR(blur.angle_rad, M_PI - std::atan2(4, 3), 1e-6);
  // In float, an angle just below pi rounds to more than pi.
  EXPECT_EQ(classify_blur(5, -1e-8, options).angle_rad, 0);
}

std::array<Eigen::Vector2d, kPathInstants> path_of(const std::function<Eigen::Vector2d(double)>& place_at) {
  std::array<Eigen::Vector2d, kPathInstants> path_px;
  for (int k = 0; k < kPathInstants; ++k) path_px[k] = place_at(k / (kPathInstants - 1.0) - 0.5) - place_at(0);
  return path_px;
}

TEST(ClassifyPath, StraightAtUniformSpeedIsTheBox) {
  for (const Eigen::Vector2d& along : {Eigen::Vector2d(30, 0), {-12, 20}, {0, -7}, {1, 1}, {0, 0}, {200, 0}}) {
    const BlockBlur blur = classify_path(path_of([&](double t) { return t * along; }), {});
    const BlockBlur expected = classify_blur(along.x(), along.y(), {});
    EXPECT_EQ(blur.angle_rad, expected.angle_rad);
    EXPECT_FLOAT_EQ(blur.extent_px, expected.extent_px);
    EXPECT_EQ(blur.status, expected.status);
    EXPECT_FALSE(blur.nonuniform_path_px);
  }
}

// The second half of the exposure is run through at another speed: after the best shift, half of the difference between
// the halves' lengths lies on either side of the even run, half of that at a time.
TEST(ClassifyPath, AStepOfTheSpeedDepartsByAQuarterOfTheDifference) {
  for (const double degrees : {0.0, 30.0, 90.0, 150.0, 200.0, 300.0}) {
    const Eigen::Vector2d along(std::cos(degrees * kDeg), std::sin(degrees * kDeg));
    const auto stepped = [&](double difference_px) {
      return classify_path(path_of([&](double t) { return 2 * t * (t < 0 ? 10 : 10 + difference_px) * along; }), {});
    };
    // Of an extent of 20 px and the difference, a quarter of which is the limit at 1.115 px.
    EXPECT_FALSE(stepped(1.10).nonuniform_path_px);
    const BlockBlur blur = stepped(10);
    EXPECT_NEAR(blur.extent_px, 30, 1e-4);
    EXPECT_LT(axial_difference(blur.angle_rad, axial_angle(along.x(), along.y())), 1e-6);
    EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
    ASSERT_TRUE(blur.nonuniform_path_px);
    // Forwards or backwards along the axial angle.
    const double sign = along.dot(Eigen::Vector2d(std::cos(blur.angle_rad), std::sin(blur.angle_rad)));
    EXPECT_NEAR(std::abs(sign), 1, 1e-6);
    const double expected[] = {-10, -7.5, -5, -2.5, 0, 5, 10, 15, 20};
    for (int k = 0; k < kPathInstants; ++k) EXPECT_NEAR((*blur.nonuniform_path_px)[k], sign * expected[k], 1e-4) << k;
    EXPECT_TRUE(stepped(1.13).nonuniform_path_px);
  }
}

// A point that speeds up along a line and leaves it along a flat arc.
TEST(ClassifyPath, SaysWhereTheImageShowsThePoint) {
  const Eigen::Vector2d along(std::cos(0.4), std::sin(0.4)), across(-along.y(), along.x());
  const auto blur_of = [&](double gain_px, double arc_px) {
    return classify_path(path_of([&](double t) -> Eigen::Vector2d {
                           return (40 * t + 4 * gain_px * t * t) * along + 4 * arc_px * t * t * across;
                         }),
                         {}, true);
  };
  // The mean of 4 t^2 over nine instants, evenly in between, as against 1 / 3.
  constexpr double kMean = (1 / 2.0 + 2 * (9 + 4 + 1) / 16.0 + 1 / 2.0) / 8;
  BlockBlur even = blur_of(1.5, 0.9);
  ASSERT_EQ(even.status, BlockStatus::DEBLURRED);
  ASSERT_FALSE(even.nonuniform_path_px);
  constexpr double kMiddle = 1 - 7.5 / 40;  // how near it is to the middle of the line
  EXPECT_LT(
      (even.apparent_offset_px() - ((kMiddle + (1 - kMiddle) * kMean) * 1.5 * along + kMean * 0.9 * across)).norm(),
      1e-3);
  even.status = BlockStatus::SHARP;
  EXPECT_LT((even.apparent_offset_px() - kMean * (1.5 * along + 0.9 * across)).norm(), 1e-4);
  const BlockBlur nonuniform = blur_of(6, 0.9);
  ASSERT_EQ(nonuniform.status, BlockStatus::DEBLURRED);
  ASSERT_TRUE(nonuniform.nonuniform_path_px);
  // Its line is fitted to the places, so that it is a little off that direction.
  EXPECT_LT((nonuniform.apparent_offset_px() - kMean * 0.9 * across).norm(), 0.1);
  EXPECT_EQ(uniform_blur_field(64, 64, 1, 20, {}).blocks[0].apparent_offset_px(), Eigen::Vector2d::Zero());
}

TEST(ClassifyPath, ThereAndBackCoversTheLineOnce) {
  const BlockBlur blur = classify_path(path_of([](double t) { return Eigen::Vector2d(0, 80 * t * t); }), {});
  EXPECT_NEAR(blur.extent_px, 20, 1e-4);
  EXPECT_NEAR(blur.angle_rad, M_PI / 2, 1e-6);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  EXPECT_TRUE(blur.nonuniform_path_px);
}

TEST(ClassifyPath, NonuniformSpeedIsCurvedBeyondTheThreshold) {
  // The parabola leaves uniform speed by a quarter of its coefficient, half of that after the best shift.
  constexpr double kNonuniformPx = 8;
  const auto path_px = path_of([](double t) { return Eigen::Vector2d(20 * t + kNonuniformPx * t * t, 0); });
  BlurFieldOptions options;
  options.curved_path_threshold_px = 1.001 * (kNonuniformPx / 8 - even_path_px(20));
  BlockBlur blur = classify_path(path_px, options);
  EXPECT_TRUE(blur.nonuniform_path_px);
  EXPECT_FALSE(blur.curved_path_px);
  options.curved_path_threshold_px = 0.999 * (kNonuniformPx / 8 - even_path_px(20));
  blur = classify_path(path_px, options);
  EXPECT_TRUE(blur.nonuniform_path_px);
  EXPECT_TRUE(blur.curved_path_px);
  // Without a 2-D filter it has a 1-D one, at any speed along the path.
  blur = classify_path(path_px, options, true);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  EXPECT_FALSE(blur.curved_path_px);
  options.max_extent_px = 2 * kMax2dExtentPx;
  const auto long_path_px = path_of([](double t) { return Eigen::Vector2d(0, 4.6 * kMax2dExtentPx * t * t); });
  blur = classify_path(long_path_px, options);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  EXPECT_TRUE(blur.nonuniform_path_px);
  EXPECT_FALSE(blur.curved_path_px);
}

TEST(ClassifyPath, AnArcIsCurvedBeyondTheThreshold) {
  constexpr double kRadius = 60;
  const auto arc = [](double rotation_rad) {
    return path_of([=](double t) {
      return Eigen::Vector2d(kRadius * std::sin(rotation_rad * t), kRadius * (1 - std::cos(rotation_rad * t)));
    });
  };
  // An arc of a circle lies within half of its rise to either side of a line.
  const double rotation_rad = 0.9, deviation_px = 0.5 * kRadius * (1 - std::cos(0.5 * rotation_rad));
  const double allowed_px = kStraightPathShare * 2 * kRadius * std::sin(0.5 * rotation_rad);
  BlurFieldOptions options;
  options.curved_path_threshold_px = 1.001 * deviation_px - allowed_px;
  BlockBlur blur = classify_path(arc(rotation_rad), options);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  EXPECT_FALSE(blur.curved_path_px);
  EXPECT_NEAR(blur.extent_px, 2 * kRadius * std::sin(0.5 * rotation_rad), 1e-3);
  EXPECT_LT(axial_difference(blur.angle_rad, 0), 1e-6);
  options.curved_path_threshold_px = 0.999 * deviation_px - allowed_px;
  blur = classify_path(arc(rotation_rad), options);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  ASSERT_TRUE(blur.curved_path_px);
  for (int k = 0; k < kPathInstants; ++k) {
    EXPECT_LT(((*blur.curved_path_px)[k].cast<double>() - arc(rotation_rad)[k]).norm(), 1e-5) << k;
  }
  EXPECT_EQ(blur.apparent_offset_px(), Eigen::Vector2d::Zero()) << "the whole path is undone";
  EXPECT_NEAR(blur.extent_px, 2 * kRadius * std::sin(0.5 * rotation_rad), 1e-3);
  EXPECT_TRUE(classify_path(arc(2 * M_PI), {}).curved_path_px) << "a whole circle";
  // Where there is no time for the 2-D filter.
  blur = classify_path(arc(rotation_rad), options, true);
  EXPECT_EQ(blur.status, BlockStatus::TOO_CURVED);
  EXPECT_FALSE(blur.curved_path_px);
  // 2 px high: 1 px to either side of a line, of which 0.6 are allowed.
  const auto slight_arc = path_of([](double t) { return Eigen::Vector2d(30 * t, 8 * t * (1 - t)); });
  options.curved_path_threshold_px = 0.2;
  EXPECT_TRUE(classify_path(slight_arc, options).curved_path_px);
  blur = classify_path(slight_arc, options, true);
  EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  EXPECT_FALSE(blur.curved_path_px);
  // Longer than any tile.
  options.max_extent_px = 2 * kMax2dExtentPx;
  const auto long_arc = path_of([](double t) { return Eigen::Vector2d(1.01 * kMax2dExtentPx * t, 200 * t * t); });
  EXPECT_EQ(classify_path(long_arc, options).status, BlockStatus::TOO_CURVED);
  // What is too small or too large anyway stays that.
  options.curved_path_threshold_px = 0;
  options.min_extent_px = 5;
  EXPECT_EQ(classify_path(arc(0.06), options).status, BlockStatus::SHARP);
  options.max_extent_px = 10;
  EXPECT_EQ(classify_path(arc(rotation_rad), options).status, BlockStatus::TOO_LARGE);
}

TEST(BlurFieldEstimator, PanBlursAlongX) {
  const double rate = 2, exposure_s = 0.02, f = 500;
  const BlurFieldEstimator estimator(Camera(pinhole()), {});
  const RowExposure exposure(0, 480, timing(20 * kMs, 0));
  const FrameBlur field = estimator.estimate(AnalyticMotion::constant_rate({0, rate, 0}), exposure);
  ASSERT_EQ(field.blocks.size(), 80u);
  EXPECT_EQ(cv::Size(field.grid.width_px(), field.grid.height_px()), cv::Size(640, 480));
  EXPECT_EQ(field.grid.block_size_px(), estimator.grid().block_size_px());
  EXPECT_EQ(field.exposure_ns, 20 * kMs);
  EXPECT_EQ(field.readout_ns, 0);
  for (int i = 0; i < field.grid.size(); ++i) {
    const double a = std::atan((field.grid.center(i).x() - 319.5) / f), h = 0.5 * rate * exposure_s;
    const double dx = f * (std::tan(a + h) - std::tan(a - h));
    EXPECT_EQ(field.blocks[i].status, BlockStatus::DEBLURRED);
    EXPECT_FALSE(field.blocks[i].nonuniform_path_px);
    EXPECT_GE(field.blocks[i].extent_px, dx - 1e-4);  // away from the middle row there is some dy as well
    EXPECT_LT(field.blocks[i].extent_px, 1.05 * dx);
  }
}

/// A camera that pans by `pan_px` within an exposure, of whose blocks the images say the same, in px within it.
BlockBlur middle_block(double pan_px, double residual_px, double stddev_px) {
  constexpr double kExposureS = 0.02, kFocalPx = 500;
  const BlurFieldEstimator estimator(Camera(pinhole()), {});
  const ResidualVelocity residual{{residual_px / kExposureS, 0}, stddev_px / kExposureS};
  return estimator
      .estimate(AnalyticMotion::constant_rate({0, -pan_px / kFocalPx / kExposureS, 0}),
                RowExposure(0, 480, timing(20 * kMs, 0)), ResidualField(80, residual))
      .blocks[45];
}

TEST(BlurFieldEstimator, AddsWhatTheImagesAreCertainOf) {
  const double alone_px = middle_block(10, 0, 0.1).extent_px;
  EXPECT_NEAR(middle_block(10, 4, 0.1).extent_px, alone_px + 4, 1e-3);
  EXPECT_NEAR(middle_block(10, -4, 0.1).extent_px, alone_px - 4, 1e-3);
  EXPECT_TRUE(middle_block(10, 4, 0.1).residual);
  for (const double stddev_px : {1.2, 5.0}) {
    EXPECT_EQ(middle_block(10, 4, stddev_px).extent_px, alone_px);
    EXPECT_FALSE(middle_block(10, 4, stddev_px).residual);
  }
}

TEST(BlurFieldEstimator, PassesThroughWhatMayBeSharp) {
  const auto is_deblurred = [](double pan_px, double residual_px, double stddev_px) {
    return middle_block(pan_px, residual_px, stddev_px).status == BlockStatus::DEBLURRED;
  };
  // Certain, of all but 3.3 px.
  EXPECT_TRUE(is_deblurred(10, -6.7, 0.1));
  EXPECT_FALSE(is_deblurred(10, -6.7, 0.5));
  // Not certain, but as long as the smallest blur that is deblurred.
  EXPECT_FALSE(is_deblurred(5, 4, 2));
  EXPECT_FALSE(is_deblurred(5, -4, 2));
  EXPECT_TRUE(is_deblurred(10, 4, 2));
  // What scatters less is nothing.
  EXPECT_TRUE(is_deblurred(3.2, 2, 2));
}

// About its axis a camera with square pixels moves points on circles: the chord is at right angles to the radius when
// it is centred in time, and rotated by half the roll when it starts at the block's centre.
TEST(BlurFieldEstimator, RollBlursAtRightAnglesToTheRadius) {
  const double rate = 6, exposure_s = 0.03;
  const BlurFieldEstimator estimator(Camera(pinhole()), {});
  const RowExposure exposure(0, 480, timing(30 * kMs, 0));
  const FrameBlur field = estimator.estimate(AnalyticMotion::constant_rate({0, 0, rate}), exposure);
  for (int i = 0; i < field.grid.size(); ++i) {
    const Eigen::Vector2d radius = field.grid.center(i) - Eigen::Vector2d(319.5, 239.5);
    EXPECT_NEAR(field.blocks[i].extent_px, 2 * radius.norm() * std::sin(0.5 * rate * exposure_s), 1e-4);
    EXPECT_LT(axial_difference(field.blocks[i].angle_rad, axial_angle(-radius.y(), radius.x())), 1e-5);
  }
}

/// Blur by the path of the point that the block's centre sees at mid-exposure, from the closed form of the motion, at
/// each place by the exposure of its row.
BlockBlur true_blur(const AnalyticMotion& motion, const Camera& camera, const Eigen::Vector2d& center_px,
                    const RowExposure& exposure) {
  const double y = center_px.y();
  const Eigen::Vector3d world = motion.R_world_cam(exposure.middle(y)) * camera.ray(center_px);
  const double duration_ns = static_cast<double>(exposure.end(y) - exposure.start(y));
  return classify_path(path_of([&](double part) {
                         Eigen::Vector2d place_px = center_px;
                         for (int i = 0; i < 20; ++i) {
                           const TimeNs t_ns = exposure.middle(place_px.y()) + std::llround(part * duration_ns);
                           place_px = camera.project(motion.R_world_cam(t_ns).transpose() * world);
                         }
                         return place_px;
                       }),
                       {});
}

struct FieldError {
  double median_angle_deg, median_extent_px;
};

FieldError compare(const FrameBlur& field, const AnalyticMotion& motion, const Camera& camera,
                   const RowExposure& exposure) {
  std::vector<double> angles, extents;
  for (int i = 0; i < field.grid.size(); ++i) {
    const BlockBlur truth = true_blur(motion, camera, field.grid.center(i), exposure);
    angles.push_back(axial_difference(field.blocks[i].angle_rad, truth.angle_rad) / kDeg);
    extents.push_back(std::abs(field.blocks[i].extent_px - truth.extent_px));
  }
  return {median(angles), median(extents)};
}

TEST(BlurFieldEstimator, RollingShutterLensAndGyroscopeAgreeWithTheTruth) {
  const Camera camera(test::euroc_camera());
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const BlurFieldEstimator estimator(camera, {});
  Eigen::Matrix3d R_cam_imu;
  R_cam_imu << 0, -1, 0, -1, 0, 0, 0, 0, -1;
  GyroOptions options;
  options.time_offset_ns = 25 * kMs;
  options.bias_rad_s = {0.05, -0.03, 0.08};
  const auto samples = motion.sample({0, 400 * kMs}, 5 * kMs, R_cam_imu, options);
  for (const TimeNs readout_ns : {30 * kMs, -30 * kMs}) {
    const RowExposure exposure(150 * kMs, 480, timing(30 * kMs, readout_ns));
    const auto error = [&](const GyroOptions& o, const RowExposure& e) {
      return compare(estimator.estimate(RotationTrack(samples, o, R_cam_imu), e), motion, camera, exposure);
    };
    const FieldError good = error(options, exposure);
    EXPECT_LT(good.median_angle_deg, 0.1);
    EXPECT_LT(good.median_extent_px, 0.05);
    // Each convention matters: reversed, the field is wrong by far more than that.
    GyroOptions flipped = options;
    flipped.time_offset_ns *= -1;
    EXPECT_GT(error(flipped, exposure).median_extent_px, 1);
    flipped = options;
    flipped.bias_rad_s *= -1;
    EXPECT_GT(error(flipped, exposure).median_extent_px, 0.5);
    EXPECT_GT(error(options, RowExposure(150 * kMs, 480, timing(30 * kMs, -readout_ns))).median_extent_px, 0.5);
  }
}

// A point that moves by v rows a second is exposed for 1 / (1 - v t) times as long, t from row to row.
TEST(RollingShutterPath, IsLongerWithTheReadoutAndShorterAgainstIt) {
  for (const TimeNs readout_ns : {24 * kMs, -24 * kMs}) {
    const RowExposure exposure(0, 480, timing(20 * kMs, readout_ns));
    for (const Eigen::Vector2d& moved_px : {Eigen::Vector2d(30, 0), {0, 30}, {20, -60}, {-7, 3}}) {
      const auto path_px = path_of([&](double part) { return part * moved_px; });
      const double rows_per_row = moved_px.y() / 20e6 * static_cast<double>(readout_ns) / 480;
      const auto recorded_px = rolling_shutter_path(path_px, exposure);
      for (int k = 0; k < kPathInstants; ++k) {
        EXPECT_LT((recorded_px[k] - path_px[k] / (1 - rows_per_row)).norm(), 1e-3) << moved_px.transpose();
      }
    }
  }
}

TEST(RollingShutterPath, FollowsAcceleration) {
  const RowExposure exposure(0, 480, timing(30 * kMs, 30 * kMs));
  const auto place = [](double part) { return Eigen::Vector2d(20 * part, 50 * part + 30 * part * part); };
  const auto recorded_px = rolling_shutter_path(path_of(place), exposure);
  for (int k = 0; k < kPathInstants; ++k) {
    // Part of the exposure at which the point passes a row that is at the part k of its own.
    double part = k / (kPathInstants - 1.0) - 0.5;
    for (int i = 0; i < 30; ++i) part = k / (kPathInstants - 1.0) - 0.5 + place(part).y() / 480;
    EXPECT_LT((recorded_px[k] - place(part)).norm(), 0.01) << k;
  }
}

TEST(RollingShutterPath, IsThePathItselfOfAGlobalShutter) {
  const auto path_px = path_of([](double part) { return Eigen::Vector2d(20 * part, 50 * part + 30 * part * part); });
  EXPECT_EQ(rolling_shutter_path(path_px, RowExposure(0, 480, timing(30 * kMs, 0))), path_px);
}

TEST(RollingShutterPath, IsFiniteWhereAPointKeepsUpWithTheReadout) {
  const RowExposure exposure(0, 480, timing(30 * kMs, 30 * kMs));
  for (const double moved_px : {470.0, 480.0, 500.0, 3000.0}) {
    for (const Eigen::Vector2d& place_px :
         rolling_shutter_path(path_of([=](double part) { return Eigen::Vector2d(0, moved_px * part); }), exposure)) {
      EXPECT_LE(place_px.norm(), 0.5 * moved_px / 0.2) << moved_px;
    }
  }
}

// The gyroscope's rate rises within 1 ms in the middle of the middle row's exposure: rows before it and after it see an
// even pan, those that it falls into see a path whose parts have the lengths of the two rates.
TEST(BlurFieldEstimator, FindsAStepOfTheRateInTheRowsThatSeeIt) {
  constexpr double kSlow = 1, kFast = 2.5;
  const Camera camera(pinhole());
  const RowExposure exposure(0, 480, timing(20 * kMs, 48 * kMs));  // 0.1 ms a row
  const TimeNs step_ns = exposure.middle(240);
  std::vector<GyroSample> samples;
  for (TimeNs t = -5 * kMs; t <= 80 * kMs; t += kMs) samples.push_back({t, {0, t < step_ns ? kSlow : kFast, 0}});
  const FrameBlur field =
      BlurFieldEstimator(camera, {}).estimate(RotationTrack(samples, {}, Eigen::Matrix3d::Identity()), exposure);
  int stepped = 0, even = 0;
  for (int row = 0; row < field.grid.rows(); ++row) {
    const int index = row * field.grid.cols() + field.grid.cols() / 2 - 1;  // near the centre column
    const double y = field.grid.center(index).y();
    const BlockBlur& blur = field.blocks[index];
    EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
    if (exposure.end(y) < step_ns - kMs || exposure.start(y) > step_ns + kMs) {
      EXPECT_FALSE(blur.nonuniform_path_px) << row;
      ++even;
      continue;
    }
    ASSERT_TRUE(blur.nonuniform_path_px) << row;
    const double slow_s = to_seconds(step_ns - exposure.start(y)), fast_s = to_seconds(exposure.end(y) - step_ns);
    // The step takes 1 ms; tan is steeper away from the centre.
    EXPECT_NEAR(blur.extent_px, 500 * (kSlow * slow_s + kFast * fast_s), 0.6) << row;
    ++stepped;
  }
  EXPECT_GE(stepped, 2);
  EXPECT_GE(even, 2);
}

TEST(BlurFieldEstimator, UncoveredRowsAreNoGyro) {
  AnalyticMotion motion = AnalyticMotion::constant_rate({0, 2, 0});
  const RowExposure exposure(0, 480, timing(10 * kMs, 48 * kMs));  // 0.1 ms a row
  motion.set_range({0, exposure.end(200)});
  const FrameBlur field = BlurFieldEstimator(Camera(pinhole()), {}).estimate(motion, exposure);
  for (int i = 0; i < field.grid.size(); ++i) {
    const BlockBlur& blur = field.blocks[i];
    if (field.grid.center(i).y() <= 200) {
      EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
    } else {
      EXPECT_EQ(blur.status, BlockStatus::NO_GYRO);
      EXPECT_EQ(blur.extent_px, 0);
    }
  }
  EXPECT_EQ(field.count(BlockStatus::DEBLURRED), 30u);
  EXPECT_EQ(field.count(BlockStatus::NO_GYRO), 50u);
  EXPECT_EQ(field.count(BlockStatus::SHARP), 0u);
}

TEST(BlurFieldEstimator, BlocksBeyondTheLensModelAreNoGyro) {
  CameraCalibration c = pinhole(640, 480, 400);
  c.model = "plumb_bob";
  c.coefficients = {-0.4, 0, 0, 0};  // reaches 243 px from the centre
  const FrameBlur field =
      BlurFieldEstimator(Camera(c), {})
          .estimate(AnalyticMotion::constant_rate({0, 0.5, 0}), RowExposure(0, 480, timing(20 * kMs, 0)));
  for (int i = 0; i < field.grid.size(); ++i) {
    const double radius = (field.grid.center(i) - Eigen::Vector2d(319.5, 239.5)).norm();
    if (radius > 244) {
      EXPECT_EQ(field.blocks[i].status, BlockStatus::NO_GYRO) << i;
    }
    if (radius < 200) {
      EXPECT_EQ(field.blocks[i].status, BlockStatus::DEBLURRED) << i;
    }
    EXPECT_TRUE(std::isfinite(field.blocks[i].extent_px));
  }
}

TEST(BlurFieldEstimator, RefusesBadOptions) {
  BlurFieldOptions options;
  options.block_size_px = 7;
  EXPECT_THROW(BlurFieldEstimator(Camera(pinhole()), options), OptionError);
}

TEST(UniformBlurField, IsTheSameEverywhere) {
  const FrameBlur field = uniform_blur_field(130, 70, 170 * kDeg, 27, {});
  ASSERT_EQ(field.blocks.size(), 6u);
  for (const BlockBlur& blur : field.blocks) {
    EXPECT_NEAR(blur.angle_rad, 170 * kDeg, 1e-6);
    EXPECT_FLOAT_EQ(blur.extent_px, 27);
    EXPECT_EQ(blur.status, BlockStatus::DEBLURRED);
  }
  EXPECT_NEAR(uniform_blur_field(10, 10, -30 * kDeg, 5, {}).blocks[0].angle_rad, 150 * kDeg, 1e-6);
  EXPECT_EQ(uniform_blur_field(10, 10, 1, 0, {}).blocks[0].status, BlockStatus::SHARP);
  EXPECT_EQ(uniform_blur_field(10, 10, 1, 151, {}).blocks[0].status, BlockStatus::TOO_LARGE);
}

TEST(BlurFieldFromDisplacement, OneCellCoversTheImage) {
  for (const int type : {CV_32F, CV_64F}) {
    const FrameBlur field = blur_field_from_displacement(130, 70, cv::Mat(1, 1, type, cv::Scalar(3)),
                                                         cv::Mat(1, 1, type, cv::Scalar(4)), {});
    ASSERT_EQ(field.blocks.size(), 6u);
    for (const BlockBlur& blur : field.blocks) {
      EXPECT_NEAR(blur.extent_px, 5, 1e-5);
      EXPECT_NEAR(blur.angle_rad, std::atan2(4, 3), 1e-6);
    }
  }
}

TEST(BlurFieldFromDisplacement, CellsCoverTheImageEvenly) {
  // Per pixel, dx = 10 + x / 10, so the value at a block's centre shows where it was read; with fewer cells the same
  // ramp is sampled at the cells' centres.
  for (const int cols : {640, 320, 64, 10}) {
    cv::Mat dx(3, cols, CV_64F), dy = cv::Mat::zeros(3, cols, CV_64F);
    const double cell_px = 640.0 / cols;
    for (int col = 0; col < cols; ++col) dx.col(col) = 10 + ((col + 0.5) * cell_px - 0.5) / 10;
    const FrameBlur field = blur_field_from_displacement(640, 480, dx, dy, {});
    for (int i = 0; i < field.grid.size(); ++i) {
      EXPECT_NEAR(field.blocks[i].extent_px, 10 + field.grid.center(i).x() / 10, 1e-4) << cols;
      EXPECT_EQ(field.blocks[i].angle_rad, 0);
    }
  }
}

TEST(BlurFieldFromDisplacement, RowsInterpolateToo) {
  cv::Mat dy(48, 1, CV_32F), dx = cv::Mat::zeros(48, 1, CV_32F);
  for (int row = 0; row < 48; ++row) dy.at<float>(row) = static_cast<float>(20 + ((row + 0.5) * 10 - 0.5) / 10);
  const FrameBlur field = blur_field_from_displacement(640, 480, dx, dy, {});
  for (int i = 0; i < field.grid.size(); ++i) {
    EXPECT_NEAR(field.blocks[i].extent_px, 20 + field.grid.center(i).y() / 10, 1e-4);
    EXPECT_NEAR(field.blocks[i].angle_rad, M_PI / 2, 1e-6);
  }
}

TEST(BlurFieldFromDisplacement, ADisplacementAndItsOppositeAreTheSameBlur) {
  const cv::Mat dx = (cv::Mat_<double>(1, 2) << 30, -30), dy = (cv::Mat_<double>(1, 2) << 1, 1);
  BlurFieldOptions options;
  options.block_size_px = 8;
  const FrameBlur field = blur_field_from_displacement(160, 8, dx, dy, options);
  for (const BlockBlur& blur : field.blocks) {
    EXPECT_NEAR(blur.extent_px, std::hypot(30, 1), 1e-4);
    EXPECT_LT(axial_difference(blur.angle_rad, 0), std::atan2(1, 30) + 1e-6);
  }
}

TEST(BlurFieldFromDisplacement, BlocksThatTouchAHoleAreNoGyro) {
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    cv::Mat dx(128, 192, CV_64F, cv::Scalar(10)), dy = dx.clone();
    dy.at<double>(100, 70) = bad;  // pixel (70, 100): second column, second row of blocks
    const FrameBlur field = blur_field_from_displacement(192, 128, dx, dy, {});
    for (int i = 0; i < 6; ++i) {
      EXPECT_EQ(field.blocks[i].status, i == 4 ? BlockStatus::NO_GYRO : BlockStatus::DEBLURRED) << i;
    }
    EXPECT_EQ(field.blocks[4].extent_px, 0);
  }
  // One cell a block: only that block's own cell counts.
  cv::Mat dx(2, 3, CV_64F, cv::Scalar(10)), dy = dx.clone();
  dx.at<double>(0, 2) = std::numeric_limits<double>::quiet_NaN();
  const FrameBlur field = blur_field_from_displacement(192, 128, dx, dy, {});
  EXPECT_EQ(field.count(BlockStatus::NO_GYRO), 1u);
  EXPECT_EQ(field.blocks[2].status, BlockStatus::NO_GYRO);
}

TEST(BlurFieldFromDisplacement, RefusesMatricesThatDoNotFit) {
  const cv::Mat ok(2, 2, CV_64F, cv::Scalar(1));
  EXPECT_THROW(blur_field_from_displacement(64, 64, cv::Mat(), cv::Mat(), {}), std::invalid_argument);
  EXPECT_THROW(blur_field_from_displacement(64, 64, ok, cv::Mat(2, 3, CV_64F), {}), std::invalid_argument);
  EXPECT_THROW(blur_field_from_displacement(64, 64, ok, cv::Mat(2, 2, CV_8U), {}), std::invalid_argument);
  EXPECT_THROW(blur_field_from_displacement(64, 64, ok, cv::Mat(2, 2, CV_64FC2), {}), std::invalid_argument);
  EXPECT_NO_THROW(blur_field_from_displacement(64, 64, ok, ok, {}));
}

}  // namespace
}  // namespace gyro_deblur::blur_field_test
