// Pictures that come again under a new stamp, freeze or jump, from messages to messages.
#include <algorithm>
#include <cstdio>
#include <functional>
#include <future>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "processor_test.hpp"
#include "repeated_pictures.hpp"

namespace gyro_deblur::repeated_pictures_test {
namespace {

// What processor_test.hpp has of a camera of its own is not used here.
using test::camera_info;
using test::HandheldCamera;
using test::kMs;
using test::kSecond;
using test::Shot;

constexpr double kToleranceDb = 0.2;

const HandheldCamera& handheld() {
  static const HandheldCamera camera;
  return camera;
}

Config config_of(const sim::Scene& scene) {
  Config config;
  config.shutter = scene.timing(0);
  config.R_cam_imu = Eigen::Matrix3d::Identity();
  config.pipeline.blur_field.block_size_px = 32;
  return config;
}

/// Plays what a camera publishes into a processor.
class Player {
 public:
  explicit Player(const HandheldCamera& camera, FrameRequest request = {true, false},
                  std::shared_ptr<StereoCamera> stereo = nullptr)
      : config(config_of(camera.simulator().scene())), camera_(camera), request_(std::move(request)) {
    Processor::Environment environment;
    environment.clock = [this] { return now_ns_; };
    environment.steady_clock = environment.clock;
    environment.log = [this](LogLevel level, const std::string& text) {
      if (level != LogLevel::INFO) warnings.push_back(text);
    };
    environment.request = [this] { return request_; };
    environment.stereo = std::move(stereo);
    processor_ = std::make_unique<Processor>(std::move(environment));
  }

  const std::vector<FrameOutput>& play(const std::vector<Shot>& shots) {
    processor_->set_config(config);
    const std::vector<sim::ImuSample> imu = camera_.simulator().imu();
    auto sample = imu.begin();
    for (const Shot& shot : shots) {
      now_ns_ = shot.stamp_ns + config.shutter.exposure_ns + config.shutter.readout_ns;
      for (; sample != imu.end() && sample->t_ns <= now_ns_; ++sample) add(*sample);
      processor_->add_image(message_of(shot));
      processor_->add_camera_info(info_at(shot.stamp_ns));
      do {
        processor_->advance([this](FrameOutput&& output) { return take(std::move(output)); });
      } while (processor_->awaited() == Awaited::STEREO_PARTNER && processor_->wait(std::chrono::milliseconds(1)));
    }
    for (; sample != imu.end(); ++sample) add(*sample);
    processor_->finish([this](FrameOutput&& output) { return take(std::move(output)); });
    EXPECT_EQ(outputs.size(), shots.size());
    for (std::size_t k = 0; k < outputs.size(); ++k) {
      const FrameOutput& output = outputs[k];
      EXPECT_EQ(output.input->header.stamp, to_ros_time(shots[k].stamp_ns));
      if (!output.dropped) {
        EXPECT_EQ(output.image->header.stamp, output.input->header.stamp);
      }
      EXPECT_EQ(output.blur_field->header.stamp, output.input->header.stamp);
    }
    return outputs;
  }

  /// Warnings that speak of repeated pictures.
  std::size_t reported() const {
    return static_cast<std::size_t>(std::count_if(warnings.begin(), warnings.end(), [](const std::string& text) {
      return text.find("images repeat the picture before") != std::string::npos;
    }));
  }
  ProcessorStatistics statistics() const { return processor_->statistics(); }

  Config config;
  TimeNs at_rest_until_ns = 0;  // of the gyroscope
  std::vector<std::string> warnings;
  std::vector<FrameOutput> outputs;

 private:
  bool take(FrameOutput&& output) {
    outputs.push_back(std::move(output));
    return true;
  }
  void add(sim::ImuSample sample) {
    if (sample.t_ns < at_rest_until_ns) sample.rate_rad_s.setZero();
    sensor_msgs::Imu imu;
    imu.header.stamp = to_ros_time(sample.t_ns);
    imu.header.frame_id = test::kImuFrame;
    imu.angular_velocity.x = sample.rate_rad_s.x();
    imu.angular_velocity.y = sample.rate_rad_s.y();
    imu.angular_velocity.z = sample.rate_rad_s.z();
    processor_->add_imu(imu);
  }
  static sensor_msgs::ImageConstPtr message_of(const Shot& shot) {
    sensor_msgs::Image like;
    like.header.stamp = to_ros_time(shot.stamp_ns);
    like.header.frame_id = test::kCameraFrame;
    like.encoding = "mono8";
    return to_image(shot.pixels, like);
  }
  sensor_msgs::CameraInfoPtr info_at(TimeNs stamp_ns) const {
    const CameraCalibration& calibration = camera_.simulator().camera().calibration();
    sensor_msgs::CameraInfoPtr info = camera_info(stamp_ns, calibration.width_px, calibration.height_px);
    info->K = {calibration.fx_px, 0, calibration.cx_px, 0, calibration.fy_px, calibration.cy_px, 0, 0, 1};
    return info;
  }

