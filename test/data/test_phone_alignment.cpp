// Points on a carpet, a plane, in photographs of a hand-held phone that were exposed for 240 ms: aligned from one to
// the other they fit a homography.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Core>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "blur/image_noise.hpp"
#include "features/blur_alignment.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

const std::string kFolder = std::string(GYRO_DEBLUR_DATA_DIR) + "/phone_long_exposure/";

/// Rows of numbers of a CSV file; its first line names the columns.
std::vector<std::vector<double>> read_rows(const std::string& path) {
  std::ifstream file(path);
  std::string line, cell;
  std::getline(file, line);
  std::vector<std::vector<double>> rows;
  while (std::getline(file, line)) {
    std::istringstream cells(line);
    rows.emplace_back();
    while (std::getline(cells, cell, ',')) rows.back().push_back(std::stod(cell));
  }
  return rows;
}

CameraCalibration calibration() {
  CameraCalibration result;
  result.width_px = 1080;
  result.height_px = 1920;
  result.fx_px = result.fy_px = 1401.8;
  result.cx_px = 540;
  result.cy_px = 960;
  return result;
}

RotationTrack rotation() {
  std::vector<GyroSample> samples;
  for (const std::vector<double>& row : read_rows(kFolder + "gyro_accel.csv")) {
    samples.push_back({static_cast<TimeNs>(row[0]), {row[1], row[2], row[3]}});
  }
  // Upright: x along the image's rows, y and z against the gyroscope's.
  return RotationTrack(samples, GyroOptions{}, Eigen::Vector3d(1, -1, -1).asDiagonal());
}

struct Frame {
  cv::Mat image;
  RowExposure exposure;
  double noise;
};

/// @param number  of its file
Frame load(int number) {
  const std::array<int, 4> numbers{3, 4, 6, 7};
  const auto index = static_cast<std::size_t>(std::find(numbers.begin(), numbers.end(), number) - numbers.begin());
  const std::vector<double> row = read_rows(kFolder + "movie_metadata.csv").at(index);
  // The sensor is read along the upright image's rows, in 5.6 of 240 ms: every pixel counts as one in the middle.
  ShutterTiming timing;
  timing.exposure_ns = static_cast<TimeNs>(row[4]);
  Frame frame{cv::imread(kFolder + "frame" + std::to_string(number) + ".jpg", cv::IMREAD_GRAYSCALE),
              RowExposure(static_cast<TimeNs>(row[0] + row[6] / 2), 1920, timing), 0};
  frame.noise = image_noise(frame.image, PixelLayout::GRAY).value();
  return frame;
}

BlurredPoint blurred(const Frame& frame, const Eigen::Vector2d& place_px, const Camera& camera,
                     const CameraMotion& motion) {
  BlurredPoint point{place_px, still_path(), frame.noise};
  const TimeNs start_ns = frame.exposure.start(0), middle_ns = frame.exposure.middle(0), end_ns = frame.exposure.end(0);
  for (int k = 0; k < kPathInstants; ++k) {
    const Eigen::Matrix3d from_middle =
        motion.rotation(middle_ns, start_ns + (end_ns - start_ns) * k / (kPathInstants - 1));
    point.path_px[static_cast<std::size_t>(k)] =
        (camera.project(from_middle * camera.ray(place_px)) - place_px).cast<float>();
  }
  return point;
}

std::vector<cv::Point2f> corners_on_carpet(const cv::Mat& image) {
  cv::Mat carpet(image.size(), CV_8UC1, cv::Scalar(0));
  cv::fillPoly(carpet, std::vector<std::vector<cv::Point>>{{{560, 1330}, {1060, 1500}, {1060, 1880}, {720, 1880}}},
               cv::Scalar(255));
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 400, 0.005, 12, carpet, 9);
  return corners;
}

Eigen::Vector2d moved(const cv::Matx33d& H, const Eigen::Vector2d& p) {
  const cv::Vec3d q = H * cv::Vec3d(p.x(), p.y(), 1);
  return {q[0] / q[2], q[1] / q[2]};
}

