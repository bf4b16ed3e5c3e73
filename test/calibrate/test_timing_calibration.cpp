#include "calibrate/timing_calibration.hpp"

#include <cmath>
#include <cstdio>
#include <memory>
#include <random>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "calibrate/frame_tracker.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur {
namespace {

constexpr double kDeg = M_PI / 180;

/// What is to be found.
struct Truth {
  TimeNs time_offset_ns = 0, readout_ns = 0;
  Eigen::Vector3d bias_rad_s = Eigen::Vector3d::Zero();
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
};

Eigen::Matrix3d rotation(const Eigen::Vector3d& rotation_rad) { return so3_exp(rotation_rad).toRotationMatrix(); }

/// The error of an estimate: in the units of the limits below.
struct Errors {
  double offset_ms, readout_percent, bias_rad_s, rotation_deg;
};

Errors errors_of(const TimingEstimate& estimate, const Truth& truth) {
  const Eigen::Vector3d bias(estimate.bias_rad_s[0].value, estimate.bias_rad_s[1].value, estimate.bias_rad_s[2].value);
  return {1e3 * (estimate.time_offset_s.value - to_seconds(truth.time_offset_ns)),
          truth.readout_ns == 0 ? 0 : 100 * (estimate.readout_s.value / to_seconds(truth.readout_ns) - 1),
          (bias - truth.bias_rad_s).cwiseAbs().maxCoeff(),
          Eigen::AngleAxisd(Eigen::Matrix3d(estimate.R_cam_imu.transpose() * truth.R_cam_imu)).angle() / kDeg};
}

void print_row(const std::string& name, const TimingEstimate& e, const Truth& t) {
  const Errors errors = errors_of(e, t);
  std::printf(
      "| %s | %.3f | %.3f +- %.3f | %.3f | %.3f +- %.3f (%+.2f %%) | [%.4f, %.4f, %.4f] | [%.4f, %.4f, %.4f] +- "
      "%.4f | %.3f | %.2f -> %.2f |\n",
      name.c_str(), 1e-6 * static_cast<double>(t.time_offset_ns), 1e3 * e.time_offset_s.value,
      1e3 * e.time_offset_s.stddev, 1e-6 * static_cast<double>(t.readout_ns), 1e3 * e.readout_s.value,
      1e3 * e.readout_s.stddev, errors.readout_percent, t.bias_rad_s.x(), t.bias_rad_s.y(), t.bias_rad_s.z(),
      e.bias_rad_s[0].value, e.bias_rad_s[1].value, e.bias_rad_s[2].value, e.bias_rad_s[0].stddev, errors.rotation_deg,
      e.median_without_px, e.median_px);
}

void expect_close(const Errors& errors) {
  EXPECT_LT(std::abs(errors.offset_ms), 1);
  EXPECT_LT(std::abs(errors.readout_percent), 5);
  EXPECT_LT(errors.bias_rad_s, 0.005);
  EXPECT_LT(errors.rotation_deg, 0.5);
}

// --- exact points, without images ---

/// A shaken camera that sees points at infinity, each row at its own time.
class Footage {
 public:
  explicit Footage(const Truth& truth) : truth_(truth), camera_(calibration()), motion_(motion()) {}

  static CameraCalibration calibration() {
    CameraCalibration c;
    c.width_px = 640;
    c.height_px = 480;
    c.fx_px = c.fy_px = 450;
    c.cx_px = 322;
    c.cy_px = 238;
    c.model = "plumb_bob";
    c.coefficients = {-0.28, 0.07, 0.0002, 0.00002};
    return c;
  }

  std::vector<FramePair> pairs(int count, double noise_px, StampRow stamp_row, StampPhase stamp_phase) const {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> x(40, 600), y(40, 440);
    std::normal_distribution<double> noise(0, noise_px);
    std::vector<FramePair> result;
    for (int i = 0; i < count; ++i) {
      FramePair pair;
      ShutterTiming timing{kExposure, truth_.readout_ns, stamp_row, stamp_phase};
      pair.from = {kStart + i * kPeriod, kExposure};
      pair.to = {kStart + (i + 1) * kPeriod, kExposure};
      const RowExposure from(pair.from.stamp_ns, 480, timing), to(pair.to.stamp_ns, 480, timing);
      for (int k = 0; k < 40; ++k) {
        const Eigen::Vector2d a(x(random), y(random));
        const Eigen::Vector3d world = orientation(from.middle(a.y())) * camera_.ray(a);
        // The row decides the time, and the time the row.
        Eigen::Vector2d b = a;
        for (int iteration = 0; iteration < 20; ++iteration) {
          b = camera_.project(orientation(to.middle(b.y())).conjugate() * world);
          if (!b.allFinite()) break;
        }
        if (!b.allFinite() || b.x() < 0 || b.x() > 639 || b.y() < 0 || b.y() > 479) continue;
        pair.points.push_back({a, b + Eigen::Vector2d(noise(random), noise(random))});
      }
      result.push_back(pair);
    }
    return result;
  }

