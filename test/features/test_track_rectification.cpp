#include "features/track_rectification.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <set>

#include <gtest/gtest.h>

#include "analytic_motion.hpp"
#include "euroc_camera.hpp"
#include "gyro_deblur/blur_field.hpp"

namespace gyro_deblur::track_rectification_test {
namespace {

using test::AnalyticMotion;

constexpr TimeNs kMs = 1'000'000;
constexpr int kColumns = 752, kRows = 480;

RowExposure exposure_at(TimeNs stamp_ns) {
  ShutterTiming timing;
  timing.exposure_ns = 10 * kMs;
  timing.readout_ns = 30 * kMs;
  return RowExposure(stamp_ns, kRows, timing);
}

class TrackRectifierTest : public testing::Test {
 protected:
  /// Where a direction in the world is at an instant.
  Eigen::Vector2d pixel_at(const Eigen::Vector3d& world, TimeNs t_ns) const {
    return camera_.project(motion_.R_world_cam(t_ns).transpose() * world);
  }

  /// Tracks of directions that a rolling shutter sees, in the order of `world`.
  std::vector<Track> tracks_of(const std::vector<Eigen::Vector3d>& world, const RowExposure& exposure) const {
    std::vector<Track> tracks;
    for (const Eigen::Vector3d& direction : world) {
      Track& track = tracks.emplace_back();
      track.id = static_cast<std::int32_t>(tracks.size());
      track.length = 2;
      track.covariance_px2 << 0.04, 0.01, 0.01, 0.09;
      track.pixel_px = pixel_at(direction, exposure.middle(0));
      // The row decides the time, the time the row: a contraction, as no point moves as fast as the readout.
      for (int i = 0; i < 100; ++i) track.pixel_px = pixel_at(direction, exposure.middle(track.pixel_px.y()));
      track.normalized = camera_.normalized(camera_.ray(track.pixel_px));
    }
    return tracks;
  }

  /// Directions well inside the image.
  std::vector<Eigen::Vector3d> world_at(TimeNs t_ns) const {
    std::mt19937 rng(5);
    std::uniform_real_distribution<double> x(100, kColumns - 100), y(60, kRows - 60);
    std::vector<Eigen::Vector3d> world;
    for (int i = 0; i < 100; ++i) world.push_back(motion_.R_world_cam(t_ns) * camera_.ray({x(rng), y(rng)}));
    return world;
  }

