// Accuracy of the whole method against the simulator's truth: pure rotation, rolling shutter, lens distortion, perfect
// gyroscope. The same measure must fail when one of the signs is wrong.
#include <algorithm>
#include <cmath>
#include <iostream>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <opencv2/imgproc.hpp>

#include "axial_difference.hpp"
#include "base/median.hpp"
#include "features/point_motion.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::accuracy_test {
namespace {

using sim::Simulator;

// Limits that the method has to keep (medians), and how much nearer to the truth rectified points have to be.
constexpr double kMaxAngleRad = 0.5 * M_PI / 180;
constexpr double kMaxExtentErrorPx = 0.25;
constexpr double kMaxRectifiedPx = 0.3;
constexpr double kMinRatio = 5;
// Below this the direction of a blur means nothing.
constexpr double kMinExtentForAnglePx = 2;

struct Lens {
  const char* name;
  const char* yaml;
};

const Lens kLenses[] = {
    {"none", "distortion_model: none"},
    {"plumb_bob", "distortion_model: plumb_bob, distortion_coefficients: [-0.2834, 0.0740, 0.0002, 0.0000176, -0.002]"},
    {"rational_polynomial",
     "distortion_model: rational_polynomial, "
     "distortion_coefficients: [0.6, -0.2, 0.0005, -0.0004, 0.01, 0.85, -0.12, -0.01]"},
    {"equidistant", "distortion_model: equidistant, distortion_coefficients: [-0.0127, 0.0085, -0.0104, 0.0038]"},
    {"ds", "distortion_model: ds, distortion_coefficients: [-0.17, 0.59]"},
    {"eucm", "distortion_model: eucm, distortion_coefficients: [0.62, 1.1]"},
    {"mei", "distortion_model: mei, distortion_coefficients: [0.4, -0.1, 0.02, 0.0012, 0.002]"},
};

// Shake about all axes, up to about 2.5 rad/s.
const char kShake[] =
    "{type: curve, rotation: {sines: [{amplitude: [3, 7, 2], frequency: 2.6, phase: 10}, "
    "{amplitude: [5, -2, 4], frequency: 3.7, phase: 80}]}}";
// A swing at about 1.8 rad/s that hardly changes within an exposure.
const char kSwing[] = "{type: curve, rotation: {sines: [{amplitude: [6, 15, 5], frequency: 1.0, phase: 27}]}}";

// 640x480, 20 ms of exposure, a gyroscope without errors but with its own clock and axes.
Simulator moving_camera(const std::string& lens, const std::string& motion, const std::string& readout = "0.024") {
  const std::string yaml =
      "frames: 6\nseed: 11\ncamera: {size: [640, 480], intrinsics: [420, 423, 322.3, 236.8], fps: 20, "
      "exposure_time: 0.020, readout_time: " +
      readout + ", noise: 1, " + lens +
      "}\nimu: {rate: 400, time_offset: 0.006, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}\n"
      "planes: [{size: [9, 7], position: [0, 0, 2], texture_size: [2400, 1900], texture_seed: 21}]\n"
      "motion: " +
      motion + "\n";
  return Simulator(sim::parse_scene(YAML::Load(yaml), "", "accuracy"));
}

// What the method is given; each may be wrong in sign.
struct Signs {
  double rotation = 1, time_offset = 1, readout = 1;
};

RotationTrack track_of(const Simulator& simulator, const Signs& signs) {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu())
    samples.push_back({s.t_ns, signs.rotation * s.rate_rad_s, s.specific_force_m_s2});
  GyroOptions options;
  options.time_offset_ns =
      static_cast<TimeNs>(signs.time_offset * static_cast<double>(simulator.scene().imu.time_offset_ns));
  return RotationTrack(samples, options, simulator.scene().imu.R_cam_imu);
}

RowExposure exposure_of(const Simulator& simulator, int frame, const Signs& signs) {
  ShutterTiming timing = simulator.scene().timing(frame);
  timing.readout_ns = static_cast<TimeNs>(signs.readout * static_cast<double>(timing.readout_ns));
  return RowExposure(simulator.stamp(frame), simulator.camera().calibration().height_px, timing);
}