  std::vector<GyroSample> gyro(int frames) const {
    std::vector<GyroSample> samples;
    constexpr TimeNs kGyroPeriod = 1'000'000;
    for (TimeNs t_ns = kStart - 700'000'000; t_ns < kStart + frames * kPeriod + 700'000'000; t_ns += kGyroPeriod) {
      const Eigen::Vector3d rate = truth_.R_cam_imu.transpose() * motion_->rate(to_seconds(t_ns - kZero));
      samples.push_back({t_ns + truth_.time_offset_ns, rate + truth_.bias_rad_s});
    }
    return samples;
  }

  const Camera& camera() const { return camera_; }

  static constexpr TimeNs kZero = 1'000'000'000'000, kStart = kZero + 2'000'000'000, kPeriod = 50'000'000,
                          kExposure = 12'000'000;

 private:
  static std::unique_ptr<sim::Motion> motion() {
    sim::VectorCurve angle, position;
    angle.sines = {{Eigen::Vector3d(5, 9, 2) * kDeg, 1.3, 0.2, {}},
                   {Eigen::Vector3d(-4, 2, 5) * kDeg, 2.1, 1.0, {}},
                   {Eigen::Vector3d(1, -3, 4) * kDeg, 0.45, 2.0, {}}};
    return sim::make_curve_motion(angle, position);
  }
  Eigen::Quaterniond orientation(TimeNs t_ns) const { return motion_->pose(to_seconds(t_ns - kZero)).R_world_cam; }

  Truth truth_;
  Camera camera_;
  std::shared_ptr<sim::Motion> motion_;
};

TEST(EstimateTiming, FindsTheTruthFromExactPoints) {
  const std::vector<Truth> truths{
      {4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})},
      {-173'000'000, 30'000'000, {-0.05, 0.04, 0.02}, rotation({2.2, 2.2, 0})},
      {420'000'000, -20'000'000, {0, 0, 0}, rotation({-1.2, 1.2, -1.2})},
      {0, 0, {0.002, 0.001, -0.004}, Eigen::Matrix3d::Identity()},
  };
  constexpr int kFrames = 120;
  for (const Truth& truth : truths) {
    const Footage footage(truth);
    for (const StampRow row : {StampRow::FIRST, StampRow::LAST}) {
      TimingOptions options;
      options.stamp_row = row;
      options.stamp_phase = row == StampRow::FIRST ? StampPhase::START : StampPhase::END;
      const TimingEstimate estimate = estimate_timing(
          footage.camera(), footage.pairs(kFrames, 0, row, options.stamp_phase), footage.gyro(kFrames), options);
      const Errors errors = errors_of(estimate, truth);
      EXPECT_LT(std::abs(errors.offset_ms), 0.02);
      EXPECT_NEAR(estimate.readout_s.value, to_seconds(truth.readout_ns), 5e-5);
      EXPECT_LT(errors.bias_rad_s, 2e-4);
      EXPECT_LT(errors.rotation_deg, 0.01);
      EXPECT_LT(estimate.median_px, 0.02);
      EXPECT_GT(estimate.median_without_px, 5);
    }
  }
}

TEST(EstimateTiming, StandardDeviationsAreThoseOfTheErrors) {
  Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 100;
  TimingOptions options;
  const TimingEstimate estimate =
      estimate_timing(footage.camera(), footage.pairs(kFrames, 0.5, options.stamp_row, options.stamp_phase),
                      footage.gyro(kFrames), options);
  constexpr double kSigmas = 4;
  const Errors errors = errors_of(estimate, truth);
  EXPECT_LT(std::abs(errors.offset_ms), kSigmas * 1e3 * estimate.time_offset_s.stddev);
  EXPECT_GT(estimate.time_offset_s.stddev, 1e-6);
  EXPECT_LT(std::abs(errors.readout_percent) / 100 * to_seconds(truth.readout_ns), kSigmas * estimate.readout_s.stddev);
  EXPECT_LT(errors.bias_rad_s, kSigmas * estimate.bias_rad_s[0].stddev);
  EXPECT_LT(errors.rotation_deg * kDeg, kSigmas * estimate.rotation_stddev_rad.norm());
  expect_close(errors);
}

