// The pipeline's global-shutter image.
#include <algorithm>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/pipeline.hpp"
#include "panning_camera.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::global_shutter_test {
namespace {

using test::kFocalPx;
using test::kHeight;
using test::kWidth;
using test::pan;

constexpr double kRateRadS = 2;
constexpr TimeNs kExposureNs = 20'000'000, kReadoutNs = 20'000'000;
constexpr TimeNs kStampNs = 1'000'000'000;
/// How far the image moves from the middle row to the last one.
constexpr double kMovePx = kFocalPx * kRateRadS * 0.01;

RowExposure exposure(TimeNs readout_ns) {
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  timing.readout_ns = readout_ns;
  return RowExposure(kStampNs, kHeight, timing);
}

/// Nothing is taken for blurred, nor to be moved but by the gyroscope: images are drawn sharp.
PipelineOptions options(bool deblurs = false) {
  PipelineOptions o;
  o.optical_flow = false;
  o.validation.rule = ValidationRule::NONE;
  if (!deblurs) {
    o.blur_field.min_extent_px = 20;
    o.blur_field.max_extent_px = 30;
  }
  return o;
}

PipelineResult process(const cv::Mat& image, PixelLayout layout, const CameraMotion& motion, const RowExposure& rows,
                       const PipelineOptions& with = options(), const FrameAction& action = {}) {
  Pipeline pipeline(with);
  pipeline.set_calibration(test::small_camera());
  PipelineRequest request;
  request.image = request.keypoints = false;
  request.global_shutter = true;
  pipeline.estimate(image, layout, motion, rows, request);
  pipeline.validate();
  return pipeline.deblur(action);
}

/// A vertical line as a camera that pans to the right shows it: leaning to the left, `above_px` further right on top.
cv::Mat leaning_edge(int depth) {
  cv::Mat image(kHeight, kWidth, CV_MAKETYPE(depth, 1));
  const double full = depth == CV_8U ? 255 : 4095;
  for (int y = 0; y < kHeight; ++y) {
    const double edge_px = kWidth / 2.0 + kMovePx * (1 - 2.0 * y / kHeight);
    for (int x = 0; x < kWidth; ++x) {
      const double value = full * std::clamp(0.5 + (x - edge_px) / 8, 0.1, 0.9);  // a ramp: subpixel places show
      if (depth == CV_8U) {
        image.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(value);
      } else {
        image.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(value);
      }
    }
  }
  return image;
}

/// Where a row of one channel crosses half of the range [px].
double edge_of(const cv::Mat& row, double half) {
  cv::Mat values;
  row.convertTo(values, CV_64F);
  for (int x = kWidth / 4; x + 1 < 3 * kWidth / 4; ++x) {
    const double here = values.at<double>(x), next = values.at<double>(x + 1);
    if (here <= half && next > half) return x + (half - here) / (next - here);
  }
  return -1;
}

TEST(PipelineGlobalShutter, ALeaningEdgeStandsUpright) {
  for (const int depth : {CV_8U, CV_16U}) {
    const cv::Mat image = leaning_edge(depth);
    const PipelineResult result = process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(kReadoutNs));
    ASSERT_EQ(result.global_shutter.type(), image.type());
    EXPECT_EQ(result.field.count(BlockStatus::DEBLURRED), 0u);
    EXPECT_TRUE(result.image.empty());
    EXPECT_EQ(result.reference_ns, exposure(kReadoutNs).reference_time(RectifyTo::MIDDLE_ROW));
    EXPECT_GT(result.times.global_shutter_ms, 0);
    const double half = depth == CV_8U ? 127.5 : 2047.5;
    EXPECT_GT(edge_of(image.row(2), half) - edge_of(image.row(kHeight - 3), half), 1.9 * kMovePx);
    // The middle row is exposed half a row before the middle of the readout.
    const double upright_px = edge_of(result.global_shutter.row(kHeight / 2), half);
    for (const int y : {2, 60, 180, kHeight - 3}) {
      EXPECT_NEAR(edge_of(result.global_shutter.row(y), half), upright_px, 0.1) << y;
    }
  }
}

TEST(PipelineGlobalShutter, IsTheDeblurredImageMoved) {
  const cv::Mat blurred = test::expose(test::blur_along_line(test::textured_image(kWidth, kHeight, 31), 0, 12), 1.0, 3);
  Pipeline pipeline(options(true));
  pipeline.set_calibration(test::small_camera());
  PipelineRequest request;
  request.keypoints = false;
  request.global_shutter = true;
  const PipelineResult result =
      pipeline.process(blurred, PixelLayout::GRAY, pan(kRateRadS), exposure(kReadoutNs), request);
  ASSERT_GT(result.field.count(BlockStatus::DEBLURRED), 0u);
  // The middle row stays where it is.
  const int y = (kHeight - 1) / 2;
  EXPECT_LT(cv::norm(result.global_shutter.row(y), result.image.row(y), cv::NORM_L1) / kWidth, 1);
  EXPECT_GT(cv::norm(result.global_shutter.row(y), blurred.row(y), cv::NORM_L1) / kWidth, 5);
  // Nobody need ask for the image as well.
  const PipelineResult alone = process(blurred, PixelLayout::GRAY, pan(kRateRadS), exposure(kReadoutNs), options(true));
  EXPECT_EQ(cv::norm(alone.global_shutter, result.global_shutter, cv::NORM_INF), 0);
}

