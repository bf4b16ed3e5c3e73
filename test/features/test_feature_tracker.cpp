#include "gyro_deblur/feature_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <opencv2/imgproc.hpp>

#include "base/parallel.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::feature_tracker_test {
namespace {

using sim::Simulator;

// A camera that rotates by up to 50 px between two images in front of a wall, without blur.
const char kScene[] = R"(
frames: 12
seed: 7
camera: {size: [320, 240], intrinsics: [250, 252, 158, 121], distortion_model: plumb_bob,
  distortion_coefficients: [-0.20, 0.05, 0.001, -0.0008, 0.002], fps: 20, exposure_time: 0.001, readout_time: 0.020,
  noise: 1}
imu: {rate: 400}
planes: [{size: [9, 7], position: [0, 0, 2], texture_size: [1800, 1400], texture_seed: 21}]
motion: {type: curve, rotation: {sines: [{amplitude: [6, 14, 5], frequency: 2.3, phase: 20}]},
  position: {sines: [{amplitude: [0.05, 0.03, 0.02], frequency: 1.1}]}}
)";

class FeatureTrackerTest : public ::testing::Test {
 protected:
  FeatureTrackerTest() : FeatureTrackerTest(0.001) {}
  explicit FeatureTrackerTest(double exposure_s)
      : simulator_(sim::parse_scene(scene(exposure_s), "", "tracker")), motion_(rotation(1)) {
    for (int i = 0; i < simulator_.frames(); ++i) images_.push_back(simulator_.frame(i).image);
    options_.min_distance_px = 15;
    options_.max_tracks = 60;
    options_.border_px = 0;
  }

  static YAML::Node scene(double exposure_s) {
    YAML::Node node = YAML::Load(kScene);
    node["camera"]["exposure_time"] = exposure_s;
    return node;
  }

  /// @param sign  -1: a gyroscope that is wired the wrong way round
  RotationTrack rotation(double sign) const {
    std::vector<GyroSample> samples;
    for (const sim::ImuSample& s : simulator_.imu()) samples.push_back({s.t_ns, sign * s.rate_rad_s});
    return RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
  }

  Eigen::Vector2d truth(int from, const Eigen::Vector2d& pixel_px, int to) const {
    const RowExposure exposure = simulator_.exposure(to);
    Eigen::Vector2d at_px = pixel_px;
    for (int k = 0; k < 8; ++k) {
      at_px = simulator_.truth_rectified(from, pixel_px, exposure.middle(std::clamp(at_px.y(), 0.0, 239.0)));
    }
    return at_px;
  }

  struct Run {
    std::size_t followed = 0, wrong = 0;  // corners in later images than their first; further than 2 px from the truth
    int longest = 0;
  };
  Run run(const CameraMotion& motion) {
    FeatureTracker tracker(options_);
    std::map<std::int32_t, std::pair<int, Eigen::Vector2d>> births;
    Run result;
    for (int i = 0; i < simulator_.frames(); ++i) {
      const std::vector<Track>& tracks =
          tracker.track(images_[static_cast<std::size_t>(i)], simulator_.camera(), motion, simulator_.exposure(i));
      EXPECT_LE(tracks.size(), static_cast<std::size_t>(options_.max_tracks));
      std::set<std::int32_t> ids;
      for (const Track& track : tracks) {
        EXPECT_TRUE(ids.insert(track.id).second) << "an id twice in an image";
        const auto [birth, is_new] = births.insert({track.id, {i, track.pixel_px}});
        EXPECT_EQ(track.length, i - birth->second.first + 1);
        result.longest = std::max(result.longest, track.length);
        if (is_new) continue;
        ++result.followed;
        const double error_px = (track.pixel_px - truth(birth->second.first, birth->second.second, i)).norm();
        result.wrong += error_px > 2 ? 1 : 0;
      }
    }
    return result;
  }

  Simulator simulator_;
  RotationTrack motion_;
  std::vector<cv::Mat> images_;
  TrackerOptions options_;
};

TEST_F(FeatureTrackerTest, FollowsCornersWhereTheTruthHasThem) {
  const Run run_ = run(motion_);
  EXPECT_GT(run_.followed, 200u);
  EXPECT_LT(run_.wrong, run_.followed / 50);
  EXPECT_GE(run_.longest, 6);
}

