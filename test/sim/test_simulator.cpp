// The simulator against cases with a closed form: its truth is what every accuracy number rests on.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "base/median.hpp"
#include "gyro_deblur/options.hpp"
#include "sim/motion.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::sim {
namespace {

constexpr double kRadPerDeg = M_PI / 180;

// A folder that goes away with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    const std::string name = ::testing::UnitTest::GetInstance()->current_test_info()->name();
    std::string safe = name;
    std::replace(safe.begin(), safe.end(), '/', '_');
    path_ = std::filesystem::temp_directory_path() / ("gyro_deblur_" + safe + "_" + std::to_string(getpid()));
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }

  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(path_ / name) << text;
    return (path_ / name).string();
  }
  std::string string() const { return path_.string(); }

 private:
  std::filesystem::path path_;
};

Scene scene_of(const std::string& yaml, const std::string& directory = "") {
  return parse_scene(YAML::Load(yaml), directory, "test.yaml");
}

// Message of the OptionError that `action` must throw.
std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const OptionError& e) {
    return e.what();
  }
  ADD_FAILURE() << "no OptionError";
  return "";
}

void expect_contains(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << "'" << part << "' in " << text;
}

// 200x160, f = 200 px, 2 m in front of a plane: one metre is 100 px.
std::string small_scene(const std::string& motion, const std::string& camera = "", const std::string& more = "",
                        const std::string& plane = "{size: [8, 8], position: [0, 0, 2], texture_size: [1600, 1600]}") {
  return "frames: 3\nlead_time: 0.2\ncamera: {size: [200, 160], intrinsics: [200, 200, 99.5, 79.5], fps: 20, " +
         (camera.empty() ? std::string("exposure_time: 0.02") : camera) + "}\nplanes: [" + plane +
         "]\nmotion: " + motion + "\n" + more;
}

const char kStill[] = "{type: constant_rate, rate: [0, 0, 0]}";

// A white half plane: the grey value steps from 50 to 200 at x = 0 of a plane 8 m wide.
cv::Mat step_texture() {
  cv::Mat texture(1600, 1600, CV_8UC1, cv::Scalar(50));
  texture.colRange(800, 1600).setTo(200);
  return texture;
}

// Centroid and variance [px, px^2] of the derivative of a row that crosses the step once.
struct EdgeMoments {
  double position = 0, variance = 0;
};
EdgeMoments edge_moments(const cv::Mat& image, int row) {
  double sum = 0, first = 0, second = 0;
  for (int x = 0; x + 1 < image.cols; ++x) {
    const double d = static_cast<double>(image.at<ushort>(row, x + 1)) - image.at<ushort>(row, x);
    sum += d;
    first += d * (x + 0.5);
    second += d * (x + 0.5) * (x + 0.5);
  }
  const double mean = first / sum;
  return {mean, second / sum - mean * mean};
}

Simulator step_simulator(const std::string& motion, const std::string& camera) {
  Scene scene = scene_of(small_scene(motion, camera));
  scene.planes.front().texture = step_texture();
  return Simulator(scene);
}

TEST(Renderer, TranslationShiftsTheImageByTheKnownPixels) {
  // 0.35 m/s right and 0.15 m/s down over 0.2 s: 7 px and 3 px.
  Simulator sim(scene_of(small_scene("{type: constant_rate, rate: [0, 0, 0], position: {rate: [0.35, 0.15, 0]}}")));
  const TimeNs t = sim.scene().start_ns;
  const cv::Mat before = sim.global_shutter(t), after = sim.global_shutter(t + to_ns(0.2));
  // The camera moves right and down, so the scene moves left and up.
  const cv::Mat overlap_before = before(cv::Rect(7, 3, 193, 157)), overlap_after = after(cv::Rect(0, 0, 193, 157));
  EXPECT_LE(cv::norm(overlap_before, overlap_after, cv::NORM_INF), 1);  // rounding
  EXPECT_GT(cv::norm(before, after, cv::NORM_L1) / before.total(), 5);  // not because nothing is there
}

