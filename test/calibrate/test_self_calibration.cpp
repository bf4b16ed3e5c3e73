// Learning rotation, time offset and bias from rates whose truth is analytic.
#include <cmath>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "calibrate/self_calibration.hpp"
#include "timing_truth.hpp"

namespace gyro_deblur::self_calibration_test {
namespace {

using namespace test;

/// A rate of the camera: sums of sines, whose integrals are exact.
struct Rotating {
  struct Sine {
    Eigen::Vector3d amplitude_rad_s;
    double frequency_hz, phase_rad;
  };
  std::vector<Sine> sines;

  Eigen::Vector3d rate(double t_s) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Sine& each : sines) {
      sum += each.amplitude_rad_s * std::sin(2 * M_PI * each.frequency_hz * t_s + each.phase_rad);
    }
    return sum;
  }
  Eigen::Vector3d mean_rate(double from_s, double to_s) const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Sine& each : sines) {
      const double w = 2 * M_PI * each.frequency_hz;
      sum += each.amplitude_rad_s * (std::cos(w * from_s + each.phase_rad) - std::cos(w * to_s + each.phase_rad)) / w;
    }
    return sum / (to_s - from_s);
  }
};

/// A hand's: no frequency is a multiple of another.
Rotating hand_held() {
  return {{{{0.5, 0.2, 0.1}, 0.37, 0.4},
           {{-0.1, 0.6, 0.2}, 0.83, 1.9},
           {{0.2, -0.3, 0.4}, 1.71, 0.2},
           {{0.1, 0.2, -0.2}, 2.93, 5.1}}};
}

Rotating about_one_axis() { return {{{{0, 0.5, 0}, 0.37, 0.4}, {{0, 0.4, 0}, 0.83, 1.9}, {{0, 0.3, 0}, 1.71, 0.2}}}; }

struct Recording {
  Truth truth{0, 0, {0.01, -0.03, 0.02}, rotation({2.2, -1.1, 0.4})};
  Rotating camera;         ///< by which images and gyroscope rotate
  Rotating apparent;       ///< of the images alone: translation
  double gyro_factor = 1;  ///< of a wrong unit
  double noise_rad_s = 0.03, gyro_noise_rad_s = 0.005;
  double outliers = 0;       ///< share of the images
  double speed_rad_s = 0.3;  ///< of the points
  double readout_s = 0;
  double focal_length = 0;  ///< of a lens that is not known; 0: it is known
  unsigned seed = 1;
};

/// How the rows of a rolling shutter disturb the rate of an image, see ImageRate: another for each image.
Eigen::Matrix3d by_rows(double t_s) {
  Eigen::Matrix3d m;
  m << 0.02, 0.1, 0.05, -0.15, 0, 0.1, 0.05, 0.4, 0.1;
  return (1 + 0.5 * std::sin(7 * t_s)) * m;
}

constexpr double kFrameS = 0.05, kSampleS = 0.005;

/// Plays a recording, and updates whenever that is due.
void play(const Recording& recording, double from_s, double to_s, SelfCalibration* calibration,
          const std::function<void(double)>& on_update = {}) {
  std::mt19937 random(recording.seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-3, 3), share(0, 1);
  const auto noise = [&](double stddev) {
    return Eigen::Vector3d(stddev * normal(random), stddev * normal(random), stddev * normal(random));
  };
  const double offset_s = to_seconds(recording.truth.time_offset_ns);
  double sample_s = from_s;  // camera clock
  for (double t_s = from_s; t_s + kFrameS <= to_s; t_s += kFrameS) {
    for (; sample_s <= t_s + kFrameS; sample_s += kSampleS) {
      const Eigen::Vector3d rate_rad_s = recording.truth.R_cam_imu.transpose() * recording.camera.rate(sample_s);
      calibration->add_sample(
          {to_ns(sample_s + offset_s),
           recording.gyro_factor * (rate_rad_s + recording.truth.bias_rad_s + noise(recording.gyro_noise_rad_s))});
    }
    ImageRate rate{to_ns(t_s), to_ns(t_s + kFrameS), {}, recording.noise_rad_s, recording.speed_rad_s};
    rate.rate_rad_s = recording.camera.mean_rate(t_s, t_s + kFrameS) + noise(recording.noise_rad_s) +
                      recording.apparent.mean_rate(t_s, t_s + kFrameS);
    const double half_s = recording.readout_s / 2;
    rate.by_rows = by_rows(t_s);
    rate.rate_rad_s += rate.by_rows * (recording.camera.mean_rate(t_s + half_s, t_s + kFrameS + half_s) -
                                       recording.camera.mean_rate(t_s - half_s, t_s + kFrameS - half_s));
    if (share(random) < recording.outliers) {
      rate.rate_rad_s = Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
    }
    if (recording.focal_length > 0) {
      const Eigen::DiagonalMatrix<double, 3> scale(recording.focal_length, recording.focal_length, 1);
      rate.rate_rad_s = scale * rate.rate_rad_s;
      rate.by_rows = scale * rate.by_rows * scale.inverse();
      rate.lens_known = false;
      rate.larger_side_px = 752;
    }
    calibration->add_rate(rate);
    if (!calibration->is_due()) continue;
    calibration->update();
    if (on_update) on_update(t_s + kFrameS);
  }
}