/// The same camera with blur.
class BlurredTrackerTest : public FeatureTrackerTest {
 protected:
  explicit BlurredTrackerTest(double exposure_s = 0.020) : FeatureTrackerTest(exposure_s) {}

  /// @param median_px, most_px  that half and nine tenths of the errors from image to image are below
  void expect_errors_below(double median_px, double most_px) {
    FeatureTracker tracker(options_);
    std::map<std::int32_t, Eigen::Vector2d> before_px;
    std::map<std::int32_t, std::pair<int, Eigen::Vector2d>> births;
    std::vector<double> errors_px;
    double squared = 0;
    std::size_t lost = 0;
    for (int i = 0; i < simulator_.frames(); ++i) {
      std::map<std::int32_t, Eigen::Vector2d> now_px;
      for (const Track& track :
           tracker.track(images_[static_cast<std::size_t>(i)], simulator_.camera(), motion_, simulator_.exposure(i))) {
        now_px[track.id] = track.pixel_px;
        const auto& [birth, born_px] = births.insert({track.id, {i, track.pixel_px}}).first->second;
        if (track.length == 1) {
          EXPECT_TRUE(track.covariance_px2.isZero());
          continue;
        }
        errors_px.push_back((track.pixel_px - truth(i - 1, before_px.at(track.id), i)).norm());
        const Eigen::Vector2d error_px = track.pixel_px - truth(birth, born_px, i);
        ASSERT_GT(track.covariance_px2.determinant(), 0);
        squared += error_px.dot(track.covariance_px2.inverse() * error_px);
        lost += error_px.norm() > 2 ? 1 : 0;
      }
      before_px = now_px;
    }
    ASSERT_GT(errors_px.size(), 200u);
    EXPECT_LT(lost, errors_px.size() / 50);
    const auto count = static_cast<double>(errors_px.size());
    std::sort(errors_px.begin(), errors_px.end());
    EXPECT_LT(errors_px[errors_px.size() / 2], median_px);
    EXPECT_LT(errors_px[errors_px.size() * 9 / 10], most_px);
    // 2 where covariances are those of the errors, which depths that change add to: a single wall has none, and the map
    // of its motion is exact.
    EXPECT_GT(squared / count, 0.05);
    EXPECT_LT(squared / count, 4);
  }
};

/// Up to 20 px.
TEST_F(BlurredTrackerTest, FollowsCornersThroughBlurToATenthOfAPixel) { expect_errors_below(0.1, 0.3); }

/// Up to 45 px: patches are compared at half the size.
class LongBlurTrackerTest : public BlurredTrackerTest {
 protected:
  LongBlurTrackerTest() : BlurredTrackerTest(0.045) {}
};

TEST_F(LongBlurTrackerTest, FollowsCornersThroughLongBlur) { expect_errors_below(0.2, 0.5); }

TEST_F(LongBlurTrackerTest, ThreadsFindTheSame) {
  const EagerHelpers eager_helpers;
  FeatureTracker alone(options_), together(options_);
  alone.set_threads(1);
  together.set_threads(4);
  for (int i = 0; i < simulator_.frames(); ++i) {
    const cv::Mat& image = images_[static_cast<std::size_t>(i)];
    const std::vector<Track>& expected = alone.track(image, simulator_.camera(), motion_, simulator_.exposure(i));
    const std::vector<Track>& tracks = together.track(image, simulator_.camera(), motion_, simulator_.exposure(i));
    ASSERT_EQ(tracks.size(), expected.size()) << i;
    for (std::size_t k = 0; k < tracks.size(); ++k) {
      ASSERT_EQ(tracks[k].id, expected[k].id) << i;
      ASSERT_EQ(tracks[k].pixel_px, expected[k].pixel_px) << i;
    }
  }
}

TEST_F(FeatureTrackerTest, TheGyroscopesPredictionIsWhatMakesItSo) {
  const Run right = run(motion_), reversed = run(rotation(-1));
  EXPECT_GT(right.followed, 200u);
  EXPECT_LT(reversed.followed - reversed.wrong, right.followed / 2);
}