// Where `patch` (CV_32F) is centred in `image` (CV_32F): Gauss-Newton on the grey values (Lucas and Kanade) from
// `guess`.
Eigen::Vector2d find_patch(const cv::Mat& image, const cv::Mat& patch, const Eigen::Vector2d& guess) {
  cv::Mat gx, gy, there;
  cv::Sobel(patch, gx, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(patch, gy, CV_32F, 0, 1, 3, 1.0 / 8);
  Eigen::Matrix2d normal;
  normal << gx.dot(gx), gx.dot(gy), gx.dot(gy), gy.dot(gy);
  Eigen::Vector2d found = guess;
  for (int i = 0; i < 20; ++i) {
    cv::getRectSubPix(image, patch.size(), cv::Point2d(found.x(), found.y()), there, CV_32F);
    const cv::Mat difference = patch - there;
    found += normal.inverse() * Eigen::Vector2d(gx.dot(difference), gy.dot(difference));
  }
  return found;
}

// The patch of 31x31 px around a pixel.
cv::Mat patch_around(const cv::Mat& image, int x, int y) {
  constexpr int kHalf = 15;
  return image(cv::Rect(x - kHalf, y - kHalf, 2 * kHalf + 1, 2 * kHalf + 1)).clone();
}

TEST(Renderer, PanMovesTheImageAgainstTheRotation) {
  // Positive rate about y (down) rotates the optical axis to the right: the scene moves left by f tan(angle).
  Simulator sim(scene_of(small_scene("{type: constant_rate, rate: [0, 10, 0]}")));
  const TimeNs t = sim.scene().start_ns;
  cv::Mat before, after;
  sim.global_shutter(t).convertTo(before, CV_32F);
  sim.global_shutter(t + to_ns(0.1)).convertTo(after, CV_32F);
  const Eigen::Vector2d found = find_patch(after, patch_around(before, 99, 79), {99, 79});
  EXPECT_NEAR(found.x(), 99 - 200 * std::tan(1 * kRadPerDeg), 0.05);
  EXPECT_NEAR(found.y(), 79, 0.05);
}

TEST(Renderer, BlurOfAnEdgeHasThePredictedExtentAndIsCentred) {
  // 5 m/s at 2 m, 100 px/m, 20 ms: 10 px.
  const std::string motion =
      "{type: constant_rate, rate: [0, 0, 0], position: {offset: [-1.5, 0, 0], rate: [5, 0, 0]}}";
  Simulator sim = step_simulator(motion, "exposure_time: 0.02, encoding: mono16");
  const Frame frame = sim.frame(0);
  const cv::Mat sharp = sim.sharp(0);
  for (const int row : {3, 80, 150}) {
    const EdgeMoments blurred = edge_moments(frame.image, row), still = edge_moments(sharp, row);
    // A box of extent r adds r^2 / 12 to the variance of the edge's derivative; n samples of it add r^2 (1 - 1/n^2)
    // / 12.
    EXPECT_NEAR(std::sqrt(12 * (blurred.variance - still.variance)), 10, 0.05);
    EXPECT_NEAR(blurred.position, still.position, 0.01);
  }
  EXPECT_NEAR(sim.truth_displacement(0, {100, 80}).x(), -10, 1e-9);
  EXPECT_NEAR(sim.truth_displacement(0, {100, 80}).y(), 0, 1e-9);
}

TEST(Renderer, RollingShutterSlantsAVerticalEdge) {
  // 2 m/s is 200 px/s; 40 ms of readout move the edge by 8 px over 160 rows.
  const std::string motion =
      "{type: constant_rate, rate: [0, 0, 0], position: {offset: [-0.6, 0, 0], rate: [2, 0, 0]}}";
  for (const double readout : {0.04, -0.04, 0.0}) {
    Simulator sim =
        step_simulator(motion, "exposure_time: 0.005, encoding: mono16, readout_time: " + std::to_string(readout));
    const Frame frame = sim.frame(0);
    for (const int row : {0, 40, 159}) {
      // Position of the step in the image when row `row` is at mid-exposure, from the pose alone.
      const double x_camera = sim.pose(sim.exposure(0).middle(row)).p_world_m.x();
      EXPECT_NEAR(edge_moments(frame.image, row).position, 99.5 - 100 * x_camera, 0.02) << readout << " row " << row;
    }
    const double slant = edge_moments(frame.image, 140).position - edge_moments(frame.image, 20).position;
    EXPECT_NEAR(slant, -200 * readout * 120 / 160, 0.02);
  }
}

TEST(Renderer, RollingShutterBlursWhatMovesAgainstTheReadoutLess) {
  // A horizontal edge moves up by 500 px/s; rows are 0.25 ms apart, or 0.25 ms from the bottom up.
  struct Case {
    double readout, offset_m, rows_per_row;
  };
  for (const auto& [readout, offset_m, rows_per_row] : {Case{0.04, -1.155, -0.125}, Case{-0.04, -0.955, 0.125}}) {
    Scene scene =
        scene_of(small_scene("{type: constant_rate, rate: [0, 0, 0], position: {offset: [0, " +
                                 std::to_string(offset_m) + ", 0], rate: [0, 5, 0]}}",
                             "exposure_time: 0.02, encoding: mono16, readout_time: " + std::to_string(readout)));
    scene.planes.front().texture = step_texture().t();
    Simulator sim(scene);
    const EdgeMoments blurred = edge_moments(sim.frame(0).image.t(), 100), still = edge_moments(sim.sharp(0).t(), 100);
    const double extent_px = 10 / (1 - rows_per_row);
    EXPECT_NEAR(std::sqrt(12 * (blurred.variance - still.variance)), extent_px, 0.1) << readout;
    EXPECT_NEAR(sim.recorded_displacement(0, {100, 80}).y(), -extent_px, 1e-3) << readout;
    EXPECT_NEAR(sim.truth_displacement(0, {100, 80}).y(), -10, 1e-9) << readout;
  }
}

TEST(Simulator, TruthIsNotANumberBehindTheCamera) {
  // The camera turns by a right angle within the exposure: what it sees at its middle is beside it at the end.
  const Simulator sim(scene_of(small_scene("{type: constant_rate, rate: [0, 10000, 0]}", "exposure_time: 0.02")));
  EXPECT_FALSE(sim.truth_displacement(0, {150, 80}).allFinite());
  EXPECT_FALSE(sim.recorded_displacement(0, {150, 80}).allFinite());
}

TEST(Renderer, TheNearestPlaneWinsAndTheRestIsBackground) {
  const std::string planes =
      "{size: [0.8, 0.8], position: [0, 0, 2], texture_size: [64, 64]}, "
      "{size: [0.4, 0.4], position: [0.1, 0, 1], texture_size: [64, 64]}, "
      "{size: [9, 9], position: [0, 0, -1], texture_size: [64, 64]}";
  Scene scene = scene_of(small_scene(kStill, "", "background: 17", planes));
  for (int i = 0; i < 3; ++i) scene.planes[i].texture = cv::Mat(64, 64, CV_8UC1, cv::Scalar(100 + 50 * i));
  Simulator sim(scene);
  const cv::Mat image = sim.sharp(0);
  EXPECT_EQ(image.at<uchar>(80, 62), 100);   // 0.375 m left of the centre at 2 m; left of the near plane
  EXPECT_EQ(image.at<uchar>(80, 120), 150);  // near plane: 0.1 m right at 1 m is 20 px
  EXPECT_EQ(image.at<uchar>(80, 159), 150);
  EXPECT_EQ(image.at<uchar>(80, 162), 17);
  EXPECT_EQ(image.at<uchar>(5, 5), 17);  // the plane behind the camera is not seen
  // The order in the list does not matter.
  std::swap(scene.planes[0], scene.planes[1]);
  EXPECT_EQ(cv::norm(image, Simulator(scene).sharp(0), cv::NORM_INF), 0);
}

TEST(Renderer, ARotatedPlaneIsSeenInPerspective) {
  // 45 degrees about y: the edge at +0.5 m of the plane's x is at x = 0.354 m, and nearer or farther by as much.
  Scene scene =
      scene_of(small_scene(kStill, "", "background: 0",
                           "{size: [1, 1], position: [0, 0, 2], rotation: [0, 45, 0], texture_size: [64, 64]}"));
  scene.planes[0].texture = cv::Mat(64, 64, CV_8UC1, cv::Scalar(255));
  const cv::Mat row = Simulator(scene).sharp(0).row(80);
  int first = 200, last = 0;
  for (int x = 0; x < 200; ++x) {
    if (row.at<uchar>(x) == 0) continue;
    first = std::min(first, x);
    last = std::max(last, x);
  }
  const double h = 0.5 * std::sqrt(0.5);
  // Rotation about +y takes the plane's x axis to (cos, 0, -sin): its right edge comes nearer.
  EXPECT_EQ(last, static_cast<int>(std::floor(99.5 + 200 * h / (2 - h))));
  EXPECT_EQ(first, static_cast<int>(std::ceil(99.5 - 200 * h / (2 + h))));
}

TEST(Renderer, RenderedImagesAgreeWithTheTruthFunctions) {
  // Lens distortion, rolling shutter and translation before two planes: the global-shutter image, fetched where
  // truth_rectified says, must be the rolling image.
  const std::string yaml =
      "frames: 1\ncamera: {size: [320, 240], intrinsics: [220, 222, 158, 121], distortion_model: plumb_bob, "
      "distortion_coefficients: [-0.25, 0.06, 0.001, -0.001, 0], fps: 20, exposure_time: 0.01, readout_time: 0.03}\n"
      "planes: [{size: [9, 7], position: [0, 0, 2.5], texture_size: [2000, 1600]}, "
      "{size: [0.8, 0.8], position: [0.2, 0.1, 1.5], rotation: [0, 20, 10], texture_size: [512, 512], texture_seed: "
      "9}]\n"
      "motion: {type: curve, rotation: {sines: [{amplitude: [8, -12, 10], frequency: 4, phase: 30}]}, "
      "position: {rate: [0.8, -0.5, 0.6]}}";
  Simulator sim(scene_of(yaml));
  const TimeNs reference = sim.reference_time(0);
  cv::Mat rolling, global, predicted, map(240, 320, CV_32FC2);
  sim.sharp(0).convertTo(rolling, CV_32F);
  sim.global_shutter(reference).convertTo(global, CV_32F);
  for (int y = 0; y < map.rows; ++y) {
    for (int x = 0; x < map.cols; ++x) {
      const Eigen::Vector2d truth = sim.truth_rectified(0, {x, y}, reference);
      map.at<cv::Vec2f>(y, x) = cv::Vec2f(static_cast<float>(truth.x()), static_cast<float>(truth.y()));
    }
  }
  cv::remap(global, predicted, map, cv::noArray(), cv::INTER_CUBIC);
  std::vector<double> errors, unrectified;
  for (int y = 20; y < 220; y += 20) {
    for (int x = 20; x < 300; x += 20) {
      const Eigen::Vector2d here(x, y);
      const cv::Vec2f truth = map.at<cv::Vec2f>(y, x);
      if (truth[0] < 16 || truth[1] < 16 || truth[0] > 303 || truth[1] > 223) continue;
      errors.push_back((find_patch(predicted, patch_around(rolling, x, y), here) - here).norm());
      unrectified.push_back((Eigen::Vector2d(truth[0], truth[1]) - here).norm());
    }
  }
  ASSERT_GT(errors.size(), 60u);
  EXPECT_LT(median(errors), 0.05);
  EXPECT_GT(median(unrectified), 1.5);
}

TEST(Simulator, SubExposuresKeepStepsBelowHalfAPixel) {
  const auto simulator = [](double rate_deg_s) {
    return Simulator(scene_of(small_scene("{type: constant_rate, rate: [0, " + std::to_string(rate_deg_s) + ", 0]}")));
  };
  EXPECT_EQ(simulator(0).sub_exposures(0), 1);
  for (const double rate : {50.0, 100.0, 200.0}) {
    const Simulator sim = simulator(rate);
    double longest = 0;
    for (int y = 0; y < 160; y += 20) {
      for (int x = 0; x < 200; x += 20) longest = std::max(longest, sim.truth_displacement(0, {x, y}).norm());
    }
    EXPECT_LE(longest / sim.sub_exposures(0), 0.5);
    EXPECT_GE(longest / sim.sub_exposures(0), 0.3) << "wasted time";
  }
}

TEST(Simulator, TruthOfDisplacementIsTheProjectedPath) {
  // Roll by 60 deg/s over 20 ms about the optical axis: the point stays on its circle.
  const Simulator sim(scene_of(small_scene("{type: constant_rate, rate: [0, 0, 60]}")));
  const Eigen::Vector2d center(99.5, 79.5), arm(60, 0);
  const double half = 0.6 * kRadPerDeg;
  // The camera rotates clockwise in the image (x to y), the scene counter-clockwise.
  const Eigen::Vector2d expected = Eigen::Rotation2Dd(-half) * arm - Eigen::Rotation2Dd(half) * arm;
  EXPECT_LT((sim.truth_displacement(0, center + arm) - expected).norm(), 1e-9);
  EXPECT_LT(expected.y(), 0);
}

TEST(Simulator, APointIsRectifiedToItselfAtItsOwnRowsMiddle) {
  const Simulator sim(
      scene_of(small_scene("{type: constant_rate, rate: [50, 80, -30]}", "exposure_time: 0.01, readout_time: 0.03")));
  const Eigen::Vector2d pixel(40, 100);
  EXPECT_LT((sim.truth_rectified(1, pixel, sim.exposure(1).middle(100)) - pixel).norm(), 1e-6);
  EXPECT_GT((sim.truth_rectified(1, pixel, sim.reference_time(1)) - pixel).norm(), 0.5);
}

TEST(Simulator, AnOrbitKeepsItsCentreInPlaceWhileTheGyroscopeRotates) {
  Simulator sim(scene_of(small_scene("{type: orbit, center: [0, 0, 2], radius: 2, axis: [0, 1, 0], rate: 100}")));
  EXPECT_LT(sim.truth_displacement(0, {99.5, 79.5}).norm(), 1e-9);
  EXPECT_NEAR(sim.imu().front().rate_rad_s.y(), 100 * kRadPerDeg, 1e-12);
}

TEST(Simulator, StampsFollowTheConvention) {
  const std::string camera = "exposure_time: 0.01, readout_time: 0.032, stamp_row: ";
  const TimeNs exposure = to_ns(0.01), readout = to_ns(0.032);
  const Simulator first(scene_of(small_scene(kStill, camera + "first, stamp_phase: start")));
  const Simulator middle(scene_of(small_scene(kStill, camera + "middle, stamp_phase: middle")));
  const Simulator last(scene_of(small_scene(kStill, camera + "last, stamp_phase: end")));
  const TimeNs t0 = first.scene().start_ns + to_ns(0.2);
  EXPECT_EQ(first.stamp(0), t0);
  EXPECT_EQ(first.stamp(2), t0 + to_ns(0.1));
  EXPECT_EQ(middle.stamp(0), t0 + exposure / 2 + readout * 159 / 320);
  EXPECT_EQ(last.stamp(0), t0 + exposure + readout * 159 / 160);
  for (const Simulator* sim : {&first, &middle, &last}) {
    EXPECT_EQ(sim->exposure(0).start(0), t0);
    EXPECT_EQ(sim->reference_time(0), t0 + exposure / 2 + readout * 159 / 320);
  }
  // Bottom-up: row 0 starts last, and no row before the lead time has passed.
  const Simulator bottom_up(scene_of(small_scene(kStill, "exposure_time: 0.01, readout_time: -0.032")));
  EXPECT_EQ(bottom_up.exposure(0).start(0), t0 + readout);
  EXPECT_EQ(bottom_up.exposure(0).start(159), t0 + readout - readout * 159 / 160);
}

TEST(Simulator, ExposureTimesAreUsedInTurn) {
  Simulator sim(scene_of(small_scene(kStill, "exposure_time: [0.001, 0.03]")));
  EXPECT_EQ(sim.frame(0).timing.exposure_ns, to_ns(0.001));
  EXPECT_EQ(sim.frame(1).timing.exposure_ns, to_ns(0.03));
  EXPECT_EQ(sim.frame(2).timing.exposure_ns, to_ns(0.001));
}

TEST(Simulator, NoiseHasTheGivenDeviationAndIsReproducible) {
  const auto simulator = [](int seed) {
    Scene scene = scene_of(small_scene(kStill, "exposure_time: 0.02, noise: 3", "background: 100", ""));
    scene.seed = static_cast<std::uint64_t>(seed);
    return Simulator(scene);
  };
  Simulator sim = simulator(1), again = simulator(1), other = simulator(2);
  const cv::Mat a = sim.frame(0).image, b = again.frame(0).image, c = other.frame(0).image, next = sim.frame(1).image;
  EXPECT_EQ(cv::norm(a, b, cv::NORM_INF), 0);
  EXPECT_GT(cv::norm(a, c, cv::NORM_INF), 0);
  EXPECT_GT(cv::norm(a, next, cv::NORM_INF), 0);
  cv::Scalar mean, deviation;
  cv::meanStdDev(a, mean, deviation);
  EXPECT_NEAR(mean[0], 100, 0.1);
  EXPECT_NEAR(deviation[0], std::sqrt(9 + 1.0 / 12), 0.06);  // and rounding; 32000 pixels
  // Rows and frames do not repeat the same noise.
  EXPECT_GT(cv::norm(a.row(0), a.row(1), cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(sim.sharp(0), cv::Mat(160, 200, CV_8UC1, cv::Scalar(100)), cv::NORM_INF), 0);
}

TEST(Simulator, EncodingsShowTheSameScene) {
  const auto image = [](const std::string& encoding) {
    return Simulator(scene_of(small_scene(kStill, "exposure_time: 0.02, encoding: " + encoding))).sharp(0);
  };
  const cv::Mat bgr = image("bgr8"), rgb = image("rgb8"), grey = image("mono8"), wide = image("mono16");
  ASSERT_EQ(bgr.type(), CV_8UC3);
  ASSERT_EQ(wide.type(), CV_16UC1);
  cv::Mat swapped, from_bgr, narrowed;
  cv::cvtColor(rgb, swapped, cv::COLOR_RGB2BGR);
  EXPECT_EQ(cv::norm(bgr, swapped, cv::NORM_INF), 0);
  cv::cvtColor(bgr, from_bgr, cv::COLOR_BGR2GRAY);
  EXPECT_LE(cv::norm(from_bgr, grey, cv::NORM_INF), 2);  // rounding of texture and image in either order
  wide.convertTo(narrowed, CV_8U, 1.0 / 257);
  EXPECT_LE(cv::norm(narrowed, grey, cv::NORM_INF), 1);
  const struct {
    const char* encoding;
    int channels[2][2];  // BGR index at (row & 1, column & 1)
  } mosaics[] = {{"bayer_rggb8", {{2, 1}, {1, 0}}},
                 {"bayer_bggr8", {{0, 1}, {1, 2}}},
                 {"bayer_gbrg8", {{1, 0}, {2, 1}}},
                 {"bayer_grbg8", {{1, 2}, {0, 1}}}};
  for (const auto& mosaic : mosaics) {
    const cv::Mat bayer = image(mosaic.encoding);
    ASSERT_EQ(bayer.type(), CV_8UC1);
    int wrong = 0;
    for (int y = 0; y < bayer.rows; ++y) {
      for (int x = 0; x < bayer.cols; ++x) {
        wrong += bayer.at<uchar>(y, x) != bgr.at<cv::Vec3b>(y, x)[mosaic.channels[y & 1][x & 1]];
      }
    }
    EXPECT_EQ(wrong, 0) << mosaic.encoding;
  }
}

TEST(Imu, MeasuresRateAndSpecificForceInItsOwnAxes) {
  // camera x = IMU y, camera y = -IMU x.
  const Simulator sim(
      scene_of(small_scene("{type: constant_rate, rate: [10, 20, 30]}", "",
                           "imu: {rate: 100, time_offset: 0.25, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}")));
  const std::vector<ImuSample> imu = sim.imu();
  const Eigen::Vector3d expected = Eigen::Vector3d(-20, 10, 30) * kRadPerDeg;
  EXPECT_LT((imu.front().rate_rad_s - expected).norm(), 1e-12);
  // At zero orientation: gravity along camera y is along -IMU x; at rest the accelerometer reads the opposite.
  EXPECT_LT((imu.front().specific_force_m_s2 - Eigen::Vector3d(9.80665, 0, 0)).norm(), 1e-9);
  EXPECT_EQ(imu.front().t_ns, sim.scene().start_ns + to_ns(0.25));
  EXPECT_EQ(imu[7].t_ns - imu[6].t_ns, to_ns(0.01));
  // 0.2 s lead, frames at 0, 50, 100 ms, exposure 20 ms, 0.2 s more.
  EXPECT_EQ(imu.back().t_ns - imu.front().t_ns, to_ns(0.52));
}

TEST(Imu, AccelerationOfTheMotionIsMeasured) {
  const Simulator sim(
      scene_of(small_scene("{type: curve, position: {sines: [{amplitude: [0.1, 0, 0], frequency: 2, phase: 90}]}}", "",
                           "gravity: [0, 0, 0]")));
  const double w = 2 * M_PI * 2;
  EXPECT_NEAR(sim.imu().front().specific_force_m_s2.x(), -0.1 * w * w, 1e-9);
}

TEST(Imu, BiasNoiseAndSaturationAreAdded) {
  const std::string imu =
      "lead_time: 20\nimu: {rate: 500, gyro_bias: [0.1, -0.2, 0.3], gyro_noise: 0.05, accel_bias: [1, 2, 3], "
      "accel_noise: 0.4}\ngravity: [0, 0, 0]\n";
  std::string yaml = small_scene(kStill);
  yaml.replace(yaml.find("lead_time: 0.2\n"), 15, imu);
  const std::vector<ImuSample> samples = Simulator(scene_of(yaml)).imu();
  const double n = static_cast<double>(samples.size());
  ASSERT_GT(n, 20000);
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero(), gyro2 = gyro, accel = gyro, accel2 = gyro;
  double lag = 0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    gyro += samples[i].rate_rad_s / n;
    accel += samples[i].specific_force_m_s2 / n;
    gyro2 += samples[i].rate_rad_s.cwiseAbs2() / n;
    accel2 += samples[i].specific_force_m_s2.cwiseAbs2() / n;
    if (i > 0) lag += (samples[i].rate_rad_s.x() - 0.1) * (samples[i - 1].rate_rad_s.x() - 0.1) / n;
  }
  // Four standard errors.
  EXPECT_LT((gyro - Eigen::Vector3d(0.1, -0.2, 0.3)).cwiseAbs().maxCoeff(), 4 * 0.05 / std::sqrt(n));
  EXPECT_LT((accel - Eigen::Vector3d(1, 2, 3)).cwiseAbs().maxCoeff(), 4 * 0.4 / std::sqrt(n));
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(std::sqrt(gyro2[k] - gyro[k] * gyro[k]), 0.05, 4 * 0.05 / std::sqrt(2 * n));
    EXPECT_NEAR(std::sqrt(accel2[k] - accel[k] * accel[k]), 0.4, 4 * 0.4 / std::sqrt(2 * n));
  }
  EXPECT_LT(std::abs(lag) / (0.05 * 0.05), 4 / std::sqrt(n)) << "not white";

  const Simulator clipped(
      scene_of(small_scene("{type: constant_rate, rate: [200, -200, 10]}", "", "imu: {gyro_saturation: 2}")));
  EXPECT_LT((clipped.imu().front().rate_rad_s - Eigen::Vector3d(2, -2, 10 * kRadPerDeg)).norm(), 1e-12);
}

