#include "calibrate/timing_calibration.hpp"

#include <cmath>
#include <memory>
#include <random>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "gyro_deblur/exposure.hpp"
#include "sim/simulator.hpp"
#include "timing_truth.hpp"

namespace gyro_deblur::timing_calibration_test {
namespace {

using namespace test;

/// A shaken camera that sees points 1.5 to 4.5 m away, each row at its own time.
class Footage {
 public:
  /// @param sway_m  of the camera; zero: it rotates on the spot
  explicit Footage(const Truth& truth, const Eigen::Vector3d& sway_m = Eigen::Vector3d::Zero())
      : truth_(truth), camera_(calibration()), motion_(motion(sway_m)) {}

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

  /// Windows of two frames, or of more.
  std::vector<TrackWindow> windows(int count, double noise_px, StampRow stamp_row, StampPhase stamp_phase,
                                   int frames = 2, unsigned seed = 5) const {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> x(40, 600), y(40, 440), depth_m(1.5, 4.5);
    std::normal_distribution<double> noise(0, noise_px);
    const ShutterTiming timing{kExposure, truth_.readout_ns, stamp_row, stamp_phase};
    std::vector<TrackWindow> result;
    for (int i = 0; i < count; ++i) {
      TrackWindow window;
      std::vector<RowExposure> rows;
      for (int k = 0; k < frames; ++k) {
        window.frames.push_back({kStart + (i + k) * kPeriod, kExposure});
        rows.emplace_back(window.frames.back().stamp_ns, 480, timing);
      }
      for (int n = 0; n < 40; ++n) {
        const Eigen::Vector2d at(x(random), y(random));
        const sim::Pose pose = pose_at(rows[0].middle(at.y()));
        const Eigen::Vector3d world = pose.p_world_m + pose.R_world_cam * (camera_.ray(at) * depth_m(random));
        PointTrack track{shown(rows[0], world)};
        for (std::size_t k = 1; k < rows.size(); ++k) {
          const Eigen::Vector2d to = shown(rows[k], world);
          if (!to.allFinite() || to.x() < 0 || to.x() > 639 || to.y() < 0 || to.y() > 479) break;
          track.to_px.push_back(to + Eigen::Vector2d(noise(random), noise(random)));
        }
        if (!track.to_px.empty()) window.tracks.push_back(track);
      }
      result.push_back(window);
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
  static std::unique_ptr<sim::Motion> motion(const Eigen::Vector3d& sway_m) {
    sim::VectorCurve angle, position;
    angle.sines = {{Eigen::Vector3d(5, 9, 2) * kDeg, 1.3, 0.2, {}},
                   {Eigen::Vector3d(-4, 2, 5) * kDeg, 2.1, 1.0, {}},
                   {Eigen::Vector3d(1, -3, 4) * kDeg, 0.45, 2.0, {}}};
    // In step with the rotation: what a drone does that tilts to fly, and what does not average out.
    position.sines = {{sway_m, 0.45, 2.0, {}}, {Eigen::Vector3d(0.1 * sway_m.z(), 0.1 * sway_m.x(), 0), 1.3, 0.2, {}}};
    return sim::make_curve_motion(angle, position);
  }
  sim::Pose pose_at(TimeNs t_ns) const { return motion_->pose(to_seconds(t_ns - kZero)); }

  /// Where a point is smeared around: the mean of its path during the exposure of its row.
  Eigen::Vector2d shown(const RowExposure& rows, const Eigen::Vector3d& world_m) const {
    constexpr int kSlices = 6, kMaxIterations = 20;
    constexpr double kConvergedPx = 1e-6;
    Eigen::Vector2d px(320, 240);
    // The row decides the time, and the time the row.
    for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
      const TimeNs start_ns = rows.start(px.y());
      Eigen::Vector2d sum = Eigen::Vector2d::Zero();
      for (int i = 0; i < kSlices; ++i) {
        const sim::Pose pose = pose_at(start_ns + static_cast<TimeNs>((i + 0.5) / kSlices * kExposure));
        sum += camera_.project(pose.R_world_cam.conjugate() * (world_m - pose.p_world_m));
      }
      const double moved_px = (sum / kSlices - px).norm();
      px = sum / kSlices;
      if (!(moved_px > kConvergedPx)) break;
    }
    return px;
  }

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
      options.shutter.stamp_row = row;
      options.shutter.stamp_phase = row == StampRow::FIRST ? StampPhase::START : StampPhase::END;
      const TimingEstimate estimate =
          estimate_timing(footage.camera(), footage.windows(kFrames, 0, row, options.shutter.stamp_phase),
                          footage.gyro(kFrames), options);
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
      estimate_timing(footage.camera(), footage.windows(kFrames, 0.5, StampRow::FIRST, StampPhase::START),
                      footage.gyro(kFrames), options);
  constexpr double kSigmas = 2;  // which allow for errors of tracking, that these points do not have
  const Errors errors = errors_of(estimate, truth);
  EXPECT_LT(std::abs(errors.offset_ms), kSigmas * 1e3 * estimate.time_offset_s.stddev);
  EXPECT_GT(estimate.time_offset_s.stddev, 1e-6);
  EXPECT_LT(std::abs(errors.readout_percent) / 100 * to_seconds(truth.readout_ns), kSigmas * estimate.readout_s.stddev);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_LT(std::abs(estimate.bias_rad_s[axis].value - truth.bias_rad_s[axis]),
              kSigmas * estimate.bias_rad_s[axis].stddev);
  }
  EXPECT_LT(errors.rotation_deg * kDeg, kSigmas * estimate.rotation_stddev_rad.norm());
  expect_close(errors);
}

TEST(EstimateTiming, EverySignMatters) {
  // The same footage with one thing reversed must not fit: the estimate follows, or the residual grows.
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 20;
  TimingOptions options;
  options.R_cam_imu = truth.R_cam_imu;
  constexpr int kWindow = 4;
  const auto pairs = footage.windows(kFrames - kWindow, 0.1, StampRow::FIRST, StampPhase::START, kWindow);
  const TimingEstimate right = estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options);
  EXPECT_LT(right.median_px, 0.2);
  EXPECT_EQ(right.rotation_stddev_rad.norm(), 0) << "given, not estimated";
  EXPECT_TRUE(right.R_cam_imu.isApprox(truth.R_cam_imu, 1e-9));
  options.R_cam_imu = Eigen::Matrix3d(truth.R_cam_imu.transpose());
  EXPECT_GT(estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options).median_px, 3);
  options.R_cam_imu = truth.R_cam_imu;
  options.shutter.readout_ns = -truth.readout_ns;
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
  auto pairs = footage.windows(kFrames, 0.2, StampRow::FIRST, StampPhase::START);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> offset(-60, 60);
  for (TrackWindow& pair : pairs) {
    for (std::size_t i = 0; i < pair.tracks.size(); i += 5) {
      pair.tracks[i].to_px[0] += Eigen::Vector2d(offset(random), offset(random));
    }
  }
  expect_close(errors_of(estimate_timing(footage.camera(), pairs, footage.gyro(kFrames), options), truth));
}