TEST_F(FeatureTrackerTest, CoordinatesAndVelocitiesAreThoseOfTheUndistortedPlane) {
  FeatureTracker tracker(options_);
  std::map<std::int32_t, Eigen::Vector2d> before;
  for (int i = 0; i < 2; ++i) {
    for (const Track& track :
         tracker.track(images_[static_cast<std::size_t>(i)], simulator_.camera(), motion_, simulator_.exposure(i))) {
      EXPECT_LT((simulator_.camera().project(track.normalized.homogeneous()) - track.pixel_px).norm(), 1e-4);
      if (i == 0 || track.length == 1) {
        EXPECT_EQ(track.velocity_1_s, Eigen::Vector2d::Zero());
        before[track.id] = track.normalized;
      } else {
        EXPECT_LT((track.velocity_1_s * 0.05 - (track.normalized - before.at(track.id))).norm(), 1e-9);
      }
    }
  }
}

TEST_F(FeatureTrackerTest, AnObjectThatMovesOnItsOwnIsAnOutlier) {
  options_.min_distance_px = 8;
  options_.max_tracks = 200;
  // A patch of the first image slides sideways, against the rotation and the translation of everything else.
  std::vector<cv::Mat> images{images_[0].clone(), images_[1].clone()};
  const cv::Rect at(120, 80, 70, 70);
  cv::Mat patch(at.size(), CV_8UC1);
  cv::RNG rng(5);
  rng.fill(patch, cv::RNG::UNIFORM, 0, 256);
  cv::GaussianBlur(patch, patch, {}, 1.5);
  cv::normalize(patch, patch, 0, 255, cv::NORM_MINMAX);
  patch.copyTo(images[0](at));
  const Eigen::Vector2d goal = truth(0, {at.x + 35.0, at.y + 35.0}, 1);
  const cv::Rect moved(at.x + static_cast<int>(goal.x() - at.x - 35) + 5,
                       at.y + static_cast<int>(goal.y() - at.y - 35) - 7, at.width, at.height);
  patch.copyTo(images[1](moved));
  FeatureTracker tracker(options_);
  std::set<std::int32_t> on_patch;
  for (const Track& track : tracker.track(images[0], simulator_.camera(), motion_, simulator_.exposure(0))) {
    const cv::Point p(cvRound(track.pixel_px.x()), cvRound(track.pixel_px.y()));
    if (cv::Rect(at.x + 12, at.y + 12, at.width - 24, at.height - 24).contains(p)) on_patch.insert(track.id);
  }
  ASSERT_GE(on_patch.size(), 3u);
  std::size_t kept = 0, others = 0;
  for (const Track& track : tracker.track(images[1], simulator_.camera(), motion_, simulator_.exposure(1))) {
    if (track.length == 1) continue;
    (on_patch.count(track.id) > 0 ? kept : others) += 1;
  }
  EXPECT_LT(2 * kept, on_patch.size());
  EXPECT_GT(others, 15u);
}

TEST_F(FeatureTrackerTest, CornersStartInTextureAndNotInNoise) {
  // On the left noise alone, on the right faint waves of 12 px.
  cv::Mat image(240, 320, CV_8UC1);
  cv::RNG rng(9);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) {
      const double wave = x < 160 ? 0 : 4 * std::sin(CV_PI / 6 * x) * std::sin(CV_PI / 6 * y);
      image.at<uchar>(y, x) = cv::saturate_cast<uchar>(100 + wave + rng.gaussian(4));
    }
  }
  options_.max_tracks = 40;
  FeatureTracker tracker(options_);
  const std::vector<Track>& tracks = tracker.track(image, simulator_.camera(), motion_, simulator_.exposure(0));
  ASSERT_EQ(tracks.size(), 40u);
  const auto in_noise =
      std::count_if(tracks.begin(), tracks.end(), [](const Track& t) { return t.pixel_px.x() < 150; });
  EXPECT_LE(in_noise, 4);
}