TEST(PipelineGlobalShutter, AGlobalShutterIsUnchanged) {
  const cv::Mat image = leaning_edge(CV_8U);
  const PipelineResult sharp = process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(0));
  EXPECT_EQ(sharp.global_shutter.data, image.data);
  const PipelineResult deblurred = process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(0), options(true));
  ASSERT_FALSE(deblurred.image.empty());
  EXPECT_EQ(deblurred.global_shutter.data, deblurred.image.data);
  const PipelineResult mosaic = process(image, PixelLayout::BAYER_RGGB, pan(kRateRadS), exposure(0));
  EXPECT_EQ(mosaic.global_shutter.data, image.data);
  PipelineOptions elsewhere = options();
  elsewhere.rectify_to = RectifyTo::STAMP;
  EXPECT_NE(process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(0), elsewhere).global_shutter.data, image.data);
}

TEST(PipelineGlobalShutter, AMosaicBecomesColours) {
  for (const int depth : {CV_8U, CV_16U}) {
    const double unit = depth == CV_8U ? 1 : 16;
    // One colour, and an edge in all three.
    cv::Mat edge = leaning_edge(depth), mosaic(edge.size(), edge.type());
    const double shares[2][2] = {{0.4, 0.8}, {0.8, 1.0}};  // red, green; green, blue
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double value =
            shares[y % 2][x % 2] * (depth == CV_8U ? edge.at<std::uint8_t>(y, x) : edge.at<std::uint16_t>(y, x));
        if (depth == CV_8U) {
          mosaic.at<std::uint8_t>(y, x) = cv::saturate_cast<std::uint8_t>(value);
        } else {
          mosaic.at<std::uint16_t>(y, x) = cv::saturate_cast<std::uint16_t>(value);
        }
      }
    }
    const PipelineResult result = process(mosaic, PixelLayout::BAYER_RGGB, pan(kRateRadS), exposure(kReadoutNs));
    ASSERT_EQ(result.global_shutter.type(), CV_MAKETYPE(depth, 3));
    const cv::Scalar bright = cv::mean(result.global_shutter(cv::Rect(kWidth - 60, 20, 40, kHeight - 40)));
    EXPECT_NEAR(bright[0], 0.9 * 1.0 * 255 * unit, 3 * unit);
    EXPECT_NEAR(bright[1], 0.9 * 0.8 * 255 * unit, 3 * unit);
    EXPECT_NEAR(bright[2], 0.9 * 0.4 * 255 * unit, 3 * unit);
    cv::Mat green;
    cv::extractChannel(result.global_shutter, green, 1);
    const double half = 0.8 * 127.5 * unit;
    EXPECT_NEAR(edge_of(green.row(3), half), edge_of(green.row(kHeight - 4), half), 0.3);
  }
}

TEST(PipelineGlobalShutter, ColoursKeepTheirLayoutAndTheBorderIsBlack) {
  cv::Mat color;
  cv::cvtColor(leaning_edge(CV_8U), color, cv::COLOR_GRAY2RGBA);
  const PipelineResult moved = process(color, PixelLayout::RGBA, pan(kRateRadS), exposure(kReadoutNs));
  EXPECT_EQ(moved.global_shutter.type(), CV_8UC4);
  // The first row moves to the left by six pixels, the last one to the right.
  EXPECT_EQ(moved.global_shutter.at<cv::Vec4b>(0, kWidth - 1), cv::Vec4b(0, 0, 0, 0));
  EXPECT_EQ(moved.global_shutter.at<cv::Vec4b>(kHeight - 1, 0), cv::Vec4b(0, 0, 0, 0));
}

TEST(PipelineGlobalShutter, WhatCannotBeMovedIsNone) {
  const cv::Mat image = leaning_edge(CV_8U);
  EXPECT_TRUE(
      process(image, PixelLayout::GRAY, pan(kRateRadS, 3 * kStampNs), exposure(kReadoutNs)).global_shutter.empty());
  EXPECT_TRUE(process(image, PixelLayout::GRAY, pan(kRateRadS, 3 * kStampNs), exposure(0)).global_shutter.empty());
  const FrameAction pass_through{"not this one", ""};
  EXPECT_TRUE(process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(kReadoutNs), options(), pass_through)
                  .global_shutter.empty());
  Pipeline pipeline(options());
  pipeline.set_calibration(test::small_camera());
  EXPECT_TRUE(
      pipeline.process(image, PixelLayout::GRAY, pan(kRateRadS), exposure(kReadoutNs), {}).global_shutter.empty());
}

}  // namespace
}  // namespace gyro_deblur::global_shutter_test
