#include "features/point_motion.hpp"

#include <algorithm>
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "analytic_motion.hpp"
#include "euroc_camera.hpp"
#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::rectification_test {
namespace {

using test::AnalyticMotion;

constexpr TimeNs kMs = 1'000'000;
constexpr int kRows = 480;

ShutterTiming timing(TimeNs readout_ns) {
  ShutterTiming t;
  t.exposure_ns = 10 * kMs;
  t.readout_ns = readout_ns;
  return t;
}

FrameBlur field_of(BlockStatus status) {
  FrameBlur field = uniform_blur_field(752, kRows, 0, 10, {});
  for (BlockBlur& blur : field.blocks) blur.status = status;
  return field;
}

/// A scene point, where the rolling shutter sees it, and where it would be at the reference time.
struct Sighting {
  Eigen::Vector2d raw_px, true_px;
  Eigen::Vector3d true_direction;
};

std::vector<Sighting> sightings(const AnalyticMotion& motion, const Camera& camera, const RowExposure& exposure,
                                TimeNs reference_ns) {
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(0, 1);
  std::vector<Sighting> result;
  while (result.size() < 300) {
    const Eigen::Vector2d seen_at_reference(u(rng) * 751, u(rng) * (kRows - 1));
    const Eigen::Vector3d world = motion.R_world_cam(reference_ns) * camera.ray(seen_at_reference);
    // The row decides the time, the time the row: a contraction, as no point moves as fast as the readout.
    Eigen::Vector2d raw_px = seen_at_reference;
    for (int i = 0; i < 100 && raw_px.allFinite(); ++i) {
      raw_px = camera.project(motion.R_world_cam(exposure.middle(raw_px.y())).transpose() * world);
    }
    if (!raw_px.allFinite() || (raw_px - raw_px.cwiseMax(0).cwiseMin(Eigen::Vector2d(751, kRows - 1))).norm() > 0)
      continue;
    result.push_back({raw_px, seen_at_reference, motion.R_world_cam(reference_ns).transpose() * world});
  }
  return result;
}

struct Errors {
  double median_px, max_px;
};

Errors errors(const std::vector<Sighting>& truth, const std::vector<RectifiedPoint>& points) {
  std::vector<double> distance;
  for (std::size_t i = 0; i < truth.size(); ++i) distance.push_back((points[i].rectified_px - truth[i].true_px).norm());
  std::sort(distance.begin(), distance.end());
  return {distance[distance.size() / 2], distance.back()};
}

std::vector<Eigen::Vector2d> raw(const std::vector<Sighting>& truth) {
  std::vector<Eigen::Vector2d> points;
  for (const Sighting& sighting : truth) points.push_back(sighting.raw_px);
  return points;
}

class RectifyPoints : public testing::TestWithParam<std::tuple<RectifyTo, int>> {};

TEST_P(RectifyPoints, MovesRollingShutterPointsToTheReferenceTime) {
  const auto& [rectify_to, readout_ms] = GetParam();
  const Camera camera(test::euroc_camera());
  const AnalyticMotion motion = AnalyticMotion::handshake();
  Eigen::Matrix3d R_cam_imu;
  R_cam_imu << 0, -1, 0, -1, 0, 0, 0, 0, -1;
  GyroOptions options;
  options.time_offset_ns = 25 * kMs;
  options.bias_rad_s = {0.05, -0.03, 0.08};
  std::vector<GyroSample> samples = motion.sample({0, 600 * kMs}, 5 * kMs, R_cam_imu, options);
  const RowExposure exposure(300 * kMs, kRows, timing(readout_ms * kMs));
  const TimeNs reference_ns = exposure.reference_time(rectify_to);
  const auto truth = sightings(motion, camera, exposure, reference_ns);
  const FrameBlur field = field_of(BlockStatus::DEBLURRED);

  const auto rectify = [&](const std::vector<GyroSample>& s, const GyroOptions& o, const RowExposure& e) {
    return rectify_points(raw(truth), field, camera, RotationTrack(s, o, R_cam_imu), e, reference_ns);
  };
  const auto points = rectify(samples, options, exposure);
  const Errors good = errors(truth, points);
  EXPECT_LT(good.max_px, 0.05);
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_TRUE(points[i].rectified);
    EXPECT_TRUE(points[i].deblurred);
    EXPECT_LT((points[i].normalized - truth[i].true_direction.hnormalized()).norm(), 2e-4);
    EXPECT_LT((points[i].normalized - camera.ray(points[i].rectified_px).hnormalized()).norm(), 1e-8);
  }