TEST_F(FeatureTrackerTest, StartsAnewWhenTimeGoesBackOrLeapsAndNeverUsesAnIdTwice) {
  FeatureTracker tracker(options_);
  std::set<std::int32_t> first;
  for (const Track& track : tracker.track(images_[1], simulator_.camera(), motion_, simulator_.exposure(1))) {
    first.insert(track.id);
  }
  const std::vector<Track> again = tracker.track(images_[0], simulator_.camera(), motion_, simulator_.exposure(0));
  ASSERT_FALSE(again.empty());
  for (const Track& track : again) {
    EXPECT_EQ(track.length, 1);
    EXPECT_EQ(first.count(track.id), 0u);
  }
  const RowExposure late(simulator_.stamp(0) + 2'000'000'000, 240, simulator_.scene().timing(0));
  for (const Track& track : tracker.track(images_[0], simulator_.camera(), motion_, late)) EXPECT_EQ(track.length, 1);
}

TEST_F(FeatureTrackerTest, WithoutGyroscopeItLooksWhereTheCornersWere) {
  const RotationTrack nothing({}, GyroOptions{}, Eigen::Matrix3d::Identity());
  FeatureTracker tracker(options_);
  tracker.track(images_[0], simulator_.camera(), nothing, simulator_.exposure(0));
  const RowExposure next(simulator_.stamp(0) + 50'000'000, 240, simulator_.scene().timing(0));
  std::size_t followed = 0;
  for (const Track& track : tracker.track(images_[0], simulator_.camera(), nothing, next))
    followed += track.length == 2;
  EXPECT_GT(followed, 20u);  // the same image: nothing has moved
}

TEST_F(FeatureTrackerTest, CornersStartAwayFromTheEdge) {
  options_.max_tracks = 1000;
  // Where their whole window is in the image, at the given distance, and in three quarters of a small image.
  for (const auto& [border_px, margin_px] : {std::pair(0, options_.window_px / 2), {32, 32}, {500, 60}}) {
    options_.border_px = border_px;
    FeatureTracker tracker(options_);
    const std::vector<Track>& tracks = tracker.track(images_[0], simulator_.camera(), motion_, simulator_.exposure(0));
    ASSERT_GT(tracks.size(), 30u);
    double nearest_px = 1000;
    for (const Track& track : tracks) {
      const Eigen::Vector2d& at = track.pixel_px;
      nearest_px = std::min({nearest_px, at.x(), at.y(), 319 - at.x(), 239 - at.y()});
    }
    EXPECT_GT(nearest_px, margin_px);
    EXPECT_LT(nearest_px, margin_px + 10) << "and not farther";
  }
}

TEST_F(FeatureTrackerTest, TracksThatComeToTheEdgeAreFollowed) {
  options_.border_px = 60;
  FeatureTracker tracker(options_);
  double nearest_px = 1000;
  for (int i = 0; i < simulator_.frames(); ++i) {
    for (const Track& track :
         tracker.track(images_[static_cast<std::size_t>(i)], simulator_.camera(), motion_, simulator_.exposure(i))) {
      const Eigen::Vector2d& at = track.pixel_px;
      nearest_px = std::min({nearest_px, at.x(), at.y(), 319 - at.x(), 239 - at.y()});
    }
  }
  EXPECT_LT(nearest_px, 15);
}

TEST_F(FeatureTrackerTest, RefusesWhatDoesNotFit) {
  FeatureTracker tracker(options_);
  EXPECT_THROW(tracker.track(cv::Mat(10, 10, CV_8UC1), simulator_.camera(), motion_, simulator_.exposure(0)),
               std::invalid_argument);
  EXPECT_THROW(tracker.track(cv::Mat(240, 320, CV_8UC3), simulator_.camera(), motion_, simulator_.exposure(0)),
               std::invalid_argument);
  TrackerOptions even;
  even.window_px = 20;
  EXPECT_THROW(tracker.set_options(even), OptionError);
  EXPECT_THROW(FeatureTracker{even}, OptionError);
}

// At twice the sensor's rate, and for the first time where the picture was not tracked.
TEST_F(FeatureTrackerTest, RepeatedPictureHasTheTracksOfTheFirstTime) {
  FeatureTracker once(options_), again(options_);
  const auto same = [](const std::vector<Track>& a, const std::vector<Track>& b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const Track& x, const Track& y) {
      return x.id == y.id && x.length == y.length && x.pixel_px == y.pixel_px && x.normalized == y.normalized &&
             x.velocity_1_s == y.velocity_1_s;
    });
  };
  for (int i = 0; i < simulator_.frames(); ++i) {
    const cv::Mat& image = images_[static_cast<std::size_t>(i)];
    const RowExposure exposure = simulator_.exposure(i);
    const std::vector<Track> expected = once.track(image, simulator_.camera(), motion_, exposure);
    if (i != 5) {
      EXPECT_TRUE(same(again.track(image, simulator_.camera(), motion_, exposure), expected)) << i;
    }
    EXPECT_TRUE(same(again.track(image, simulator_.camera(), motion_, exposure, nullptr, true), expected)) << i;
  }
}

}  // namespace
}  // namespace gyro_deblur::feature_tracker_test