// Rates and accelerations of every kind of motion against numeric derivatives of its poses.
class MotionDerivatives : public ::testing::TestWithParam<const char*> {};

TEST_P(MotionDerivatives, AgreeWithThePoses) {
  const TemporaryFolder folder;
  std::string trace = "# t w\n", trajectory;
  for (int i = 0; i < 60; ++i) {
    const double t = i * 0.02;
    trace += std::to_string(static_cast<long long>(1e15 + t * 1e9)) + ", " + std::to_string(2 * std::sin(9 * t)) +
             ", " + std::to_string(3 * std::cos(7 * t)) + ", " + std::to_string(std::sin(5 * t)) + "\n";
    const Eigen::Quaterniond q(Eigen::AngleAxisd(0.7 * std::sin(4 * t), Eigen::Vector3d(1, 2, -1).normalized()) *
                               Eigen::AngleAxisd(0.5 * t, Eigen::Vector3d::UnitZ()));
    const double sign = i % 7 == 3 ? -1 : 1;  // q and -q are the same rotation
    for (const double v :
         {100 + t, std::sin(t), std::cos(3 * t), 0.2 * t, sign * q.x(), sign * q.y(), sign * q.z(), sign * q.w()}) {
      trajectory += std::to_string(v) + " ";
    }
    trajectory += "\n";
  }
  folder.write("trace.csv", trace);
  folder.write("trajectory.txt", trajectory);
  const std::string imu = "imu: {R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}";
  const Scene scene = scene_of(small_scene(GetParam(), "", imu), folder.string());
  const Motion& motion = *scene.motion;
  constexpr double kStep = 1e-4;
  double largest_rate = 0;
  for (const double t : {0.0131, 0.1234, 0.25, 0.3021, 0.451}) {
    const Eigen::Quaterniond rotation =
        motion.pose(t - kStep).R_world_cam.conjugate() * motion.pose(t + kStep).R_world_cam;
    const Eigen::AngleAxisd aa(rotation.w() < 0 ? Eigen::Quaterniond(-rotation.coeffs()) : rotation);
    // Central difference: error of h^2 / 6 times the third derivative, or h / 2 times the jump at a trace's kink.
    EXPECT_LT((aa.angle() * aa.axis() / (2 * kStep) - motion.rate(t)).norm(), 2e-3) << t;
    largest_rate = std::max(largest_rate, motion.rate(t).norm());
    const Eigen::Vector3d second_difference =
        motion.pose(t - kStep).p_world_m - 2 * motion.pose(t).p_world_m + motion.pose(t + kStep).p_world_m;
    EXPECT_LT((second_difference / (kStep * kStep) - motion.acceleration(t)).norm(), 0.02) << t;
    EXPECT_NEAR(motion.pose(t).R_world_cam.norm(), 1, 1e-12);
  }
  EXPECT_GT(largest_rate, 0.3);
}