double rotation_error_deg(const LearnedCalibration& learned, const Truth& truth) {
  return Eigen::AngleAxisd(Eigen::Matrix3d(learned.R_cam_imu.value.transpose() * truth.R_cam_imu)).angle() / kDeg;
}

double offset_error_ms(const LearnedCalibration& learned, const Truth& truth) {
  return 1e3 * std::abs(learned.time_offset_s.value - to_seconds(truth.time_offset_ns));
}

TEST(SelfCalibration, LearnsFromNoisyRatesWithOutliers) {
  for (const TimeNs offset_ns : {0, 4'000'000, -87'000'000, 312'000'000, -441'000'000}) {
    for (const double outliers : {0.0, 0.2}) {
      Recording recording;
      recording.camera = hand_held();
      recording.truth.time_offset_ns = offset_ns;
      recording.outliers = outliers;
      recording.seed = static_cast<unsigned>(offset_ns / 1'000'000 + 1000);
      SelfCalibration calibration;
      play(recording, 100, 115, &calibration);
      SCOPED_TRACE(std::to_string(offset_ns) + " ns, outliers " + std::to_string(outliers));
      const LearnedCalibration& learned = calibration.learned();
      ASSERT_TRUE(learned.R_cam_imu.known) << learned.R_cam_imu.missing;
      ASSERT_TRUE(learned.time_offset_s.known) << learned.time_offset_s.missing;
      ASSERT_TRUE(learned.bias_rad_s.known) << learned.bias_rad_s.missing;
      EXPECT_LT(rotation_error_deg(learned, recording.truth), 1);
      EXPECT_LT(offset_error_ms(learned, recording.truth), 2);
      EXPECT_LT((learned.bias_rad_s.value - recording.truth.bias_rad_s).norm(), 0.01);
      // The standard deviations are those of the errors.
      EXPECT_LT(rotation_error_deg(learned, recording.truth) * kDeg, 4 * learned.R_cam_imu.stddev);
      EXPECT_LT(1e-3 * offset_error_ms(learned, recording.truth), 4 * learned.time_offset_s.stddev);
    }
  }
}

TEST(SelfCalibration, KnowsWithinSecondsOfMotion) {
  Recording recording;
  recording.camera = hand_held();
  recording.truth.time_offset_ns = 120'000'000;
  SelfCalibration calibration;
  double known_s = 0;
  play(recording, 0, 15, &calibration, [&](double t_s) {
    if (known_s == 0 && calibration.learned().R_cam_imu.known) known_s = t_s;
  });
  ASSERT_GT(known_s, 0);
  EXPECT_LE(known_s, 5);
}