  const HandheldCamera& camera_;
  const FrameRequest request_;
  TimeNs now_ns_ = 0;
  std::unique_ptr<Processor> processor_;
};

/// Mean PSNR [dB] of what leaves for the new pictures among `shots`, of those that `wanted` names.
template <typename Wanted>
double psnr_db(const HandheldCamera& camera, const std::vector<Shot>& shots, const std::vector<FrameOutput>& outputs,
               Wanted wanted) {
  double sum_db = 0;
  int count = 0;
  for (std::size_t k = 0; k < shots.size(); ++k) {
    if (shots[k].repeats || !wanted(shots[k].picture)) continue;
    sum_db += camera.psnr_db(view_image(*outputs[k].image).image, shots[k].picture);
    ++count;
  }
  return sum_db / count;
}
bool every(int) { return true; }

/// Images in which every picture comes when it should.
class RepeatedPictures : public testing::Test {
 protected:
  static const std::vector<FrameOutput>& clean() {
    static Player player(handheld());
    static const std::vector<FrameOutput>& outputs = player.play(handheld().every_picture());
    return outputs;
  }
  template <typename Wanted>
  static double clean_db(Wanted wanted) {
    return psnr_db(handheld(), handheld().every_picture(), clean(), wanted);
  }

  /// What is made of new pictures is what is made of them without the repetitions, and of a repetition what was made of
  /// its picture.
  static void expect_unmoved(const std::vector<Shot>& shots, const std::vector<FrameOutput>& outputs) {
    for (std::size_t k = 0; k < shots.size(); ++k) {
      const FrameOutput& expected = clean()[static_cast<std::size_t>(shots[k].picture)];
      EXPECT_EQ(outputs[k].reason, PassThroughReason::NONE) << outputs[k].reason_text;
      EXPECT_TRUE(outputs[k].image->data == expected.image->data) << "image " << k << ", repeats " << shots[k].repeats;
      EXPECT_EQ(outputs[k].blur_field->extent, expected.blur_field->extent);
      EXPECT_EQ(outputs[k].quality->score, expected.quality->score);
    }
  }
};

TEST_F(RepeatedPictures, CleanCameraIsDeblurredAndNothingIsReported) {
  Player player(handheld());
  const std::vector<Shot> shots = handheld().every_picture();
  player.play(shots);
  double blurred_db = 0;
  for (const Shot& shot : shots) blurred_db += handheld().psnr_db(shot.pixels, shot.picture) / handheld().frames();
  EXPECT_GT(clean_db(every), blurred_db + 2);
  EXPECT_EQ(player.statistics().repeated_pictures, 0u);
  EXPECT_TRUE(player.statistics().input_problems.empty());
  EXPECT_TRUE(player.warnings.empty());
}

TEST_F(RepeatedPictures, StampsAtTwiceTheSensorsRate) {
  const std::vector<Shot> shots = handheld().every_picture_twice();
  Player player(handheld());
  expect_unmoved(shots, player.play(shots));
  const ProcessorStatistics statistics = player.statistics();
  EXPECT_EQ(statistics.repeated_pictures, static_cast<std::size_t>(handheld().frames()));
  EXPECT_EQ(statistics.frame_period_ns, HandheldCamera::kPeriodNs);
  ASSERT_EQ(statistics.input_problems.count("repeated pictures"), 1u);
  EXPECT_TRUE(statistics.input_problems.at("repeated pictures").active);
  EXPECT_EQ(player.reported(), 1u) << "throttled";
  EXPECT_EQ(player.warnings.front().rfind("3 of 6 images repeat", 0), 0u) << player.warnings.front();
}

TEST_F(RepeatedPictures, EveryFifthComesAgain) {
  const std::vector<Shot> shots = handheld().every_picture([](int i) {
    return i % 5 == 4 ? std::vector<Shot>{handheld().repetition(i, HandheldCamera::kPeriodNs / 2)}
                      : std::vector<Shot>{};
  });
  Player player(handheld());
  expect_unmoved(shots, player.play(shots));
  EXPECT_EQ(player.reported(), 1u);
}

TEST_F(RepeatedPictures, EveryFifthIsReplacedByTheOneBefore) {
  const std::vector<Shot> shots = handheld().every_fifth_replaced();
  Player player(handheld());
  const std::vector<FrameOutput>& outputs = player.play(shots);
  const auto present = [](int i) { return i % 5 != 4; };
  EXPECT_NEAR(psnr_db(handheld(), shots, outputs, present), clean_db(present), kToleranceDb);
  for (std::size_t k = 4; k < shots.size(); k += 5) EXPECT_TRUE(outputs[k].image->data == outputs[k - 1].image->data);
  EXPECT_EQ(player.reported(), 1u);
}

TEST_F(RepeatedPictures, MessageThatComesTwiceIsTheSamePicture) {
  const std::vector<Shot> shots =
      handheld().every_picture([](int i) { return std::vector<Shot>{handheld().repetition(i, 0)}; });
  Player player(handheld());
  expect_unmoved(shots, player.play(shots));
}

TEST_F(RepeatedPictures, NothingGoodIsDroppedAndRepetitionsGoWithTheirPicture) {
  for (const double largest_px : {50.0, 5.0}) {
    Player clean_player(handheld());
    clean_player.config.drop_poor = true;
    clean_player.config.pipeline.blur_field.max_extent_px = largest_px;
    const std::vector<FrameOutput>& without = clean_player.play(handheld().every_picture());
    const auto dropped = [&](int picture) { return without[static_cast<std::size_t>(picture)].dropped; };
    const std::size_t count = clean_player.statistics().dropped_poor;
    EXPECT_EQ(count > 0, largest_px < 20);
    for (const std::vector<Shot>& shots : {handheld().every_picture_twice(), handheld().every_fifth_replaced()}) {
      Player player(handheld());
      player.config = clean_player.config;
      const std::vector<FrameOutput>& outputs = player.play(shots);
      for (std::size_t k = 0; k < shots.size(); ++k) {
        // After a gap of a picture optical flow is another.
        if (shots.size() == without.size() && shots[k].picture % 5 == 0 && count > 0) continue;
        EXPECT_EQ(outputs[k].dropped, dropped(shots[k].picture)) << "image " << k << " with " << largest_px << " px";
      }
    }
  }
}

TEST_F(RepeatedPictures, FrozenCameraKeepsItsPictureAndRecoversWithTheFirstNewOne) {
  constexpr int kFrozen = 10, kBack = 30;  // for a second
  std::vector<Shot> shots;
  for (int i = 0; i < handheld().frames(); ++i) {
    const bool frozen = i > kFrozen && i < kBack;
    shots.push_back(frozen ? handheld().repetition(kFrozen, (i - kFrozen) * HandheldCamera::kPeriodNs)
                           : handheld().shot(i));
  }
  Player player(handheld());
  const std::vector<FrameOutput>& outputs = player.play(shots);
  for (std::size_t k = kFrozen; k < kBack; ++k) {
    EXPECT_EQ(outputs[k].reason, PassThroughReason::NONE);
    EXPECT_TRUE(outputs[k].image->data == outputs[kFrozen].image->data) << k;
  }
  EXPECT_EQ(player.reported(), 1u);
  const auto first = [](int i) { return i == kBack; };
  const auto later = [](int i) { return i > kBack; };
  // The first one has no picture to be followed from: it goes by the gyroscope, as the first of all.
  Player by_gyroscope(handheld());
  by_gyroscope.config.pipeline.optical_flow = false;
  by_gyroscope.play(shots);
  EXPECT_NEAR(psnr_db(handheld(), shots, outputs, first), psnr_db(handheld(), shots, by_gyroscope.outputs, first),
              1e-9);
  EXPECT_NEAR(psnr_db(handheld(), shots, outputs, later), clean_db(later), kToleranceDb);
}

// Longer than samples are kept.
TEST_F(RepeatedPictures, FrozenForLongerThanTheGyroscopesBuffer) {
  std::vector<Shot> shots;
  constexpr int kFrozen = 5;
  for (int i = 0; i <= kFrozen; ++i) shots.push_back(handheld().shot(i));
  for (int i = kFrozen + 1; i < handheld().frames(); ++i) {
    shots.push_back(handheld().repetition(kFrozen, (i - kFrozen) * HandheldCamera::kPeriodNs));
  }
  Player player(handheld());
  player.config.gyro.buffer_ns = kSecond / 2;
  const std::vector<FrameOutput>& outputs = player.play(shots);
  for (std::size_t k = kFrozen; k < shots.size(); ++k) {
    EXPECT_EQ(outputs[k].reason, PassThroughReason::NONE) << outputs[k].reason_text;
    EXPECT_TRUE(outputs[k].image->data == outputs[kFrozen].image->data);
  }
}

TEST_F(RepeatedPictures, CameraThatDropsToHalfItsRate) {
  std::vector<Shot> shots;
  for (int i = 0; i < handheld().frames(); ++i) {
    if (i < 10 || i % 2 == 0) shots.push_back(handheld().shot(i));
  }
  Player player(handheld()), by_gyroscope(handheld());
  by_gyroscope.config.pipeline.optical_flow = false;
  const auto slow = [](int i) { return i >= 10 && i % 2 == 0; };
  const double by_both_db = psnr_db(handheld(), shots, player.play(shots), slow);
  EXPECT_GT(by_both_db, psnr_db(handheld(), shots, by_gyroscope.play(shots), slow) - kToleranceDb);
  EXPECT_GT(by_both_db, clean_db(slow) - 2 * kToleranceDb);
  EXPECT_EQ(player.reported(), 0u);
  EXPECT_EQ(player.statistics().repeated_pictures, 0u);
}

/// The picture is that of another camera, or of another instant, from one image to the next.
class Cut : public RepeatedPictures {
 protected:
  /// By the images, too, less by the gyroscope alone, for the two images from the cut on [dB].
  /// @param undo  rotates an image back to where the truth is known
  static double gain_db(const std::function<cv::Mat(const cv::Mat&)>& change,
                        const std::function<cv::Mat(const cv::Mat&)>& undo) {
    constexpr int kCut = 20;
    std::vector<Shot> shots = handheld().every_picture();
    for (std::size_t i = kCut; i < shots.size(); ++i) shots[i].pixels = change(shots[i].pixels);
    const auto db_of = [&](bool by_images) {
      Player player(handheld());
      player.config.pipeline.optical_flow = by_images;
      const std::vector<FrameOutput>& outputs = player.play(shots);
      double sum_db = 0;
      for (const int i : {kCut, kCut + 1}) {
        const FrameOutput& output = outputs[static_cast<std::size_t>(i)];
        sum_db += handheld().psnr_db(undo(view_image(*output.image).image), i);
      }
      return sum_db / 2;
    };
    return db_of(true) - db_of(false);
  }
};

TEST_F(Cut, SceneThatChangesCompletelyDoesNotContradictTheGyroscope) {
  const auto upside_down = [](const cv::Mat& image) {
    cv::Mat rotated;
    cv::flip(image, rotated, -1);
    return rotated;
  };
  EXPECT_GT(gain_db(upside_down, upside_down), -kToleranceDb);
}

// An image that is cropped otherwise, or a camera that is knocked: optical flow is as far off as the jump.
TEST_F(Cut, SceneThatJumpsDoesNotContradictTheGyroscope) {
  for (const int step_px : {6, 12, 24, 36, 48}) {
    const auto moved = [](const cv::Mat& image, int columns) {
      cv::Mat both;
      cv::hconcat(image, image, both);
      return cv::Mat(both.colRange(columns, columns + image.cols).clone());
    };
    const auto change = [&](const cv::Mat& image) { return moved(image, step_px); };
    const auto undo = [&](const cv::Mat& image) { return moved(image, image.cols - step_px); };
    const double gain = gain_db(change, undo);
    std::printf("%d px: %.2f dB\n", step_px, gain);
    EXPECT_GT(gain, -kToleranceDb) << step_px << " px";
  }
}

// Simulated, or compressed. Then it begins to move.
TEST_F(RepeatedPictures, SceneAtRestWithoutNoiseStaysAsItIs) {
  constexpr int kAtRest = 20;
  std::vector<Shot> shots;
  const cv::Mat sharp = handheld().sharp(0);
  for (int i = kAtRest - 1; i >= 0; --i) {
    shots.push_back({sharp, handheld().simulator().stamp(0) - i * HandheldCamera::kPeriodNs, 0, i + 1 < kAtRest});
  }
  for (int i = 1; i < handheld().frames(); ++i) shots.push_back(handheld().shot(i));
  Player player(handheld());
  player.config.drop_poor = true;
  player.at_rest_until_ns = handheld().simulator().stamp(0) + HandheldCamera::kPeriodNs / 2;
  const std::vector<FrameOutput>& outputs = player.play(shots);
  for (int i = 0; i < kAtRest; ++i) EXPECT_EQ(outputs[static_cast<std::size_t>(i)].image, outputs[i].input) << i;
  EXPECT_EQ(player.reported(), 0u);
  EXPECT_EQ(player.statistics().dropped_poor, 0u);
  const auto moving = [](int i) { return i > 3; };
  EXPECT_NEAR(psnr_db(handheld(), shots, outputs, moving), clean_db(moving), kToleranceDb);
}

TEST_F(RepeatedPictures, TracksAreWhereTheyWereAndAsFast) {
  FrameRequest request{true, true};
  request.tracks = true;
  Player player(handheld(), request), clean_player(handheld(), request);
  player.config.pipeline.keypoints.detector = "FAST";
  player.config.pipeline.keypoints.descriptor = "ORB";
  clean_player.config = player.config;
  const std::vector<Shot> shots = handheld().every_picture_twice();
  const std::vector<FrameOutput>& outputs = player.play(shots);
  const std::vector<FrameOutput>& expected = clean_player.play(handheld().every_picture());
  for (std::size_t k = 0; k < shots.size(); ++k) {
    const FrameOutput& clean = expected[static_cast<std::size_t>(shots[k].picture)];
    ASSERT_NE(outputs[k].tracks, nullptr);
    EXPECT_EQ(outputs[k].tracks->header.stamp, outputs[k].input->header.stamp);
    EXPECT_TRUE(outputs[k].tracks->points == clean.tracks->points) << k;
    EXPECT_TRUE(outputs[k].tracks->channels == clean.tracks->channels) << "ids, velocities, covariances of " << k;
    // Keypoints hold as long after their image's stamp as after their picture's.
    EXPECT_EQ(outputs[k].keypoints->reference_time - outputs[k].keypoints->header.stamp,
              clean.keypoints->reference_time - clean.keypoints->header.stamp);
  }
}

TEST_F(RepeatedPictures, GlobalShutterStampsGrow) {
  FrameRequest request{true, false};
  request.global_shutter = true;
  Player player(handheld(), request);
  const std::vector<FrameOutput>& outputs = player.play(handheld().every_picture_twice());
  for (std::size_t k = 0; k < outputs.size(); ++k) {
    ASSERT_NE(outputs[k].global_shutter, nullptr) << k;
    if (k == 0) continue;
    EXPECT_GT(outputs[k].global_shutter->header.stamp, outputs[k - 1].global_shutter->header.stamp);
  }
}

TEST_F(RepeatedPictures, ChangedParametersHoldForRepetitions) {
  // The noise-to-signal ratio, with regularization: fixed, changes between a picture and its repetition.
  Player player(handheld());
  const std::vector<Shot> shots = handheld().every_picture_twice();
  player.play({shots.begin(), shots.begin() + 12});
  const auto before = player.outputs.back().image->data;
  player.outputs.clear();
  player.config.pipeline.filter.regularization = Regularization::FIXED;
  player.config.pipeline.filter.noise_to_signal_ratio = 0.5;
  player.play({handheld().repetition(5, HandheldCamera::kPeriodNs)});
  EXPECT_FALSE(player.outputs.back().image->data == before);
}

/// A pair whose left camera publishes every picture twice, and the right one only new ones, at the same stamps.
TEST_F(RepeatedPictures, StereoPartnersOfRepetitionsAreDeblurred) {
  const auto rig = std::make_shared<StereoRig>();
  std::vector<Shot> left, right;
  for (int i = 0; i + 1 < handheld().frames(); ++i) {
    right.push_back(handheld().shot(i));
    left.push_back(i % 2 == 0 ? handheld().shot(i) : handheld().repetition(i - 1, HandheldCamera::kPeriodNs));
  }
  for (const bool drop_poor : {false, true}) {
    std::vector<std::unique_ptr<Player>> players;
    for (const char* name : {"/left", "/right"}) {
      players.push_back(
          std::make_unique<Player>(handheld(), FrameRequest{true, false}, std::make_shared<StereoCamera>(rig, name)));
      players.back()->config.stereo_sync_timeout_ns = 10 * kSecond;  // longer than any frame takes
      players.back()->config.drop_poor = drop_poor;
    }
    auto other = std::async(std::launch::async, [&] { players[1]->play(right); });
    players[0]->play(left);
    other.get();
    for (const auto& player : players) {
      EXPECT_EQ(player->statistics().dropped_poor, 0u);
      for (const FrameOutput& output : player->outputs) {
        EXPECT_EQ(output.reason, PassThroughReason::NONE) << output.reason_text;
      }
    }
    for (std::size_t k = 0; k < right.size(); ++k) {
      EXPECT_TRUE(players[1]->outputs[k].image->data == clean()[k].image->data) << k;
      if (left[k].repeats) {
        EXPECT_TRUE(players[0]->outputs[k].image->data == players[0]->outputs[k - 1].image->data) << k;
      }
    }
    EXPECT_EQ(players[1]->reported(), 0u);
    EXPECT_EQ(players[0]->reported(), 1u);
  }
}

}  // namespace
}  // namespace gyro_deblur::repeated_pictures_test