  // Unchanged, the points are many times worse; with a sign reversed, worse than the limit by far.
  Errors none{};
  {
    std::vector<RectifiedPoint> unmoved(truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i) unmoved[i].rectified_px = truth[i].raw_px;
    none = errors(truth, unmoved);
  }
  EXPECT_GT(none.median_px, 100 * good.median_px);
  std::vector<GyroSample> reversed = samples;
  for (GyroSample& sample : reversed) {
    sample.rate_rad_s = 2 * options.bias_rad_s - sample.rate_rad_s;  // the rate itself, not the bias
  }
  EXPECT_GT(errors(truth, rectify(reversed, options, exposure)).median_px, 1.5 * none.median_px);
  GyroOptions flipped = options;
  flipped.time_offset_ns *= -1;
  EXPECT_GT(errors(truth, rectify(samples, flipped, exposure)).median_px, 1);
  const RowExposure flipped_readout(300 * kMs, kRows, timing(-readout_ms * kMs));
  EXPECT_GT(errors(truth, rectify(samples, options, flipped_readout)).median_px, 5);
}

INSTANTIATE_TEST_SUITE_P(All, RectifyPoints,
                         testing::Combine(testing::Values(RectifyTo::FIRST_ROW, RectifyTo::MIDDLE_ROW,
                                                          RectifyTo::LAST_ROW, RectifyTo::STAMP),
                                          testing::Values(30, -30)));

TEST(RectifyPointsByStatus, RejectedAndUncoveredBlocksAreUnchanged) {
  const Camera camera(test::euroc_camera());
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const RowExposure exposure(0, kRows, timing(30 * kMs));
  const std::vector<Eigen::Vector2d> points{{100, 20}, {600, 400}};
  for (const BlockStatus status : {BlockStatus::SHARP, BlockStatus::DEBLURRED, BlockStatus::REJECTED,
                                   BlockStatus::TOO_LARGE, BlockStatus::NO_GYRO, BlockStatus::TOO_CURVED}) {
    const auto result = rectify_points(points, field_of(status), camera, motion, exposure,
                                       exposure.reference_time(RectifyTo::MIDDLE_ROW));
    const bool moves = status != BlockStatus::REJECTED && status != BlockStatus::NO_GYRO;
    ASSERT_EQ(result.size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ(result[i].rectified, moves) << to_string(status);
      EXPECT_EQ(result[i].deblurred, status == BlockStatus::DEBLURRED) << to_string(status);
      if (moves) {
        EXPECT_GT((result[i].rectified_px - points[i]).norm(), 1);
      } else {
        EXPECT_EQ(result[i].rectified_px, points[i]);
        EXPECT_LT((result[i].normalized - camera.ray(points[i]).hnormalized()).norm(), 1e-12);
      }
    }
  }
}

TEST(RectifyPointsByStatus, EachPointFollowsItsOwnBlock) {
  const Camera camera(test::euroc_camera());
  const RowExposure exposure(0, kRows, timing(30 * kMs));
  FrameBlur field = field_of(BlockStatus::DEBLURRED);
  field.blocks[field.grid.index_at(100, 20)].status = BlockStatus::REJECTED;
  const auto result = rectify_points({{100, 20}, {164, 20}}, field, camera, AnalyticMotion::handshake(), exposure,
                                     exposure.reference_time(RectifyTo::MIDDLE_ROW));
  EXPECT_FALSE(result[0].rectified);
  EXPECT_TRUE(result[1].rectified);
}

TEST(RectifyPointsByStatus, StartsWhereTheSceneWasNotWhereItIsShown) {
  const Camera camera(test::euroc_camera());
  const RowExposure exposure(0, kRows, timing(30 * kMs));
  const AnalyticMotion motion = AnalyticMotion::handshake();
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  FrameBlur field = field_of(BlockStatus::DEBLURRED);
  // In the middle of a block, where its neighbours' offsets do not count; along the row, which keeps its time.
  const Eigen::Vector2d raw(95.5, 20), offset(3, 0);
  const Eigen::Vector2d expected =
      rectify_points({raw - offset}, field, camera, motion, exposure, reference_ns)[0].rectified_px;
  BlockBlur& block = field.blocks[field.grid.index_at(raw.x(), raw.y())];
  block.angle_rad = 0;
  block.chord_middle_px = block.mean_place_px = offset.cast<float>();
  EXPECT_LT((rectify_points({raw}, field, camera, motion, exposure, reference_ns)[0].rectified_px - expected).norm(),
            1e-9);
  block.status = BlockStatus::REJECTED;
  EXPECT_EQ(rectify_points({raw}, field, camera, motion, exposure, reference_ns)[0].rectified_px, raw);
}