Eigen::Matrix2d jacobian(const cv::Matx33d& H, const Eigen::Vector2d& p) {
  constexpr double kStepPx = 1;
  Eigen::Matrix2d result;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector2d step_px = kStepPx * Eigen::Vector2d::Unit(axis);
    result.col(axis) = (moved(H, p + step_px) - moved(H, p - step_px)) / (2 * kStepPx);
  }
  return result;
}

/// Points that were found, and the median distance of the second image's from a homography of the first's.
struct Fit {
  std::size_t points;
  double median_px;
  cv::Matx33d homography;
};

Fit fit(const std::vector<cv::Point2f>& from, const std::vector<cv::Point2f>& to) {
  constexpr double kRansacPx = 2;
  cv::setRNGSeed(1);
  const cv::Mat found = cv::findHomography(from, to, cv::RANSAC, kRansacPx);
  if (found.empty()) return {from.size(), 1e9, cv::Matx33d::eye()};
  const cv::Matx33d H = found;
  std::vector<double> distances_px;
  for (std::size_t i = 0; i < from.size(); ++i) {
    distances_px.push_back((moved(H, {from[i].x, from[i].y}) - Eigen::Vector2d(to[i].x, to[i].y)).norm());
  }
  const auto middle = distances_px.begin() + static_cast<std::ptrdiff_t>(distances_px.size() / 2);
  std::nth_element(distances_px.begin(), middle, distances_px.end());
  return {from.size(), *middle, H};
}

Fit fit_by_ordinary_tracking(const Frame& first, const Frame& second, const std::vector<cv::Point2f>& corners) {
  std::vector<cv::Point2f> from, to, places;
  std::vector<uchar> found;
  std::vector<float> unused;
  cv::calcOpticalFlowPyrLK(first.image, second.image, corners, places, found, unused, {31, 31}, 5);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (found[i] == 0) continue;
    from.push_back(corners[i]);
    to.push_back(places[i]);
  }
  return fit(from, to);
}

struct Frames {
  int first, second;
  double most_px;
};

class PhoneAlignment : public testing::TestWithParam<Frames> {};

TEST_P(PhoneAlignment, PointsOnTheCarpetFitAHomography) {
  if (!std::filesystem::exists(kFolder + "movie_metadata.csv")) GTEST_SKIP() << "no data at " << kFolder;
  const Frames& frames = GetParam();
  const Frame first = load(frames.first), second = load(frames.second);
  const Camera camera(calibration());
  const RotationTrack motion = rotation();
  const std::vector<cv::Point2f> corners = corners_on_carpet(first.image);
  const Fit ordinary = fit_by_ordinary_tracking(first, second, corners);

  BlurAligner aligner;
  AlignmentOptions options;
  std::vector<cv::Point2f> from, to;
  for (const cv::Point2f& corner : corners) {
    const Eigen::Vector2d at_px(corner.x, corner.y), start_px = moved(ordinary.homography, at_px);
    const auto alignment =
        aligner.align(first.image, blurred(first, at_px, camera, motion), second.image,
                      blurred(second, start_px, camera, motion), jacobian(ordinary.homography, at_px), options);
    if (!alignment) continue;
    from.push_back(corner);
    to.emplace_back(static_cast<float>(alignment->place_px.x()), static_cast<float>(alignment->place_px.y()));
  }
  const Fit result = fit(from, to);
  std::printf("%d to %d: %zu of %zu points, median %.3f px; start %zu, %.3f px\n", frames.first, frames.second,
              result.points, corners.size(), result.median_px, ordinary.points, ordinary.median_px);
  EXPECT_GE(result.points, 350u);
  EXPECT_LE(result.median_px, frames.most_px);
}

INSTANTIATE_TEST_SUITE_P(Frames, PhoneAlignment,
                         testing::Values(Frames{6, 7, 0.25}, Frames{6, 4, 0.30}, Frames{4, 7, 0.40}),
                         [](const auto& frames) {
                           return std::to_string(frames.param.first) + "To" + std::to_string(frames.param.second);
                         });

}  // namespace
}  // namespace gyro_deblur