  const Camera camera_{test::euroc_camera()};
  const AnalyticMotion motion_ = AnalyticMotion::handshake();
  FrameBlur field_ = uniform_blur_field(kColumns, kRows, 0, 10, {});
  TrackRectifier rectifier_;
};

TEST_F(TrackRectifierTest, PlacesAndVelocitiesAreThoseOfOneInstant) {
  const RowExposure first = exposure_at(300 * kMs), second = exposure_at(350 * kMs);
  const TimeNs first_ns = first.reference_time(RectifyTo::MIDDLE_ROW),
               second_ns = second.reference_time(RectifyTo::MIDDLE_ROW);
  const std::vector<Eigen::Vector3d> world = world_at(second_ns);
  rectifier_.rectify(tracks_of(world, first), field_, camera_, motion_, first, first_ns);
  const std::vector<Track> raw = tracks_of(world, second),
                           rectified = rectifier_.rectify(raw, field_, camera_, motion_, second, second_ns);
  ASSERT_EQ(rectified.size(), raw.size());
  double largest_raw_px = 0;
  for (std::size_t i = 0; i < world.size(); ++i) {
    const Eigen::Vector2d truth_px = pixel_at(world[i], second_ns), before_px = pixel_at(world[i], first_ns);
    largest_raw_px = std::max(largest_raw_px, (raw[i].pixel_px - truth_px).norm());
    EXPECT_EQ(rectified[i].id, raw[i].id);
    EXPECT_LT((rectified[i].pixel_px - truth_px).norm(), 1e-6);
    const Eigen::Vector2d now = camera_.ray(truth_px).hnormalized(), before = camera_.ray(before_px).hnormalized();
    EXPECT_LT((rectified[i].normalized - now).norm(), 1e-8);
    EXPECT_LT((rectified[i].velocity_1_s - (now - before) / to_seconds(second_ns - first_ns)).norm(), 1e-6);
  }
  EXPECT_GT(largest_raw_px, 3);  // unmoved they are far off
}

TEST_F(TrackRectifierTest, ResidualVelocityMovesThemAndWidensTheirCovariance) {
  const RowExposure exposure = exposure_at(300 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::LAST_ROW);
  const std::vector<Track> raw = tracks_of(world_at(reference_ns), exposure);
  const std::vector<Track> by_rotation = rectifier_.rectify(raw, field_, camera_, motion_, exposure, reference_ns);
  const Eigen::Vector2d velocity_px_s(200, -100);
  constexpr double kStddevPxS = 20;
  for (BlockBlur& block : field_.blocks) block.residual = ResidualVelocity{velocity_px_s, kStddevPxS};
  const std::vector<Track> by_both = rectifier_.rectify(raw, field_, camera_, motion_, exposure, reference_ns);
  ASSERT_EQ(by_both.size(), raw.size());
  for (std::size_t i = 0; i < raw.size(); ++i) {
    const double seconds = to_seconds(reference_ns - exposure.middle(raw[i].pixel_px.y()));
    EXPECT_LT((by_both[i].pixel_px - by_rotation[i].pixel_px - seconds * velocity_px_s).norm(), 1e-6);
    const double variance_px2 = std::pow(seconds * kStddevPxS, 2);
    EXPECT_LT(
        (by_both[i].covariance_px2 - by_rotation[i].covariance_px2 - variance_px2 * Eigen::Matrix2d::Identity()).norm(),
        1e-6);
    // A shake of a few pixels hardly stretches what it moves.
    EXPECT_LT((by_rotation[i].covariance_px2 - raw[i].covariance_px2).norm(), 0.01);
  }
}

TEST_F(TrackRectifierTest, TracksOfUnknownMotionAreLeftOut) {
  const RowExposure exposure = exposure_at(300 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  // Samples end shortly after that instant: most of the lower half of the image cannot be moved.
  const TimeNs known_until_ns = reference_ns + 2 * kMs;
  const RotationTrack known_above(motion_.sample({0, known_until_ns}, kMs, Eigen::Matrix3d::Identity(), {}), {},
                                  Eigen::Matrix3d::Identity());
  const std::vector<Track> raw = tracks_of(world_at(reference_ns), exposure);
  std::vector<std::int32_t> ids, expected;
  for (const Track& track : raw) {
    if (exposure.middle(track.pixel_px.y()) <= known_until_ns - kMs) expected.push_back(track.id);
  }
  for (const Track& track : rectifier_.rectify(raw, field_, camera_, known_above, exposure, reference_ns)) {
    EXPECT_LE(exposure.middle(raw[static_cast<std::size_t>(track.id) - 1].pixel_px.y()), known_until_ns);
    ids.push_back(track.id);
  }
  ASSERT_GT(expected.size(), 20u);
  ASSERT_LT(ids.size(), 80u);
  EXPECT_TRUE(std::includes(ids.begin(), ids.end(), expected.begin(), expected.end()));
}

TEST_F(TrackRectifierTest, ATrackThatWasLeftOutComesBackUnderAnotherId) {
  const RowExposure exposure = exposure_at(300 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const std::vector<Track> raw = tracks_of(world_at(reference_ns), exposure);
  const RotationTrack known_above(motion_.sample({0, reference_ns + 2 * kMs}, kMs, Eigen::Matrix3d::Identity(), {}), {},
                                  Eigen::Matrix3d::Identity());
  const auto ids_with = [&](const CameraMotion& motion) {
    std::vector<std::int32_t> ids;
    for (const Track& track : rectifier_.rectify(raw, field_, camera_, motion, exposure, reference_ns)) {
      ids.push_back(track.id);
    }
    return ids;
  };
  // What nobody has seen keeps the tracker's id.
  ids_with(known_above);
  const std::vector<std::int32_t> all = ids_with(motion_);
  ASSERT_EQ(all.size(), raw.size());
  for (std::size_t i = 0; i < raw.size(); ++i) EXPECT_EQ(all[i], raw[i].id);

  std::vector<std::int32_t> kept, back = all;
  for (int gap = 0; gap < 3; ++gap) {
    const std::vector<std::int32_t> before = back;
    kept = ids_with(known_above);
    EXPECT_EQ(ids_with(known_above), kept);
    back = ids_with(motion_);
    ASSERT_EQ(back.size(), all.size());
    for (std::size_t i = 0; i < back.size(); ++i) {
      const bool was_left_out = std::find(kept.begin(), kept.end(), before[i]) == kept.end();
      EXPECT_EQ(back[i] != before[i], was_left_out) << i;
      EXPECT_EQ(back[i] >= kTrackerIds, back[i] != raw[i].id) << i;
    }
    EXPECT_EQ(std::set<std::int32_t>(back.begin(), back.end()).size(), back.size());
    EXPECT_EQ(ids_with(motion_), back);
  }
  EXPECT_GT(kept.size(), 20u);
  EXPECT_LT(kept.size(), 80u);
}

TEST_F(TrackRectifierTest, WithoutGyroscopeBlocksWithoutResidualVelocityAreNotAtRest) {
  const RowExposure exposure = exposure_at(300 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  const std::vector<Track> raw = tracks_of(world_at(reference_ns), exposure);
  const RotationTrack unknown({}, {}, Eigen::Matrix3d::Identity());
  field_.images_alone = true;
  EXPECT_TRUE(rectifier_.rectify(raw, field_, camera_, unknown, exposure, reference_ns).empty());
  for (BlockBlur& block : field_.blocks) block.residual = ResidualVelocity{{100, 0}, 5};
  EXPECT_EQ(rectifier_.rectify(raw, field_, camera_, unknown, exposure, reference_ns).size(), raw.size());
}

TEST_F(TrackRectifierTest, VelocitiesStayWhereTheReferenceTimeDoes) {
  const RowExposure exposure = exposure_at(300 * kMs);
  const TimeNs reference_ns = exposure.reference_time(RectifyTo::MIDDLE_ROW);
  std::vector<Track> raw = tracks_of(world_at(reference_ns), exposure);
  for (Track& track : raw) track.velocity_1_s = {0.5, -0.25};
  rectifier_.rectify(raw, field_, camera_, motion_, exposure, reference_ns);
  for (const Track& track : rectifier_.rectify(raw, field_, camera_, motion_, exposure, reference_ns)) {
    EXPECT_EQ(track.velocity_1_s, Eigen::Vector2d(0.5, -0.25));
  }
}

}  // namespace
}  // namespace gyro_deblur::track_rectification_test