TEST(RectifyPointsByStatus, UncoveredTimesLeavePointsAlone) {
  const Camera camera(test::euroc_camera());
  const RowExposure exposure(0, kRows, timing(48 * kMs));  // 0.1 ms a row
  const TimeNs reference_ns = exposure.middle(100);
  const FrameBlur field = field_of(BlockStatus::DEBLURRED);
  const std::vector<Eigen::Vector2d> points{{50, 50}, {50, 400}};
  AnalyticMotion motion = AnalyticMotion::handshake();
  motion.set_range({0, exposure.middle(200)});
  auto result = rectify_points(points, field, camera, motion, exposure, reference_ns);
  EXPECT_TRUE(result[0].rectified);
  EXPECT_FALSE(result[1].rectified);  // its own time is unknown
  motion.set_range({exposure.middle(101), exposure.middle(479)});
  result = rectify_points(points, field, camera, motion, exposure, reference_ns);
  EXPECT_FALSE(result[0].rectified);  // the reference time is unknown
  EXPECT_FALSE(result[1].rectified);
  EXPECT_EQ(result[1].rectified_px, points[1]);
}

TEST(RectifyPointsByStatus, AHoleInTheGyroscopeSeparatesPoints) {
  const Camera camera(test::euroc_camera());
  const RowExposure exposure(0, kRows, timing(240 * kMs));  // 0.5 ms a row
  std::vector<GyroSample> samples = AnalyticMotion::handshake().sample({0, 300 * kMs}, 5 * kMs);
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const GyroSample& s) { return s.t_ns > 100 * kMs && s.t_ns < 160 * kMs; }),
                samples.end());
  const RotationTrack track(samples, {}, Eigen::Matrix3d::Identity());
  const auto result = rectify_points({{50, 50}, {50, 240}, {50, 400}}, field_of(BlockStatus::DEBLURRED), camera, track,
                                     exposure, exposure.reference_time(RectifyTo::FIRST_ROW));
  EXPECT_TRUE(result[0].rectified);
  EXPECT_FALSE(result[1].rectified);
  EXPECT_FALSE(result[2].rectified);
}

TEST(RectifyPointsByStatus, PointsThatLeaveTheLensModelAreUnchanged) {
  CameraCalibration c = test::euroc_camera();
  c.fx_px = c.fy_px = 700;
  c.coefficients = {-0.4, 0, 0, 0};  // reaches 426 px
  const Camera camera(c);
  const RowExposure exposure(0, kRows, timing(48 * kMs));
  const Eigen::Vector2d inside(c.cx_px, c.cy_px), edge(0, 50);
  const AnalyticMotion motion = AnalyticMotion::constant_rate({0, 20, 0});
  const auto result =
      rectify_points({inside, edge}, field_of(BlockStatus::DEBLURRED), camera, motion, exposure, 30 * kMs);
  EXPECT_TRUE(result[0].rectified);
  EXPECT_FALSE(result[1].rectified);
  EXPECT_EQ(result[1].rectified_px, edge);
  EXPECT_TRUE(result[1].normalized.allFinite());
  EXPECT_TRUE(rectify_points({}, field_of(BlockStatus::SHARP), camera, motion, exposure, 0).empty());
}

TEST(RectifyPointsByStatus, NormalizedCoordinatesAreTheImagesOwn) {
  CameraCalibration c = test::euroc_camera();
  c.model = "none";
  c.coefficients.clear();
  c.R_image_cam = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const Camera camera(c);
  const RowExposure exposure(0, kRows, timing(30 * kMs));
  const auto result = rectify_points({{100, 20}, {600, 400}}, field_of(BlockStatus::DEBLURRED), camera,
                                     AnalyticMotion::handshake(), exposure, 20 * kMs);
  for (const RectifiedPoint& point : result) {
    ASSERT_TRUE(point.rectified);
    EXPECT_NEAR(point.normalized.x(), (point.rectified_px.x() - c.cx_px) / c.fx_px, 1e-12);
    EXPECT_NEAR(point.normalized.y(), (point.rectified_px.y() - c.cy_px) / c.fy_px, 1e-12);
  }
}

}  // namespace
}  // namespace gyro_deblur::rectification_test