double median_or_nan(const std::vector<double>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();  // fails every comparison
  return median(values);
}

struct Errors {
  double angle_rad = 0, extent_px = 0;          // of the blur field
  double rectified_px = 0, unrectified_px = 0;  // of points
  double median_extent_px = 0;                  // the truth's, to show that there is something to measure

  bool blur_field_is_accurate() const { return angle_rad <= kMaxAngleRad && extent_px <= kMaxExtentErrorPx; }
  bool rectification_is_accurate() const {
    return rectified_px <= kMaxRectifiedPx && kMinRatio * rectified_px <= unrectified_px;
  }
};

std::ostream& operator<<(std::ostream& out, const Errors& e) {
  return out << "angle " << e.angle_rad * 180 / M_PI << " deg, extent " << e.extent_px << " px of "
             << e.median_extent_px << ", rectified " << e.rectified_px << " px, unrectified " << e.unrectified_px
             << " px";
}

// Medians over all frames: every block of the blur field, and exact points on a grid.
Errors measure(const Simulator& simulator, const Signs& signs) {
  const RotationTrack track = track_of(simulator, signs);
  const BlurFieldOptions options;
  const BlurFieldEstimator estimator(simulator.camera(), options);
  std::vector<double> angles, extents, truth_extents, rectified, unrectified;
  for (int i = 0; i < simulator.frames(); ++i) {
    const RowExposure exposure = exposure_of(simulator, i, signs);
    const FrameBlur field = estimator.estimate(track, exposure);
    for (int b = 0; b < field.grid.size(); ++b) {
      const Eigen::Vector2d truth = simulator.recorded_displacement(i, field.grid.center(b));
      const BlockBlur& blur = field.blocks[static_cast<std::size_t>(b)];
      extents.push_back(std::abs(static_cast<double>(blur.extent_px) - truth.norm()));
      truth_extents.push_back(truth.norm());
      if (truth.norm() >= kMinExtentForAnglePx) {
        angles.push_back(
            test::axial_difference(static_cast<double>(blur.angle_rad), axial_angle(truth.x(), truth.y())));
      }
    }
    std::vector<Eigen::Vector2d> points;
    for (double y = 10.5; y < 480; y += 29.3) {
      for (double x = 8.2; x < 640; x += 37.7) points.emplace_back(x, y);
    }
    std::vector<Eigen::Vector2d> shown;
    for (const Eigen::Vector2d& point : points) {
      shown.push_back(point + field.blocks[field.grid.index_at(point.x(), point.y())].apparent_offset_px());
    }
    // The instant that the truth is asked for is the true one: a wrong readout must not move the goal with it.
    const TimeNs reference = simulator.reference_time(i);
    const std::vector<RectifiedPoint> moved =
        rectify_points(shown, field, simulator.camera(), track, exposure, reference);
    for (std::size_t k = 0; k < points.size(); ++k) {
      const Eigen::Vector2d truth = simulator.truth_rectified(i, points[k], reference);
      if (!moved[k].rectified || !truth.allFinite()) continue;
      rectified.push_back((moved[k].rectified_px - truth).norm());
      unrectified.push_back((points[k] - truth).norm());
    }
  }
  EXPECT_GT(rectified.size(), 1000u);
  return {median_or_nan(angles), median_or_nan(extents), median_or_nan(rectified), median_or_nan(unrectified),
          median_or_nan(truth_extents)};
}

class Geometry : public ::testing::TestWithParam<Lens> {};

TEST_P(Geometry, BlurFieldAndRectifiedPointsAreAccurate) {
  for (const char* readout : {"0.024", "-0.024"}) {
    const Errors errors = measure(moving_camera(GetParam().yaml, kShake, readout), {});
    SCOPED_TRACE(::testing::Message() << "readout " << readout << ": " << errors);
    EXPECT_TRUE(errors.blur_field_is_accurate());
    EXPECT_TRUE(errors.rectification_is_accurate());
    EXPECT_GT(errors.median_extent_px, 8);
    EXPECT_GT(errors.unrectified_px, 2);
  }
}