INSTANTIATE_TEST_SUITE_P(
    Types, MotionDerivatives,
    ::testing::Values(
        "{type: curve, rotation: {offset: [10, -20, 5], rate: [20, 10, -30], sines: [{amplitude: [10, 3, -5], "
        "frequency: 3, phase: 40}, {amplitude: [0, 20, 5], frequency: 2, window: [0.1, 0.4]}]}, position: {sines: "
        "[{amplitude: [0.1, 0.2, 0.3], frequency: 1.5}, {amplitude: [0.2, 0, 0], frequency: 3, window: [0.05, 0.4]}]}}",
        "{type: constant_rate, rate: [50, -80, 20], orientation: [10, 20, 30], position: {rate: [1, 2, 3]}}",
        "{type: gyro_trace, file: trace.csv, start: 0.1, scale: 1.5, position: {sines: [{amplitude: [0.1, 0, 0], "
        "frequency: 2}]}}",
        "{type: trajectory, file: trajectory.txt, start: 0.05}",
        "{type: orbit, radius: 2, axis: [1, 2, 0], rate: 30, amplitude: 20, frequency: 2}"));

TEST(Motion, GyroTraceIsMeasuredBackUnchanged) {
  const TemporaryFolder folder;
  folder.write("trace.txt", "1000000000\t1\t2\t3\n1500000000\t2\t0\t-1\r\n\n# end\n2500000000\t2\t0\t-1E0\n");
  const Simulator sim(scene_of(small_scene("{type: gyro_trace, file: trace.txt, start: 0.25, scale: 2}", "",
                                           "imu: {rate: 4, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}"),
                               folder.string()));
  const std::vector<ImuSample> imu = sim.imu();
  EXPECT_LT((imu[0].rate_rad_s - 2 * Eigen::Vector3d(1.5, 1, 1)).norm(), 1e-9);
  EXPECT_LT((imu[1].rate_rad_s - 2 * Eigen::Vector3d(2, 0, -1)).norm(), 1e-9);
}

