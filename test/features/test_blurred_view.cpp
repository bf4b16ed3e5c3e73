#include "features/blurred_view.hpp"

#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "features/corner_prediction.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/gyro_buffer.hpp"

namespace gyro_deblur::blurred_view_test {
namespace {

constexpr TimeNs kExposureNs = 20'000'000, kPeriodNs = 50'000'000;
const cv::Size kSize(320, 240);
const Eigen::Vector2d kPixel(100, 150), kVelocityPxS(60, -20);
constexpr double kFocalPx = 250, kRollRadS = 0.8;

Camera camera(const std::string& model = "none", const std::vector<double>& coefficients = {}) {
  CameraCalibration calibration;
  calibration.width_px = kSize.width;
  calibration.height_px = kSize.height;
  calibration.fx_px = calibration.fy_px = kFocalPx;
  calibration.cx_px = 160;
  calibration.cy_px = 120;
  calibration.model = model;
  calibration.coefficients = coefficients;
  return Camera(calibration);
}

/// The camera rolls: what it sees rotates about the optical axis, the other way.
RotationTrack rolling(TimeNs end_ns = 200'000'000) {
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = 0; t_ns <= end_ns; t_ns += 5'000'000) samples.push_back({t_ns, {0, 0, kRollRadS}});
  return RotationTrack(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
}

RowExposure exposure(int frame) {
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  return RowExposure(20'000'000 + frame * kPeriodNs, kSize.height, timing);
}

FrameBlur moving_field() {
  FrameBlur field;
  field.grid = BlockGrid(kSize.width, kSize.height, 32);
  field.noise = 2;
  BlockBlur block;
  block.residual = ResidualVelocity{kVelocityPxS, 1};
  field.blocks.assign(static_cast<std::size_t>(field.grid.size()), block);
  return field;
}

Eigen::Vector2d rolled(const Eigen::Vector2d& pixel_px, double seconds) {
  const Eigen::Vector2d center_px(160, 120);
  return center_px + Eigen::Rotation2Dd(-kRollRadS * seconds) * (pixel_px - center_px);
}

PredictedPoint predicted_from(const BlurredView& before, const BlurredView& now, const CameraMotion& motion) {
  const Camera lens = camera();
  return predict_point(kPixel, NearbyRays(lens, kPixel, lens.ray(kPixel)), before, now, motion);
}

class BlurredViewTest : public testing::Test {
 protected:
  const cv::Mat image_ = cv::Mat(kSize, CV_8UC1, cv::Scalar(90));
  const FrameBlur field_ = moving_field();
};

TEST_F(BlurredViewTest, PixelsAtHalfTheSizeAreMeansOfFour) {
  // The last column and row of an odd size have no partners.
  cv::Mat image(5, 5, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    for (int x = 0; x < image.cols; ++x) image.at<unsigned char>(y, x) = static_cast<unsigned char>(10 * y + 4 * x);
  }
  const BlurredView view(image, exposure(0), nullptr);
  const cv::Mat& half = view.half_size();
  ASSERT_EQ(half.size(), cv::Size(2, 2));
  for (int y = 0; y < 2; ++y) {
    for (int x = 0; x < 2; ++x) EXPECT_EQ(half.at<unsigned char>(y, x), 20 * y + 8 * x + 7) << x << ", " << y;
  }
  cv::Mat same_pixels = half;
  same_pixels.at<unsigned char>(0, 0) = 255;
  EXPECT_EQ(view.half_size().at<unsigned char>(0, 0), 255) << "made again";
}

TEST_F(BlurredViewTest, PathIsThatOfRotationAndResidualVelocity) {
  const BlurredView view(image_, exposure(0), &field_);
  const BlurredPoint point = view.point_at(kPixel, camera().ray(kPixel), camera(), rolling());
  EXPECT_EQ(point.place_px, kPixel);
  EXPECT_EQ(point.noise, 2);
  for (int k = 0; k < kPathInstants; ++k) {
    const double since_middle_s = to_seconds(kExposureNs) * (static_cast<double>(k) / (kPathInstants - 1) - 0.5);
    const Eigen::Vector2d expected_px = rolled(kPixel, since_middle_s) + since_middle_s * kVelocityPxS - kPixel;
    EXPECT_LT((point.path_px[static_cast<std::size_t>(k)].cast<double>() - expected_px).norm(), 1e-3) << k;
  }
}

TEST_F(BlurredViewTest, PathIsWhatARollingShutterRecords) {
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  timing.readout_ns = 48'000'000;
  FrameBlur field = field_;
  for (BlockBlur& block : field.blocks) block.residual = ResidualVelocity{{100, 500}, 1};
  const BlurredView view(image_, RowExposure(20'000'000, kSize.height, timing), &field);
  const RotationTrack still({}, GyroOptions{}, Eigen::Matrix3d::Identity());
  const BlurredPoint point = view.point_at(kPixel, camera().ray(kPixel), camera(), still);
  // 500 rows a second, and 0.2 ms a row: a tenth of a row for each.
  const Eigen::Vector2d expected_px = to_seconds(kExposureNs) * Eigen::Vector2d(100, 500) / (1 - 0.1);
  EXPECT_LT(((point.path_px.back() - point.path_px.front()).cast<double>() - expected_px).norm(), 1e-3);
}

TEST_F(BlurredViewTest, WhatIsNotKnownOfTheMotionCountsAsNone) {
  const BlurredView unknown(image_, exposure(0), nullptr), moving(image_, exposure(0), &field_);
  const RotationTrack nothing({}, GyroOptions{}, Eigen::Matrix3d::Identity());
  for (const Eigen::Vector2f& place_px : unknown.point_at(kPixel, camera().ray(kPixel), camera(), nothing).path_px) {
    EXPECT_TRUE(place_px.isZero());
  }
  EXPECT_FALSE(unknown.residual_at(kPixel).is_known);
  const BlurredPoint by_images = moving.point_at(kPixel, camera().ray(kPixel), camera(), nothing);
  EXPECT_LT((by_images.path_px.back().cast<double>() - 0.5 * to_seconds(kExposureNs) * kVelocityPxS).norm(), 1e-4);
}

TEST_F(BlurredViewTest, ResidualVelocitiesFillGapsFromTheirNeighbours) {
  FrameBlur field = field_;
  const auto middle = static_cast<std::size_t>(field.grid.index_at(kPixel.x(), kPixel.y()));
  field.blocks[middle].residual.reset();
  EXPECT_LT((BlurredView(image_, exposure(0), &field).residual_at(kPixel).velocity_px_s - kVelocityPxS).norm(), 1e-9);
  for (BlockBlur& block : field.blocks) block.residual.reset();
  EXPECT_FALSE(BlurredView(image_, exposure(0), &field).residual_at(kPixel).is_known);
}

TEST_F(BlurredViewTest, PredictsPlaceAndMap) {
  const BlurredView before(image_, exposure(0), &field_), now(image_, exposure(1), &field_);
  const double seconds = to_seconds(kPeriodNs);
  const PredictedPoint predicted = predicted_from(before, now, rolling());
  EXPECT_TRUE(predicted.by_residual);
  EXPECT_LT((predicted.place_px - rolled(kPixel, seconds) - seconds * kVelocityPxS).norm(), 1e-3);
  const Eigen::Matrix2d rotation = Eigen::Rotation2Dd(-kRollRadS * seconds).toRotationMatrix();
  EXPECT_LT((predicted.map.jacobian - rotation).norm(), 1e-4);
  EXPECT_LT((predicted.rotated_px - rolled(kPixel, seconds)).norm(), 1e-3);
  EXPECT_LT((predicted.rotated_map - rotation).norm(), 1e-4);

  const BlurredView unknown(image_, exposure(1), nullptr);
  EXPECT_FALSE(predicted_from(BlurredView(image_, exposure(0), nullptr), unknown, rolling()).by_residual);
  const PredictedPoint still = predicted_from(BlurredView(image_, exposure(0), nullptr), unknown,
                                              RotationTrack({}, GyroOptions{}, Eigen::Matrix3d::Identity()));
  EXPECT_EQ(still.place_px, kPixel);
  EXPECT_LT((still.map.jacobian - Eigen::Matrix2d::Identity()).norm(), 1e-9);
}

TEST_F(BlurredViewTest, RotatedMapIsTheJacobianOfWhereItTakesPixels) {
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = 0; t_ns <= 200'000'000; t_ns += 5'000'000) samples.push_back({t_ns, {0.5, -0.3, kRollRadS}});
  const RotationTrack motion(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
  for (const Camera& lens : {camera(), camera("plumb_bob", {-0.28, 0.07, 2e-4, 1e-4})}) {
    for (const TimeNs readout_ns : {0, 40'000'000, -40'000'000}) {
      ShutterTiming timing;
      timing.exposure_ns = kExposureNs;
      timing.readout_ns = readout_ns;
      const RowExposure first(50'000'000, kSize.height, timing), second(100'000'000, kSize.height, timing);
      const PredictedPoint predicted =
          predict_point(kPixel, NearbyRays(lens, kPixel, lens.ray(kPixel)), BlurredView(image_, first, nullptr),
                        BlurredView(image_, second, nullptr), motion);
      Eigen::Matrix2d expected;
      for (int axis = 0; axis < 2; ++axis) {
        const Eigen::Vector2d step_px = 0.5 * Eigen::Vector2d::Unit(axis);
        expected.col(axis) = predicted_pixel(kPixel + step_px, lens, motion, first, second).value() -
                             predicted_pixel(kPixel - step_px, lens, motion, first, second).value();
      }
      EXPECT_LT((predicted.rotated_map - expected).norm(), 2e-4) << readout_ns;
      if (readout_ns == 0) {
        const Eigen::Vector2d offset_px(17, -12);
        const Eigen::Vector3d squares(17 * 17, -17 * 12, 12 * 12);
        const Eigen::Vector2d not_affine_px = predicted_pixel(kPixel + offset_px, lens, motion, first, second).value() -
                                              predicted.rotated_px - expected * offset_px;
        EXPECT_GT(not_affine_px.norm(), 0.004);
        EXPECT_LT((predicted.map.quadratic * squares - not_affine_px).norm(), 0.1 * not_affine_px.norm());
      }
      EXPECT_LT((lens.project(predicted.near->ray(predicted.rotated_px)) - predicted.rotated_px).norm(), 1e-5);
    }
  }
}

TEST_F(BlurredViewTest, WhereTheMotionEndsWithTheImageTheMapIsThatOfOneInstant) {
  constexpr TimeNs kReadoutNs = 40'000'000, kEndNs = 100'000'000 + kReadoutNs + kExposureNs;
  std::vector<GyroSample> samples;
  for (TimeNs t_ns = 0; t_ns <= kEndNs; t_ns += 5'000'000) samples.push_back({t_ns, {0.5, -0.3, kRollRadS}});
  const RotationTrack motion(samples, GyroOptions{}, Eigen::Matrix3d::Identity());
  ShutterTiming timing;
  timing.exposure_ns = 200'000;
  timing.readout_ns = kReadoutNs;
  const RowExposure first(50'000'000, kSize.height, timing), second(kEndNs - kReadoutNs, kSize.height, timing);
  const Eigen::Vector2d last_px(kPixel.x(), kSize.height - 2.0);
  const Camera lens = camera();
  const PredictedPoint predicted =
      predict_point(last_px, NearbyRays(lens, last_px, lens.ray(last_px)), BlurredView(image_, first, nullptr),
                    BlurredView(image_, second, nullptr), motion);
  EXPECT_GT((predicted.rotated_px - last_px).norm(), 1);
  EXPECT_GT((predicted.rotated_map - Eigen::Matrix2d::Identity()).norm(), 1e-3);
}

}  // namespace
}  // namespace gyro_deblur::blurred_view_test