TEST(EstimateTiming, EverySignMatters) {
  // The same footage with one thing turned round must not fit: the estimate follows, or the residual grows.
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 100;
  TimingOptions options;
  options.R_cam_imu = truth.R_cam_imu;
  const auto pairs = footage.pairs(kFrames, 0.1, options.stamp_row, options.stamp_phase);
  const TimingEstimate right = estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options);
  EXPECT_LT(right.median_px, 0.2);
  EXPECT_EQ(right.rotation_stddev_rad.norm(), 0) << "given, not estimated";
  EXPECT_TRUE(right.R_cam_imu.isApprox(truth.R_cam_imu, 1e-9));
  options.R_cam_imu = Eigen::Matrix3d(truth.R_cam_imu.transpose());
  EXPECT_GT(estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options).median_px, 3);
  options.R_cam_imu = truth.R_cam_imu;
  options.readout_ns = -truth.readout_ns;
  options.estimate_readout = false;
  const TimingEstimate wrong_readout = estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options);
  EXPECT_GT(wrong_readout.median_px, 5 * right.median_px);
  EXPECT_EQ(wrong_readout.readout_s.value, -to_seconds(truth.readout_ns));
}

TEST(EstimateTiming, GrossErrorsOfTrackingDoNoHarm) {
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 100;
  TimingOptions options;
  auto pairs = footage.pairs(kFrames, 0.2, options.stamp_row, options.stamp_phase);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> offset(-60, 60);
  for (FramePair& pair : pairs) {
    for (std::size_t i = 0; i < pair.points.size(); i += 5) {
      pair.points[i].to_px += Eigen::Vector2d(offset(random), offset(random));
    }
  }
  expect_close(errors_of(estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options), truth));
}

TEST(EstimateTiming, SaysWhatIsNotDetermined) {
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 60;
  const auto pairs = footage.pairs(kFrames, 0.1, StampRow::FIRST, StampPhase::START);
  const auto gyro = footage.gyro(kFrames);
  const auto error = [&](const std::vector<FramePair>& p, const std::vector<GyroSample>& g,
                         const TimingOptions& options) -> std::string {
    try {
      estimate_timing(footage.camera(), p, g, options);
    } catch (const TimingError& e) {
      return e.what();
    }
    return "accepted";
  };
  const auto expect = [](const std::string& text, const std::string& part) {
    EXPECT_NE(text.find(part), std::string::npos) << text;
  };
  EXPECT_EQ(error(pairs, gyro, {}), "accepted");
  expect(error({pairs.begin(), pairs.begin() + 5}, gyro, {}), "5 of 5 pairs of frames have 8 tracked points");
  expect(error(pairs, {}, {}), "there are 0 gyroscope samples");
  auto later = gyro;
  for (GyroSample& sample : later) sample.t_ns += 60'000'000'000;
  expect(error(pairs, later, {}), "do not agree at any offset within 0.5 s of 0 s");
  auto still = gyro;
  for (GyroSample& sample : still) sample.rate_rad_s = truth.bias_rad_s;
  expect(error(pairs, still, {}), "do not agree");
  // Motion about one axis: without a rotation to start from, the turn about that axis is open.
  auto one_axis_gyro = gyro;
  auto one_axis = pairs;
  for (std::size_t i = 0; i < one_axis.size(); ++i) {
    const double angle = 0.03 * std::sin(0.5 * static_cast<double>(i));
    for (PointPair& point : one_axis[i].points) {
      point.to_px = footage.camera().project(Eigen::AngleAxisd(-angle, Eigen::Vector3d::UnitY()) *
                                             footage.camera().ray(point.from_px));
    }
  }
  for (GyroSample& sample : one_axis_gyro) {
    const double frame = static_cast<double>(sample.t_ns - truth.time_offset_ns - Footage::kStart) /
                             static_cast<double>(Footage::kPeriod) -
                         0.5;
    sample.rate_rad_s = {0, 0.03 / 0.05 * std::sin(0.5 * frame), 0};
  }
  expect(error(one_axis, one_axis_gyro, {}), "turns about one axis only");
  TimingOptions given;
  given.R_cam_imu = Eigen::Matrix3d::Identity();
  EXPECT_EQ(error(one_axis, one_axis_gyro, given), "accepted");
  TimingOptions bad;
  bad.search_ns = 6'000'000'000;
  EXPECT_THROW(estimate_timing(footage.camera(), pairs, gyro, bad), OptionError);
}

// --- images ---

struct Case {
  const char* name;
  Truth truth;
  const char* model;
  std::vector<double> coefficients;
  double sway_m;  ///< sideways, at 2 m from the scene
};