TEST(Motion, GyroTraceIntegratesAConstantRateExactly) {
  const auto motion = make_gyro_trace_motion({{0, {0.5, -1, 2}}, {3, {0.5, -1, 2}}}, 0, 1, Eigen::Matrix3d::Identity(),
                                             Eigen::Quaterniond::Identity(), VectorCurve{});
  const Eigen::Vector3d w(0.5, -1, 2);
  const double t = 2.71833;
  const Eigen::Quaterniond expected(Eigen::AngleAxisd(w.norm() * t, w.normalized()));
  EXPECT_LT(motion->pose(t).R_world_cam.angularDistance(expected), 1e-9);
}

TEST(Motion, TrajectoryPassesThroughItsSamples) {
  std::vector<TrajectorySample> samples;
  for (int i = 0; i < 8; ++i) {
    TrajectorySample s;
    s.t_s = 0.1 * i + (i % 2) * 0.03;
    s.pose.p_world_m = Eigen::Vector3d(i, i * i, -i);
    s.pose.R_world_cam = Eigen::AngleAxisd(0.4 * i, Eigen::Vector3d(1, i, 2).normalized());
    samples.push_back(s);
  }
  const auto motion = make_trajectory_motion(samples, 0.05);
  EXPECT_DOUBLE_EQ(motion->span().begin_s, -0.05);
  EXPECT_NEAR(motion->span().end_s, 0.73 - 0.05, 1e-12);
  for (const TrajectorySample& s : samples) {
    for (const double side : {-1e-9, 1e-9}) {
      const double t = std::clamp(s.t_s - 0.05 + side, motion->span().begin_s, motion->span().end_s);
      EXPECT_LT(motion->pose(t).R_world_cam.angularDistance(s.pose.R_world_cam), 1e-6);
      EXPECT_LT((motion->pose(t).p_world_m - s.pose.p_world_m).norm(), 1e-6);
    }
    // Rates do not jump at a sample.
    if (s.t_s == samples.front().t_s || s.t_s == samples.back().t_s) continue;
    EXPECT_LT((motion->rate(s.t_s - 0.05 - 1e-9) - motion->rate(s.t_s - 0.05 + 1e-9)).norm(), 1e-5);
  }
}

