// Wrong units, sensors and clocks of a simulated camera: what is reported, what becomes of the frames, and that
// drop_poor drops none that is good.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "faults.hpp"
#include "gyro_deblur/config.hpp"
#include "replay.hpp"

namespace gyro_deblur::test {
namespace {

constexpr TimeNs kSecond = 1'000'000'000;
constexpr double kDegrees = 180 / M_PI;

/// The scene of the fault table, rotating by `factor` times as much.
Recording recording_of(double factor) {
  namespace fs = std::filesystem;
  std::string pattern = (fs::temp_directory_path() / "input_faults_XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no folder for the scene");
  const fs::path folder = pattern;
  std::ofstream(folder / "scene.yaml") << R"(
frames: 60
seed: 3
camera: {size: [192, 144], intrinsics: [190, 190, 95.5, 71.5], distortion_model: none, fps: 30, exposure_time: 0.020,
         readout_time: 0.015, encoding: mono8, noise: 1.5}
imu: {rate: 200, gyro_noise: 0.003, time_offset: 0.004}
planes:
  - {texture: procedural, texture_seed: 11, texture_size: [1600, 1200], size: [9.6, 7.2], position: [0, 0, 2]}
motion:
  type: curve
  rotation:
    sines:
      - {amplitude: [)" << 9 * factor << ", "
                                       << 4 * factor << ", " << 3 * factor << R"(], frequency: 1.9, phase: 20}
      - {amplitude: [)" << -3 * factor << ", "
                                       << 10 * factor << ", " << 5 * factor << R"(], frequency: 1.3, phase: 100}
)";
  Recording recording((folder / "scene.yaml").string(), 2);
  fs::remove_all(folder);
  return recording;
}

class InputFaultsTest : public testing::Test {
 protected:
  InputFaultsTest() {
    options_.config = load_known_config(std::string(GYRO_DEBLUR_SOURCE_DIR) + "/test/faults/config.yaml");
    options_.config.gyro.range_rad_s = 0;
    options_.config.drop_poor = true;
  }
  void play(const std::vector<Delivery>& deliveries, const Recording& recording = fast()) {
    result_ = replay(recording, deliveries, options_);
    EXPECT_EQ(result_.statistics.dropped_poor, 0u) << "drop_poor";
    EXPECT_EQ(result_.statistics.frames_out, recording.frames());
  }
  std::string problem(const std::string& kind) const {
    const auto found = result_.statistics.input_problems.find(kind);
    return found == result_.statistics.input_problems.end() ? "" : found->second.text;
  }
  std::size_t passed_through(PassThroughReason reason) const {
    const auto found = result_.statistics.passed_through.find(reason);
    return found == result_.statistics.passed_through.end() ? 0 : found->second;
  }
  static const Recording& fast() {
    static const Recording recording = recording_of(1);
    return recording;
  }
  /// Rotates at up to 0.5 rad/s: in degrees/s these are rates that a gyroscope can have.
  static const Recording& slow() {
    static const Recording recording = recording_of(0.2);
    return recording;
  }

  ReplayOptions options_;
  ReplayResult result_;
};

TEST_F(InputFaultsTest, WithoutAFaultNothingIsReported) {
  for (const Recording* recording : {&fast(), &slow()}) {
    play(recording->deliveries(), *recording);
    for (const auto& [kind, problem] : result_.statistics.input_problems) ADD_FAILURE() << kind << ": " << problem.text;
    EXPECT_TRUE(result_.statistics.passed_through.empty());
  }
}

TEST_F(InputFaultsTest, DegreesAreFoundByWhatNoGyroscopeMeasures) {
  play(scale_rates(fast().deliveries(), kDegrees));
  EXPECT_NE(problem("imu unit").find("are they in degrees/s"), std::string::npos) << problem("imu unit");
}

TEST_F(InputFaultsTest, DegreesAreFoundByTheImages) {
  play(scale_rates(slow().deliveries(), kDegrees), slow());
  EXPECT_EQ(problem("imu unit"), "");
  EXPECT_NE(problem("imu unit by images").find("while the images rotate by"), std::string::npos)
      << problem("imu unit by images");
  EXPECT_NE(problem("imu unit by images").find("are they in degrees/s"), std::string::npos);
}

TEST_F(InputFaultsTest, AccelerometerInPlaceOfTheGyroscopeIsFoundByTheImages) {
  play(scale_rates(fast().deliveries(), 0));
  EXPECT_NE(problem("imu unit by images").find("all rates of the IMU are 0"), std::string::npos)
      << problem("imu unit by images");
}

TEST_F(InputFaultsTest, SlowImu) {
  play(thin_out(fast().deliveries(), Stream::IMU, 20));
  EXPECT_NE(problem("imu rate").find("come every 0.1 s, and max_gyro_gap is 0.05 s"), std::string::npos)
      << problem("imu rate");
  EXPECT_EQ(passed_through(PassThroughReason::NO_GYRO), fast().frames());
}

TEST_F(InputFaultsTest, WrongStampsAreNoSlowImu) {
  for (unsigned seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    play(inject(fast().deliveries(), Stream::IMU, Fault::TIME_JUMP, 0.5, seed));
    EXPECT_EQ(problem("imu rate"), "");
    EXPECT_LE(passed_through(PassThroughReason::NO_GYRO), fast().frames() / 10);
  }
}

TEST_F(InputFaultsTest, ClocksYearsApart) {
  constexpr TimeNs kYears = 50 * 31'536'000 * kSecond;
  const std::vector<Delivery> apart = shift_clock(fast().deliveries(), Stream::IMU, kYears);
  play(apart);
  EXPECT_NE(problem("clocks").find("time_offset: 15768"), std::string::npos) << problem("clocks");
  options_.config.gyro.time_offset_ns += kYears;
  play(apart);
  EXPECT_EQ(problem("clocks"), "");
  EXPECT_TRUE(result_.statistics.passed_through.empty());
  EXPECT_EQ(result_.mispredicted, 0u);
}

TEST_F(InputFaultsTest, ExposureAboveTheFramePeriod) {
  play(set_exposures(fast().deliveries(), kSecond / 5, fast().deliveries().size()));
  EXPECT_NE(problem("exposure").find("0.2 s is longer than the frame period"), std::string::npos)
      << problem("exposure");
  EXPECT_EQ(passed_through(PassThroughReason::NO_EXPOSURE_TIME) + passed_through(PassThroughReason::NO_GYRO),
            fast().frames());
  options_.config.shutter.exposure_ns = kSecond / 5;
  for (const OnExposureConflict policy : {OnExposureConflict::CONFIGURED, OnExposureConflict::IMAGES}) {
    options_.config.on_exposure_conflict = policy;
    play(silence(fast().deliveries(), Stream::EXPOSURE, 0, fast().end_ns() + 1));
    EXPECT_NE(problem("exposure_time").find("exposure_time = 0.2 s is longer"), std::string::npos)
        << problem("exposure_time");
    const std::size_t refused = passed_through(PassThroughReason::BAD_CONFIGURATION);
    const std::size_t waiting =
        passed_through(PassThroughReason::NO_EXPOSURE_TIME) + passed_through(PassThroughReason::NO_GYRO);
    if (policy == OnExposureConflict::CONFIGURED) {
      EXPECT_EQ(refused + waiting, fast().frames());
      EXPECT_GT(refused, fast().frames() / 2);
    } else {
      EXPECT_EQ(refused, 0u);
      EXPECT_LT(waiting, fast().frames() / 4) << "the images have it";
      EXPECT_LE(result_.mispredicted, fast().frames() / 20);
    }
  }
}

TEST_F(InputFaultsTest, ExposureOfZeroAtFirst) {
  play(set_exposures(fast().deliveries(), 0, 10));
  EXPECT_FALSE(problem("exposure 0").empty());
  EXPECT_TRUE(result_.statistics.passed_through.empty()) << "the parameter has it";
  EXPECT_EQ(result_.mispredicted, 0u);
}

}  // namespace
}  // namespace gyro_deblur::test