TEST(SelfCalibration, LearnsTheOffsetAloneFromRotatingAboutOneAxis) {
  Recording recording;
  recording.camera = about_one_axis();
  recording.truth.time_offset_ns = -60'000'000;
  SelfCalibration calibration;
  play(recording, 0, 15, &calibration);
  const LearnedCalibration& learned = calibration.learned();
  ASSERT_TRUE(learned.time_offset_s.known) << learned.time_offset_s.missing;
  EXPECT_LT(offset_error_ms(learned, recording.truth), 2);
  EXPECT_FALSE(learned.R_cam_imu.known);
  EXPECT_NE(learned.R_cam_imu.missing.find("about one axis only, left and right (about y)"), std::string::npos)
      << learned.R_cam_imu.missing;
  EXPECT_FALSE(learned.bias_rad_s.known);
}

TEST(SelfCalibration, LearnsNothingFromTranslation) {
  Recording recording;  // the camera does not rotate, and images move
  recording.apparent = hand_held();
  SelfCalibration calibration;
  play(recording, 0, 30, &calibration);
  const LearnedCalibration& learned = calibration.learned();
  EXPECT_FALSE(learned.R_cam_imu.known);
  EXPECT_FALSE(learned.time_offset_s.known);
  EXPECT_FALSE(learned.bias_rad_s.known);
  EXPECT_NE(learned.R_cam_imu.missing.find("rotate it"), std::string::npos) << learned.R_cam_imu.missing;
}

TEST(SelfCalibration, LearnsNothingFromMotionsThatHaveNothingInCommon) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> frequency(0.2, 3), phase(0, 2 * M_PI), amplitude(-0.4, 0.4);
  const auto any = [&] {
    Rotating rotating;
    for (int i = 0; i < 6; ++i) {
      rotating.sines.push_back(
          {{amplitude(random), amplitude(random), amplitude(random)}, frequency(random), phase(random)});
    }
    return rotating;
  };
  int learned = 0;
  for (int i = 0; i < 20; ++i) {
    Recording recording;
    recording.camera = any();
    recording.apparent = any();
    for (Rotating::Sine sine : recording.camera.sines) {  // the images do not rotate with the camera
      sine.amplitude_rad_s *= -1;
      recording.apparent.sines.push_back(sine);
    }
    SelfCalibration calibration;
    play(recording, 0, 20, &calibration, [&](double) { learned += calibration.learned().time_offset_s.known ? 1 : 0; });
  }
  EXPECT_EQ(learned, 0);
}

TEST(SelfCalibration, LearnsDespiteTranslation) {
  Recording recording;
  recording.camera = hand_held();
  // A third of the motion, as in a room, and slower than the rotation.
  recording.apparent = {{{{0.15, 0.1, 0}, 0.21, 0.7}, {{-0.1, 0.15, 0}, 0.53, 2.9}}};
  recording.truth.time_offset_ns = 33'000'000;
  SelfCalibration calibration;
  play(recording, 0, 30, &calibration);
  const LearnedCalibration& learned = calibration.learned();
  ASSERT_TRUE(learned.R_cam_imu.known) << learned.R_cam_imu.missing;
  EXPECT_LT(rotation_error_deg(learned, recording.truth), 5);
  EXPECT_LT(offset_error_ms(learned, recording.truth), 10);
}

TEST(SelfCalibration, LearnsTheBiasOfACameraThatStandsStill) {
  Recording recording;
  recording.truth.time_offset_ns = 200'000'000;
  recording.noise_rad_s = 0.005;
  recording.speed_rad_s = 0.008;
  SelfCalibration calibration;
  play(recording, 0, 5, &calibration);
  const LearnedCalibration& learned = calibration.learned();
  ASSERT_TRUE(learned.bias_rad_s.known) << learned.bias_rad_s.missing;
  EXPECT_LT((learned.bias_rad_s.value - recording.truth.bias_rad_s).norm(), 0.002);
  EXPECT_FALSE(learned.R_cam_imu.known);
  EXPECT_FALSE(learned.time_offset_s.known);
}

TEST(SelfCalibration, MotionCorrectsABiasThatHasDriftedSinceItWasAtRest) {
  Recording recording;
  recording.noise_rad_s = recording.speed_rad_s = 0.005;
  SelfCalibration calibration;
  play(recording, 0, 5, &calibration);
  ASSERT_TRUE(calibration.learned().bias_rad_s.known);
  recording.camera = hand_held();
  recording.noise_rad_s = 0.03;
  recording.speed_rad_s = 0.3;
  recording.truth.bias_rad_s += Eigen::Vector3d(0.05, 0, -0.04);
  play(recording, 5, 90, &calibration);
  EXPECT_LT((calibration.learned().bias_rad_s.value - recording.truth.bias_rad_s).norm(), 0.02);
}