TEST(Files, MalformedLinesAreNamedWithFileAndLine) {
  const TemporaryFolder folder;
  const auto trace = [&](const std::string& text) {
    const std::string path = folder.write("gyro.txt", text);
    return error_of([&] { load_gyro_trace(path); });
  };
  expect_contains(trace("# head\n1 0 0 0\n2 0 x 0\n"), {"gyro.txt:3:", "'x' is not a finite number"});
  expect_contains(trace("1 0 0 0\n2 0 nan 0\n"), {"gyro.txt:2:", "'nan'"});
  expect_contains(trace("1 0 0 0\n2 0 0\n"), {"gyro.txt:2:", "3 columns, expected at least 4"});
  expect_contains(trace("1 0 0 0\n3 0 0 0\n3 0 0 0\n"), {"gyro.txt:3:", "not later"});
  expect_contains(trace("1 0 0 0\n"), {"gyro.txt: 1 lines"});
  expect_contains(trace(""), {"gyro.txt: 0 lines"});
  expect_contains(error_of([&] { load_gyro_trace(folder.string() + "/absent.txt"); }), {"absent.txt: cannot be read"});

  const auto trajectory = [&](const std::string& text) {
    const std::string path = folder.write("poses.txt", text);
    return error_of([&] { load_trajectory(path); });
  };
  expect_contains(trajectory("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0\n"), {"poses.txt:2:", "7 columns, expected at least 8"});
  expect_contains(trajectory("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0.5\n"),
                  {"poses.txt:2:", "quaternion = 0.5", "[0.99, 1.01]"});
  expect_contains(trajectory("0 0 0 0 0 0 0 1\n-1 0 0 0 0 0 0 1\n"), {"poses.txt:2:", "not later"});
}