sim::Scene scene_of(const Case& c, int frames) {
  sim::Scene scene;
  CameraCalibration& calibration = scene.camera.calibration;
  calibration.width_px = 376;
  calibration.height_px = 240;
  calibration.fx_px = 229.4;
  calibration.fy_px = 228.7;
  calibration.cx_px = 183.6;
  calibration.cy_px = 124.2;
  calibration.model = c.model;
  calibration.coefficients = c.coefficients;
  scene.camera.fps = 20;
  scene.camera.exposures_ns = {8'000'000, 12'000'000};
  scene.camera.readout_ns = c.truth.readout_ns;
  scene.camera.noise = 2;
  scene.imu.rate_hz = 200;
  scene.imu.gyro_bias_rad_s = c.truth.bias_rad_s;
  scene.imu.gyro_noise_rad_s = 0.003;
  scene.imu.time_offset_ns = c.truth.time_offset_ns;
  scene.imu.R_cam_imu = c.truth.R_cam_imu;
  sim::Plane wall;
  wall.texture = sim::procedural_texture(1400, 1000, 11);
  wall.width_m = 8.4;
  wall.height_m = 6.0;
  wall.center_m = {0, 0, 2};
  scene.planes = {wall};
  sim::VectorCurve angle, position;
  angle.sines = {{Eigen::Vector3d(4, 7, 2) * kDeg, 1.1, 0.2, {}},
                 {Eigen::Vector3d(-3, 2, 5) * kDeg, 1.7, 1.0, {}},
                 {Eigen::Vector3d(1, -2, 3) * kDeg, 0.4, 2.0, {}}};
  position.sines = {{Eigen::Vector3d(1, 0.6, 0.4) * c.sway_m, 0.7, 0.5, {}}};
  scene.motion = sim::make_curve_motion(angle, position);
  scene.frames = frames;
  scene.lead_ns = 800'000'000;
  return scene;
}

TEST(EstimateTiming, MeetsItsLimitsOnSimulatedFootage) {
  const std::vector<Case> cases{
      {"rolling, 25 ms",
       {4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})},
       "plumb_bob",
       {-0.28, 0.07, 0.0002, 0.00002},
       0},
      {"rolling, 33 ms, swaying",
       {-87'000'000, 33'000'000, {-0.03, 0.01, 0.02}, rotation({2.2, 2.2, 0})},
       "none",
       {},
       0.01},
      {"bottom-up, 20 ms, fisheye",
       {231'000'000, -20'000'000, {0.02, 0.02, -0.01}, rotation({-1.2, 1.2, -1.2})},
       "equidistant",
       {-0.01, 0.02, -0.01, 0.002},
       0},
      {"global", {0, 0, {0.05, -0.04, 0.0}, Eigen::Matrix3d::Identity()}, "none", {}, 0},
  };
  std::printf(
      "| footage | offset [ms] | estimate | readout [ms] | estimate | bias [rad/s] | estimate | rotation error [deg] | "
      "residual [px] |\n|---|---|---|---|---|---|---|---|---|\n");
  for (const Case& c : cases) {
    constexpr int kFrames = 60;
    sim::Simulator simulator(scene_of(c, kFrames));
    FrameTracker tracker;
    std::vector<FramePair> pairs;
    FrameTime last;
    for (int i = 0; i < kFrames; ++i) {
      const sim::Frame frame = simulator.frame(i);
      const FrameTime now{frame.stamp_ns, frame.timing.exposure_ns};
      std::vector<PointPair> points = tracker.next(frame.image);
      if (i > 0) pairs.push_back({last, now, std::move(points)});
      last = now;
    }
    std::vector<GyroSample> samples;
    for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
    const TimingEstimate estimate = estimate_timing(simulator.camera(), pairs, samples, {});
    print_row(c.name, estimate, c.truth);
    SCOPED_TRACE(c.name);
    expect_close(errors_of(estimate, c.truth));
    if (c.truth.readout_ns == 0) {
      EXPECT_LT(std::abs(estimate.readout_s.value), 0.001);
    }
  }
}

// --- tracker ---

TEST(FrameTracker, FollowsAShift) {
  const cv::Mat texture = sim::procedural_texture(700, 500, 3);
  cv::Mat grey;
  cv::extractChannel(texture, grey, 1);
  FrameTracker tracker;
  EXPECT_TRUE(tracker.next(grey(cv::Rect(100, 50, 500, 400))).empty()) << "nothing comes before the first";
  const std::vector<PointPair> pairs = tracker.next(grey(cv::Rect(123, 39, 500, 400)));
  ASSERT_GT(pairs.size(), 50u);
  for (const PointPair& pair : pairs) {
    EXPECT_LT((pair.to_px - pair.from_px - Eigen::Vector2d(-23, 11)).norm(), 0.1);
  }
  EXPECT_THROW(tracker.next(grey), std::invalid_argument) << "another size";
  EXPECT_THROW(FrameTracker().next(texture), std::invalid_argument) << "another type";
  EXPECT_THROW(FrameTracker({5, 0.3}), OptionError);
}

}  // namespace
}  // namespace gyro_deblur