TEST(SelfCalibration, TakesNoRotationThatImagesDoNotShowForABias) {
  Recording recording;  // images of the camera's own mount, while it rotates
  recording.camera = hand_held();
  recording.apparent = recording.camera;
  for (Rotating::Sine& sine : recording.apparent.sines) sine.amplitude_rad_s *= -1;
  recording.noise_rad_s = recording.speed_rad_s = 0.005;
  SelfCalibration calibration;
  play(recording, 0, 10, &calibration);
  EXPECT_FALSE(calibration.learned().bias_rad_s.known);
}

TEST(SelfCalibration, RefusesAnOffsetBeyondTheSearch) {
  Recording recording;
  recording.camera = hand_held();
  recording.truth.time_offset_ns = 900'000'000;
  SelfCalibration calibration;
  int learned = 0;
  play(recording, 0, 30, &calibration, [&](double) { learned += calibration.learned().time_offset_s.known ? 1 : 0; });
  EXPECT_EQ(learned, 0);
  EXPECT_NE(calibration.learned().time_offset_s.missing.find("within 0.5 s of 0 s"), std::string::npos)
      << calibration.learned().time_offset_s.missing;

  SelfCalibration centered(1'000'000'000);
  play(recording, 0, 15, &centered);
  ASSERT_TRUE(centered.learned().time_offset_s.known) << centered.learned().time_offset_s.missing;
  EXPECT_LT(offset_error_ms(centered.learned(), recording.truth), 2);
}

TEST(SelfCalibration, SaysThatClocksAreFarApart) {
  Recording recording;
  recording.camera = hand_held();
  recording.truth.time_offset_ns = -1'000'000'000'000;
  SelfCalibration calibration;
  play(recording, 2000, 2010, &calibration);
  EXPECT_FALSE(calibration.learned().time_offset_s.known);
  EXPECT_NE(calibration.learned().time_offset_s.missing.find("set time_offset to about -1000"), std::string::npos)
      << calibration.learned().time_offset_s.missing;
}

TEST(SelfCalibration, RefusesMotionThatRepeatsItself) {
  Recording recording;
  recording.camera = {{{{0.5, 0.1, 0}, 2.5, 0.4}, {{0.1, 0.6, 0.2}, 2.5, 1.9}}};
  recording.truth.time_offset_ns = 50'000'000;
  SelfCalibration calibration;
  play(recording, 0, 20, &calibration);
  EXPECT_FALSE(calibration.learned().time_offset_s.known);
  EXPECT_NE(calibration.learned().time_offset_s.missing.find("repeats itself"), std::string::npos)
      << calibration.learned().time_offset_s.missing;
}

TEST(SelfCalibration, RefusesRatesOfAnotherUnit) {
  Recording recording;
  recording.camera = hand_held();
  recording.gyro_factor = 180 / M_PI;
  SelfCalibration calibration;
  play(recording, 0, 15, &calibration);
  EXPECT_FALSE(calibration.learned().R_cam_imu.known);
  EXPECT_NE(calibration.learned().R_cam_imu.missing.find("rad/s"), std::string::npos);
}

TEST(SelfCalibration, LearnsTheFocalLengthOfALensThatIsNotKnown) {
  for (const double focal_length : {0.4, 0.8, 1.0, 2.5}) {
    for (const double outliers : {0.0, 0.1}) {
      Recording recording;
      recording.camera = hand_held();
      recording.truth.time_offset_ns = 21'000'000;
      recording.readout_s = 0.015;
      recording.focal_length = focal_length;
      recording.outliers = outliers;
      recording.noise_rad_s = 0.01;
      // A drone that flies to the side when it rolls: slower than it rotates.
      recording.apparent = {{{{0.1, -0.2, 0}, 0.11, 0.3}, {{-0.15, 0.1, 0}, 0.37, 0.4}}};
      SelfCalibration calibration;
      bool was_known = false;
      play(recording, 0, 30, &calibration, [&](double t_s) {
        const Learned<double>& learned = calibration.learned().focal_length;
        if (!learned.known) return;
        was_known = true;
        EXPECT_LT(std::abs(learned.value - focal_length), 0.1 * focal_length) << t_s;
        EXPECT_LE(learned.stddev, UsefulStddev::kFocalShare * learned.value) << t_s;
      });
      ASSERT_TRUE(was_known) << focal_length << ": " << calibration.learned().focal_length.missing;
      const LearnedCalibration& learned = calibration.learned();
      EXPECT_LT(std::abs(learned.focal_length.value - focal_length), 0.04 * focal_length) << outliers;
      EXPECT_LT(rotation_error_deg(learned, recording.truth), 3) << focal_length << ", " << outliers;
      EXPECT_LT(offset_error_ms(learned, recording.truth), 3) << focal_length << ", " << outliers;
      EXPECT_NEAR(learned.readout_s.value, recording.readout_s, 0.004) << focal_length << ", " << outliers;
      EXPECT_FALSE(learned.bias_rad_s.known) << "a change of rates is without it";
    }
  }
}

TEST(SelfCalibration, NoFocalLengthOfAKnownLensAndOfRatesInDegrees) {
  Recording recording;
  recording.camera = hand_held();
  SelfCalibration calibration;
  play(recording, 0, 10, &calibration);
  EXPECT_TRUE(calibration.learned().R_cam_imu.known);
  EXPECT_FALSE(calibration.learned().focal_length.known);

  recording.focal_length = 0.8;
  recording.gyro_factor = 180 / M_PI;
  calibration = SelfCalibration();
  play(recording, 0, 15, &calibration);
  EXPECT_FALSE(calibration.learned().focal_length.known);
  EXPECT_NE(calibration.learned().focal_length.missing.find("rad/s"), std::string::npos);
}

TEST(SelfCalibration, AFocalLengthNeedsRotationAcrossTheOpticalAxis) {
  Recording recording;
  recording.camera = {{{{0, 0, 0.5}, 0.37, 0.4}, {{0, 0, 0.4}, 0.83, 1.9}, {{0, 0, 0.3}, 1.71, 0.2}}};
  recording.focal_length = 0.8;
  SelfCalibration calibration;
  play(recording, 0, 20, &calibration);
  EXPECT_FALSE(calibration.learned().focal_length.known) << calibration.learned().focal_length.value;
  EXPECT_NE(calibration.learned().focal_length.missing, "");
}

TEST(SelfCalibration, BeginsAnewWhenTheLensBecomesKnown) {
  Recording recording;
  recording.camera = hand_held();
  recording.focal_length = 0.5;
  SelfCalibration calibration;
  play(recording, 0, 10, &calibration);
  recording.focal_length = 0;
  play(recording, 10, 20, &calibration);
  EXPECT_LT(rotation_error_deg(calibration.learned(), recording.truth), 2);
  EXPECT_TRUE(calibration.learned().bias_rad_s.known);
}

TEST(SelfCalibration, LearnsTheReadoutTime) {
  for (const double readout_s : {0.0, 0.011, 0.025, -0.02}) {
    Recording recording;
    recording.camera = hand_held();
    recording.readout_s = readout_s;
    recording.truth.time_offset_ns = 21'000'000;
    SelfCalibration calibration;
    play(recording, 0, 20, &calibration);
    SCOPED_TRACE(readout_s);
    const LearnedCalibration& learned = calibration.learned();
    ASSERT_TRUE(learned.readout_s.known) << learned.readout_s.missing;
    EXPECT_NEAR(learned.readout_s.value, readout_s, 0.004);
    EXPECT_LT(std::abs(learned.readout_s.value - readout_s), 4 * learned.readout_s.stddev);
    if (readout_s == 0) {
      EXPECT_EQ(learned.readout_s.value, 0) << "not nearly a global shutter";
    }
    EXPECT_LT(offset_error_ms(learned, recording.truth), 2);
    EXPECT_LT(rotation_error_deg(learned, recording.truth), 1);
  }
}

TEST(SelfCalibration, ContradictsAWrongCalibrationWithinFiveSecondsOfMotion) {
  Recording recording;
  recording.camera = hand_held();
  recording.truth.time_offset_ns = 310'000'000;
  const UsedCalibration right{{{recording.truth.R_cam_imu, "tf"}},
                              {{recording.truth.time_offset_ns, "parameter"}},
                              {{0, "parameter"}},
                              {{recording.truth.bias_rad_s, "parameter"}}};
  UsedCalibration wrong = right;
  wrong.R_cam_imu->value = recording.truth.R_cam_imu * rotation({0, M_PI / 2, 0});
  wrong.time_offset_ns->value = 120'000'000;
  SelfCalibration calibration;
  double contradicted_s = 0;
  play(recording, 0, 15, &calibration, [&](double t_s) {
    EXPECT_TRUE(contradictions(right, calibration.learned()).empty());
    if (contradicted_s == 0 && contradictions(wrong, calibration.learned()).size() == 2) contradicted_s = t_s;
  });
  ASSERT_GT(contradicted_s, 0);
  EXPECT_LE(contradicted_s, 5);
  const std::vector<Contradiction> found = contradictions(wrong, calibration.learned());
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[0].key, "R_cam_imu");
  EXPECT_EQ(found[0].text.rfind("R_cam_imu (tf) contradicts the images: it is [", 0), 0U) << found[0].text;
  EXPECT_NE(found[0].text.find("90 degrees from it"), std::string::npos) << found[0].text;
  EXPECT_EQ(found[1].key, "time_offset");
  const std::string values = "it is 0.1200 s, they say ";
  const std::size_t at = found[1].text.find(values);
  ASSERT_NE(at, std::string::npos) << found[1].text;
  EXPECT_NEAR(std::stod(found[1].text.substr(at + values.size())), 0.31, 0.002);
  wrong = right;
  wrong.readout_ns->value = 20'000'000;
  wrong.bias_rad_s->value.x() += 0.1;
  const std::vector<Contradiction> others = contradictions(wrong, calibration.learned());
  ASSERT_EQ(others.size(), 2U);
  EXPECT_EQ(others[0].key, "readout_time");
  EXPECT_EQ(others[1].key, "gyro_bias");
  EXPECT_TRUE(contradictions({}, calibration.learned()).empty()) << "what is absent is not checked";
}