TEST(Files, RecordedGyroscopesAreRead) {
  const std::string data = GYRO_DEBLUR_DATA_DIR;
  const std::string shake = data + "/handshake_gyro/gyro_test.txt", flight = data + "/euroc_v1_01/mav0/imu0/data.csv";
  if (!std::filesystem::exists(shake) || !std::filesystem::exists(flight)) GTEST_SKIP() << data << " is absent";
  const std::vector<TraceSample> a = load_gyro_trace(shake), b = load_gyro_trace(flight);
  EXPECT_NEAR(a.back().t_s, 57, 1);
  EXPECT_NEAR(b[1].t_s - b[0].t_s, 0.005, 1e-6);
  EXPECT_NEAR(b[0].rate_rad_s.z(), 0.0774926, 1e-6);
  Scene scene = scene_of(small_scene("{type: gyro_trace, file: " + shake + ", start: 10}"));
  EXPECT_GT(Simulator(scene).sub_exposures(0), 0);
}

TEST(SceneFile, ErrorsNameKeyValueAndRange) {
  const TemporaryFolder folder;
  const auto error = [](const std::string& yaml) { return error_of([&] { scene_of(yaml); }); };
  expect_contains(error(small_scene(kStill, "exposure_time: 2")), {"test.yaml: camera.exposure_time = 2", "1] s"});
  expect_contains(error(small_scene(kStill, "exposure_time: 0.02, fps2: 3")),
                  {"test.yaml: unknown keys: camera.fps2;"});
  expect_contains(error(small_scene(kStill, "exposure_time: 0.02, encoding: yuv422")),
                  {"camera.encoding = yuv422", "mono8", "bayer_rggb8"});
  expect_contains(error(small_scene(kStill, "exposure_time: 0.02, noise: -1")),
                  {"camera.noise = -1", "[0, 64] grey levels"});
  expect_contains(error(small_scene(kStill, "readout_time: 0.02")), {"camera.exposure_time is missing"});
  expect_contains(error(small_scene(kStill, "exposure_time: 0.02, stamp_row: second")),
                  {"camera.stamp_row = second", "first, middle, last"});
  expect_contains(error(small_scene(kStill, "exposure_time: soon")),
                  {"camera.exposure_time = soon is not a finite number"});
  expect_contains(error(small_scene(kStill, "exposure_time: 0.02, distortion_model: fisheye")),
                  {"camera.distortion_model = fisheye", "equidistant"});
  expect_contains(error(small_scene("{type: wobble}")), {"motion.type = wobble", "orbit"});
  expect_contains(error(small_scene("{type: constant_rate, rate: [1, 2]}")),
                  {"motion.rate = [1, 2] is not a list of 3 numbers"});
  expect_contains(error(small_scene("{type: constant_rate, rate: [1, .nan, 0]}")), {"motion.rate = .nan"});
  expect_contains(error(small_scene("{type: curve, rotation: {sines: [{amplitude: [1, 2, 3], frequency: -2}]}}")),
                  {"motion.rotation.sines[0].frequency = -2", "[0, 1000] Hz"});
  expect_contains(
      error(small_scene("{type: curve, rotation: {sines: [{amplitude: [1, 2, 3], frequency: 2, phase_deg: 1}]}}", "",
                        "colour: 1")),
      {"unknown keys: colour, motion.rotation.sines[0].phase_deg;"});
  const std::string trace = folder.write("short.txt", "0 0 0 0\n100000000 0 0 0\n");
  expect_contains(error(small_scene("{type: gyro_trace, file: " + trace + "}")),
                  {"motion covers", "scene lasts from 0 to 0.52"});
  expect_contains(error(small_scene("{type: gyro_trace, file: absent.txt}")), {"absent.txt: cannot be read"});
  expect_contains(error(small_scene(kStill, "", "imu: {R_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, -1]}")),
                  {"imu.R_cam_imu", "-1"});
  expect_contains(error(small_scene(kStill, "", "imu: {rate: 0}")), {"imu.rate = 0", "Hz"});
  expect_contains(error(small_scene(kStill, "", "", "{size: [1, 1], position: [0, 0, 1], texture: absent.png}")),
                  {"planes[0].texture", "absent.png"});
  expect_contains(error(small_scene(kStill, "", "", "{size: [0, 1], position: [0, 0, 1]}")),
                  {"planes[0].size[0] = 0", "m"});
  expect_contains(error("[1, 2]"), {"test.yaml: scene = [1, 2] is not a map"});
  expect_contains(
      error("camera: {size: [20, 10], intrinsics: [20, 20, 9, 4], fps: 20, exposure_time: 0.02}\nplanes: 5\n"),
      {"planes = 5 is not a list"});
  expect_contains(error("frames: 1.5\n"), {"frames", "not an integer"});
  expect_contains(error("camera: {size: [0, 5]}\nmotion: {}"), {"camera.size[0] = 0", "px"});
  expect_contains(error_of([&] { load_scene(folder.string() + "/none.yaml"); }), {"none.yaml: cannot be opened"});
  const std::string broken = folder.write("broken.yaml", "a: [1, 2\nb: }");
  expect_contains(error_of([&] { load_scene(broken); }), {"broken.yaml: "});
}