TEST(EstimateTiming, FindsTheTruthOfACameraThatMoves) {
  // A metre a second, three metres away, in step with the rotation: as far as the rotation moves the points.
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth, {0.3, -0.2, 0.25});
  constexpr int kFrames = 120, kWindow = 4, kRuns = 4;
  double squares = 0;
  int values = 0;
  for (unsigned run = 0; run < kRuns; ++run) {
    const TimingEstimate estimate = estimate_timing(
        footage.camera(), footage.windows(kFrames, 0.2, StampRow::FIRST, StampPhase::START, kWindow, run),
        footage.gyro(kFrames + kWindow), {});
    const Errors errors = errors_of(estimate, truth);
    EXPECT_LT(std::abs(errors.offset_ms), 0.25);
    EXPECT_LT(std::abs(errors.readout_percent), 1.5);
    EXPECT_LT(errors.bias_rad_s, 0.0015);
    EXPECT_LT(errors.rotation_deg, 0.15);
    EXPECT_LT(estimate.median_px, 0.4);
    EXPECT_GT(estimate.median_at_start_px, 3) << "there is nothing to see of the translation";
    const auto add = [&](double error, double stddev) {
      squares += error * error / (stddev * stddev);
      ++values;
    };
    add(1e-3 * errors.offset_ms, estimate.time_offset_s.stddev);
    add(estimate.readout_s.value - to_seconds(truth.readout_ns), estimate.readout_s.stddev);
    for (int axis = 0; axis < 3; ++axis) {
      add(estimate.bias_rad_s[axis].value - truth.bias_rad_s[axis], estimate.bias_rad_s[axis].stddev);
    }
    const Eigen::AngleAxisd error(Eigen::Matrix3d(estimate.R_cam_imu * truth.R_cam_imu.transpose()));
    for (int axis = 0; axis < 3; ++axis) {
      add(error.angle() * error.axis()[axis], estimate.rotation_stddev_rad[axis]);
    }
  }
  // A quarter: standard deviations allow for errors of tracking that these points do not have.
  EXPECT_LT(squares / values, 0.6);
  EXPECT_GT(squares / values, 0.1);
}