TEST(SelfCalibration, FollowsAnImuThatHasBeenMoved) {
  Recording recording;
  recording.camera = hand_held();
  SelfCalibration calibration;
  play(recording, 0, 15, &calibration);
  ASSERT_TRUE(calibration.learned().R_cam_imu.known);
  recording.truth.R_cam_imu = recording.truth.R_cam_imu * rotation({0.6, 0, 0});
  recording.truth.time_offset_ns = 70'000'000;
  play(recording, 15, 60, &calibration);
  EXPECT_LT(rotation_error_deg(calibration.learned(), recording.truth), 1);
  EXPECT_LT(offset_error_ms(calibration.learned(), recording.truth), 2);
}

TEST(SelfCalibration, KeepsWhatItKnowsWhileTheCameraRests) {
  Recording recording;
  recording.camera = hand_held();
  SelfCalibration calibration;
  play(recording, 0, 15, &calibration);
  ASSERT_TRUE(calibration.learned().R_cam_imu.known);
  recording.camera = {};
  recording.noise_rad_s = recording.speed_rad_s = 0.005;
  play(recording, 15, 60, &calibration);
  EXPECT_TRUE(calibration.learned().R_cam_imu.known);
  EXPECT_TRUE(calibration.learned().time_offset_s.known);
  EXPECT_LT(rotation_error_deg(calibration.learned(), recording.truth), 1);
  calibration.restart();
  EXPECT_TRUE(calibration.learned().R_cam_imu.known) << "a reset of time moves no sensor";
}

TEST(SelfCalibration, RefusesOptionsOutOfRange) {
  EXPECT_THROW(SelfCalibration(0, 0), OptionError);
  EXPECT_THROW(SelfCalibration(0, 6'000'000'000), OptionError);
}

}  // namespace
}  // namespace gyro_deblur::self_calibration_test