TEST_P(Geometry, EveryWrongSignIsSeen) {
  const Simulator simulator = moving_camera(GetParam().yaml, kShake);
  const struct {
    const char* what;
    Signs signs;
    bool seen_in_blur_field;  // blur is symmetric in time, so a reversed rotation hardly changes it
  } wrongs[] = {{"rotation", {-1, 1, 1}, false}, {"time offset", {1, -1, 1}, true}, {"readout", {1, 1, -1}, true}};
  for (const auto& wrong : wrongs) {
    const Errors errors = measure(simulator, wrong.signs);
    SCOPED_TRACE(::testing::Message() << wrong.what << ": " << errors);
    EXPECT_FALSE(errors.rectification_is_accurate());
    EXPECT_GT(errors.rectified_px, kMaxRectifiedPx);
    if (wrong.seen_in_blur_field) {
      EXPECT_FALSE(errors.blur_field_is_accurate());
      EXPECT_GT(errors.extent_px, kMaxExtentErrorPx);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Lenses, Geometry, ::testing::ValuesIn(kLenses),
                         [](const auto& tested) { return std::string(tested.param.name); });

// Keypoints that the pipeline found in deblurred blocks and rectified.
struct Detected {
  double rectified_px = 0, unrectified_px = 0;  // medians
  std::size_t points = 0;

  bool accurate() const { return rectified_px <= kMaxRectifiedPx && kMinRatio * rectified_px <= unrectified_px; }
};

std::ostream& operator<<(std::ostream& out, const Detected& d) {
  return out << "rectified " << d.rectified_px << " px, unrectified " << d.unrectified_px << " px, " << d.points
             << " points";
}

// What a keypoint is compared with.
enum class Goal {
  SAME_PIXEL,  // where the scene point goes that the image shows in its pixel: the rectification alone
  SHARP_IMAGE  // where the keypoint goes that the same detector finds in the true sharp image: localisation as well
};

std::size_t nearest(const cv::Point2f& p, const std::vector<cv::KeyPoint>& others) {
  std::size_t best = 0;
  for (std::size_t k = 1; k < others.size(); ++k) {
    if (cv::norm(others[k].pt - p) < cv::norm(others[best].pt - p)) best = k;
  }
  return best;
}

// A simulator with its images, rendered once for all wrong signs.
struct Footage {
  explicit Footage(Simulator&& s) : simulator(std::move(s)) {
    for (int i = 0; i < simulator.frames(); ++i) {
      blurred.push_back(simulator.frame(i).image);
      sharp.push_back(simulator.sharp(i));
    }
  }
  Simulator simulator;
  std::vector<cv::Mat> blurred, sharp;
};

Detected measure_detected(const Footage& footage, const std::string& detector, const Signs& signs, Goal goal) {
  constexpr double kSamePointPx = 2;  // mutual nearest neighbours within this distance are one point
  PipelineOptions options;
  options.keypoints.detector = detector;
  options.keypoints.descriptor = "NONE";
  options.keypoints.max_keypoints = 300;
  const Simulator& simulator = footage.simulator;
  Pipeline pipeline(options);
  pipeline.set_calibration(simulator.camera().calibration());
  FeatureExtractor on_sharp(options.keypoints);
  const RotationTrack track = track_of(simulator, signs);
  std::vector<double> rectified, unrectified;
  for (int i = 0; i < simulator.frames(); ++i) {
    const std::size_t n = static_cast<std::size_t>(i);
    const PipelineResult result = pipeline.process(footage.blurred[n], simulator.layout(), track,
                                                   exposure_of(simulator, i, signs), {false, true});
    const std::vector<cv::KeyPoint>& found = result.features.keypoints;
    std::vector<cv::KeyPoint> sharp;
    if (goal == Goal::SHARP_IMAGE) sharp = on_sharp.extract(footage.sharp[n]).keypoints;
    const TimeNs reference = simulator.reference_time(i);
    for (std::size_t k = 0; k < found.size(); ++k) {
      if (!result.points[k].deblurred || !result.points[k].rectified) continue;
      const BlockBlur& block = result.field.blocks[result.field.grid.index_at(found[k].pt.x, found[k].pt.y)];
      const Eigen::Vector2d offset = block.apparent_offset_px();
      cv::Point2f true_at = found[k].pt - cv::Point2f(offset.x(), offset.y());
      if (goal == Goal::SHARP_IMAGE) {
        if (sharp.empty()) continue;
        true_at = sharp[nearest(found[k].pt, sharp)].pt;
        if (cv::norm(true_at - found[k].pt) > kSamePointPx || nearest(true_at, found) != k) continue;
      }
      const Eigen::Vector2d truth = simulator.truth_rectified(i, {true_at.x, true_at.y}, reference);
      rectified.push_back((result.points[k].rectified_px - truth).norm());
      unrectified.push_back((Eigen::Vector2d(found[k].pt.x, found[k].pt.y) - truth).norm());
    }
  }
  return {median_or_nan(rectified), median_or_nan(unrectified), rectified.size()};
}

const Signs kWrongSigns[] = {{-1, 1, 1}, {1, -1, 1}, {1, 1, -1}};

class DetectedKeypoints : public ::testing::TestWithParam<const char*> {};

bool available(const std::string& detector) {
  const std::vector<std::string> names = available_detectors();
  return std::find(names.begin(), names.end(), detector) != names.end();
}

TEST_P(DetectedKeypoints, AreRectifiedToTheTruth) {
  if (!available(GetParam())) GTEST_SKIP() << "this OpenCV has no " << GetParam();
  const Footage footage(moving_camera(kLenses[1].yaml, kShake));
  const Detected detected = measure_detected(footage, GetParam(), {}, Goal::SAME_PIXEL);
  SCOPED_TRACE(detected);
  EXPECT_GT(detected.points, 500u);
  EXPECT_TRUE(detected.accurate());
  for (const Signs& wrong : kWrongSigns) {
    const Detected bad = measure_detected(footage, GetParam(), wrong, Goal::SAME_PIXEL);
    EXPECT_GT(bad.points, 0u);
    EXPECT_GT(bad.rectified_px, kMaxRectifiedPx);
    EXPECT_FALSE(bad.accurate());
  }
}

INSTANTIATE_TEST_SUITE_P(Detectors, DetectedKeypoints, ::testing::Values("SIFT", "ORB", "GFTT"));

TEST(DetectedKeypointsEndToEnd, AreFoundWhereTheSharpImageHasThem) {
  if (!available("SIFT")) GTEST_SKIP() << "this OpenCV has no SIFT";
  // SIFT, whose positions are finer than a pixel. Under the shake, with more blur and more ringing, its own error in
  // the deblurred image is 0.4 px.
  const Footage footage(moving_camera(kLenses[1].yaml, kSwing));
  const Detected detected = measure_detected(footage, "SIFT", {}, Goal::SHARP_IMAGE);
  SCOPED_TRACE(detected);
  EXPECT_GT(detected.points, 300u);
  EXPECT_TRUE(detected.accurate());
  for (const Signs& wrong : kWrongSigns) {
    if (wrong.time_offset < 0) continue;  // a swing of constant speed looks the same 12 ms later
    const Detected bad = measure_detected(footage, "SIFT", wrong, Goal::SHARP_IMAGE);
    EXPECT_FALSE(bad.accurate()) << bad;
  }
}

double psnr(const cv::Mat& a, const cv::Mat& b) {
  cv::Mat difference;
  cv::subtract(a, b, difference, cv::noArray(), CV_32F);
  return 10 *
         std::log10(255.0 * 255.0 * static_cast<double>(difference.total()) / cv::norm(difference, cv::NORM_L2SQR));
}

TEST(DeblurredImage, IsNearerToTheSharpOneThanTheBlurredOne) {
  const Footage footage(moving_camera(kLenses[1].yaml, kShake));
  const Simulator& simulator = footage.simulator;
  const RotationTrack track = track_of(simulator, {});
  Pipeline pipeline{PipelineOptions{}};
  pipeline.set_calibration(simulator.camera().calibration());
  for (int i = 0; i < simulator.frames(); ++i) {
    const cv::Mat &blurred = footage.blurred[static_cast<std::size_t>(i)],
                  &sharp = footage.sharp[static_cast<std::size_t>(i)];
    const PipelineResult result =
        pipeline.process(blurred, simulator.layout(), track, simulator.exposure(i), {true, false});
    ASSERT_FALSE(result.image.empty()) << i;
    const double gain_db = psnr(result.image, sharp) - psnr(blurred, sharp);
    EXPECT_GT(gain_db, 1.5) << "frame " << i << ": " << psnr(blurred, sharp) << " dB blurred";
  }
}

// The camera circles a point of a wall: rotation and translation cancel around the image's centre.
TEST(Orbit, TheImagesAddTranslationAndNoSharpBlockIsDeblurred) {
  Simulator simulator(sim::load_scene(std::string(GYRO_DEBLUR_SOURCE_DIR) + "/config/scenes/orbit.yaml"));
  const RotationTrack track = track_of(simulator, {});
  PipelineOptions by_rotation;
  by_rotation.optical_flow = false;
  Pipeline pipeline{PipelineOptions{}}, rotation_pipeline{by_rotation};
  pipeline.set_calibration(simulator.camera().calibration());
  rotation_pipeline.set_calibration(simulator.camera().calibration());
  const double min_extent_px = by_rotation.blur_field.min_extent_px;
  // Error of a block's displacement, as an undirected one.
  const auto error_px = [](const BlockBlur& blur, const Eigen::Vector2d& truth) {
    const Eigen::Vector2d path = blur.extent_px * Eigen::Vector2d(std::cos(blur.angle_rad), std::sin(blur.angle_rad));
    return std::min((path - truth).norm(), (path + truth).norm());
  };
  std::vector<double> rotation_errors, errors;
  int sharp = 0, predicted = 0, moved_and_deblurred = 0;
  constexpr int kFirst = 2;  // with two images before, which show how the motion changes
  for (int i = 0; i < simulator.frames(); ++i) {
    const cv::Mat image = simulator.frame(i).image;
    const RowExposure exposure = simulator.exposure(i);
    const FrameBlur field = pipeline.process(image, simulator.layout(), track, exposure, {false, false}).field;
    const FrameBlur rotation_field =
        rotation_pipeline.process(image, simulator.layout(), track, exposure, {false, false}).field;
    if (i < kFirst) continue;
    for (int b = 0; b < field.grid.size(); ++b) {
      const std::size_t n = static_cast<std::size_t>(b);
      const Eigen::Vector2d truth = simulator.recorded_displacement(i, field.grid.center(b));
      rotation_errors.push_back(error_px(rotation_field.blocks[n], truth));
      errors.push_back(error_px(field.blocks[n], truth));
      if (truth.norm() >= min_extent_px) {
        moved_and_deblurred += field.blocks[n].status == BlockStatus::DEBLURRED ? 1 : 0;
        continue;
      }
      ++sharp;
      predicted += rotation_field.blocks[n].extent_px >= min_extent_px ? 1 : 0;
      EXPECT_NE(rotation_field.blocks[n].status, BlockStatus::DEBLURRED) << "frame " << i << ", block " << b;
      EXPECT_NE(field.blocks[n].status, BlockStatus::DEBLURRED) << "frame " << i << ", block " << b;
    }
  }
  EXPECT_GT(sharp, 1000);
  EXPECT_GT(predicted, 1000) << "nothing to be wrong about";
  EXPECT_GT(moved_and_deblurred, 100) << "leaving everything alone is no way to do no harm";
  EXPECT_GT(median_or_nan(rotation_errors), 10);
  EXPECT_LT(median_or_nan(errors), 0.02 * median_or_nan(rotation_errors));
  RecordProperty("sharp_blocks", sharp);
  std::cout << "median error " << median_or_nan(rotation_errors) << " px with rotation alone, " << median_or_nan(errors)
            << " px with the images; " << sharp << " sharp blocks, blur predicted for " << predicted << " of them; "
            << moved_and_deblurred << " blurred blocks deblurred\n";
}

}  // namespace
}  // namespace gyro_deblur::accuracy_test