TEST(EstimateTiming, TheEpipolarLineOfTwoFramesIsEnough) {
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth, {0.3, -0.2, 0.25});
  constexpr int kFrames = 120;
  const TimingEstimate estimate = estimate_timing(
      footage.camera(), footage.windows(kFrames, 0.2, StampRow::FIRST, StampPhase::START), footage.gyro(kFrames), {});
  expect_close(errors_of(estimate, truth));
}

TEST(EstimateTiming, SaysWhatIsNotDetermined) {
  const Truth truth{4'000'000, 25'000'000, {0.01, -0.02, 0.03}, rotation({0.1, -0.05, 1.6})};
  const Footage footage(truth);
  constexpr int kFrames = 60;
  const auto pairs = footage.windows(kFrames, 0.1, StampRow::FIRST, StampPhase::START);
  const auto gyro = footage.gyro(kFrames);
  const auto error = [&](const std::vector<TrackWindow>& p, const std::vector<GyroSample>& g,
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
  // Motion about one axis: without a rotation to start from, the rotation about that axis is open.
  auto one_axis_gyro = gyro;
  auto one_axis = pairs;
  for (std::size_t i = 0; i < one_axis.size(); ++i) {
    const double angle = 0.03 * std::sin(0.5 * static_cast<double>(i));
    for (PointTrack& point : one_axis[i].tracks) {
      point.to_px[0] = footage.camera().project(Eigen::AngleAxisd(-angle, Eigen::Vector3d::UnitY()) *
                                                footage.camera().ray(point.from_px));
    }
  }
  for (GyroSample& sample : one_axis_gyro) {
    const double frame = static_cast<double>(sample.t_ns - truth.time_offset_ns - Footage::kStart) /
                             static_cast<double>(Footage::kPeriod) -
                         0.5;
    sample.rate_rad_s = {0, 0.03 / 0.05 * std::sin(0.5 * frame), 0};
  }
  expect(error(one_axis, one_axis_gyro, {}), "rotates about one axis only");
  TimingOptions given;
  given.R_cam_imu = Eigen::Matrix3d::Identity();
  EXPECT_EQ(error(one_axis, one_axis_gyro, given), "accepted");
  TimingOptions bad;
  bad.search_ns = 6'000'000'000;
  EXPECT_THROW(estimate_timing(footage.camera(), pairs, gyro, bad), OptionError);
}

}  // namespace
}  // namespace gyro_deblur::timing_calibration_test