TEST(SceneFile, PhotographsAreTakenRelativeToTheScene) {
  const TemporaryFolder folder;
  cv::imwrite(folder.string() + "/grey.png", cv::Mat(40, 60, CV_8UC1, cv::Scalar(77)));
  const std::string path =
      folder.write("scene.yaml", small_scene(kStill, "", "", "{size: [9, 9], position: [0, 0, 2], texture: grey.png}"));
  EXPECT_EQ(Simulator(load_scene(path)).sharp(0).at<uchar>(80, 100), 77);
}

class ShippedScenes : public ::testing::TestWithParam<const char*> {};

TEST_P(ShippedScenes, LoadAndRenderWithoutAnyOtherFile) {
  Simulator sim(load_scene(std::string(GYRO_DEBLUR_SOURCE_DIR) + "/config/scenes/" + GetParam() + ".yaml"));
  cv::Scalar mean, deviation;
  cv::meanStdDev(sim.sharp(sim.frames() / 2), mean, deviation);
  EXPECT_GT(deviation[0], 20) << "hardly any texture in view";
  // The plane fills the view at all times.
  const CameraCalibration& c = sim.camera().calibration();
  for (int i = 0; i < sim.frames(); ++i) {
    for (const int x : {0, c.width_px - 1}) {
      for (const int y : {0, c.height_px - 1}) {
        const Pose pose = sim.pose(sim.exposure(i).middle(y));
        const Eigen::Vector3d d = pose.R_world_cam * sim.camera().ray({x, y});
        const double depth = (2 - pose.p_world_m.z()) / d.z();
        const Eigen::Vector3d p = pose.p_world_m + depth * d;
        EXPECT_LT(std::abs(p.x()), sim.scene().planes[0].width_m / 2) << i;
        EXPECT_LT(std::abs(p.y()), sim.scene().planes[0].height_m / 2) << i;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, ShippedScenes, ::testing::Values("handheld", "fast_1080p", "orbit", "rotation_test"));

TEST(Texture, ProceduralIsSeededAndNaturalLike) {
  const cv::Mat a = procedural_texture(512, 512, 1), b = procedural_texture(512, 512, 1),
                c = procedural_texture(512, 512, 2);
  EXPECT_EQ(cv::norm(a, b, cv::NORM_INF), 0);
  EXPECT_GT(cv::norm(a, c, cv::NORM_L1) / a.total(), 20);
  // Amplitude spectrum ~ 1/f: equal power in every octave, to within a factor of a few.
  cv::Mat grey, real, spectrum;
  cv::cvtColor(a, grey, cv::COLOR_BGR2GRAY);
  grey.convertTo(real, CV_32F);
  cv::dft(real - cv::mean(real), spectrum, cv::DFT_COMPLEX_OUTPUT);
  double octaves[6] = {};
  for (int v = 0; v < 512; ++v) {
    for (int u = 0; u < 512; ++u) {
      const double f = std::hypot(v < 256 ? v : v - 512, u < 256 ? u : u - 512);
      const int octave = f < 4 ? -1 : static_cast<int>(std::log2(f / 4));
      if (octave >= 0 && octave < 6)
        octaves[octave] +=
            std::norm(std::complex<float>(spectrum.at<cv::Vec2f>(v, u)[0], spectrum.at<cv::Vec2f>(v, u)[1]));
    }
  }
  for (int k = 1; k < 5; ++k) {
    EXPECT_LT(octaves[k] / octaves[0], 8) << k;
    EXPECT_GT(octaves[k] / octaves[0], 1.0 / 8) << k;
  }
}

TEST(Texture, LevelsKeepTheMeanAndAvoidAliasing) {
  // A checkerboard of single pixels is grey from afar.
  cv::Mat board(512, 512, CV_8UC1);
  for (int y = 0; y < 512; ++y) {
    for (int x = 0; x < 512; ++x) board.at<uchar>(y, x) = (x + y) % 2 == 0 ? 40 : 200;
  }
  Texture texture(board);
  EXPECT_EQ(texture.level_for(0.1), 0);
  EXPECT_EQ(texture.level_for(1.0), 0);
  EXPECT_EQ(texture.level_for(2.8 * 1.001), 4);  // one octave beyond 1.4 texels a pixel
  cv::Scalar mean, deviation;
  cv::meanStdDev(texture.level(6), mean, deviation);
  EXPECT_NEAR(mean[0], 120, 0.5);
  EXPECT_LT(deviation[0], 8);
  EXPECT_THROW(Texture(cv::Mat(8, 8, CV_8UC1)), OptionError);
  EXPECT_THROW(Texture(cv::Mat(32, 32, CV_16UC1)), OptionError);
}

}  // namespace
}  // namespace gyro_deblur::sim
