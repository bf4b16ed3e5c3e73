// What does not move with the camera, in images that do: a fisheye's rim, and a part of the vehicle.
#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "features/residual_flow.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::static_rim_test {
namespace {

constexpr int kWidthPx = 480, kHeightPx = 352, kRadiusPx = 220;
constexpr double kFocalPx = 1500;  // so long that a rotation moves all of the image equally
constexpr double kExtentPx = 12;
constexpr TimeNs kExposureNs = 20'000'000, kPeriodNs = 50'000'000, kStartNs = 1'000'000'000;
constexpr double kStepPx = kExtentPx * kPeriodNs / kExposureNs;
constexpr int kImages = 45;  // 2.2 s

CameraCalibration calibration() {
  CameraCalibration c;
  c.width_px = kWidthPx;
  c.height_px = kHeightPx;
  c.fx_px = c.fy_px = kFocalPx;
  c.cx_px = (kWidthPx - 1) / 2.0;
  c.cy_px = (kHeightPx - 1) / 2.0;
  return c;
}

RowExposure exposure_of(int image) {
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  return RowExposure(kStartNs + image * kPeriodNs, kHeightPx, timing);
}

/// A pan of kExtentPx within an exposure, all the time.
const RotationTrack& motion() {
  static const RotationTrack kMotion = [] {
    const double rate_rad_s = kExtentPx / kFocalPx / to_seconds(kExposureNs);
    std::vector<GyroSample> samples;
    for (TimeNs t = 0; t <= kStartNs + (kImages + 2) * kPeriodNs; t += 5'000'000) {
      samples.push_back({t, {0, rate_rad_s, 0}});
    }
    return RotationTrack(samples, {}, Eigen::Matrix3d::Identity());
  }();
  return kMotion;
}

/// The scene, sharp and as the pan blurs it, on the way that the camera looks along.
const cv::Mat& scene(bool blurred) {
  static const cv::Mat kSharp =
      test::textured_image(kWidthPx + static_cast<int>(kStepPx * kImages) + 100, kHeightPx, 17);
  static const cv::Mat kBlurred = test::blur_along_line(kSharp, 0, kExtentPx);
  return blurred ? kBlurred : kSharp;
}

/// The direction in which the pan moves the scene.
int way() {
  const Camera camera(calibration());
  const Eigen::Vector2d center_px(0.5 * (kWidthPx - 1), 0.5 * (kHeightPx - 1));
  const TimeNs from_ns = exposure_of(0).middle(0), to_ns = exposure_of(1).middle(0);
  const Eigen::Vector2d moved_px = camera.project(motion().rotation(from_ns, to_ns) * camera.ray(center_px));
  EXPECT_NEAR(std::abs(moved_px.x() - center_px.x()), kStepPx, 0.05);
  return moved_px.x() > center_px.x() ? 1 : -1;
}

cv::Mat round_window() {
  cv::Mat used(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(0));
  cv::circle(used, {kWidthPx / 2, kHeightPx / 2}, kRadiusPx, cv::Scalar(255), cv::FILLED);
  return used;
}

cv::Rect bumper_px() { return {90, 250, 300, kHeightPx - 250}; }

cv::Mat above_bumper() {
  cv::Mat used(kHeightPx, kWidthPx, CV_8UC1, cv::Scalar(255));
  used(bumper_px()).setTo(0);
  return used;
}

/// Black beyond the lens's image.
void add_rim(cv::Mat& image) { image.setTo(6, round_window() == 0); }

/// Bright, sharp and textured.
void add_bumper(cv::Mat& image) {
  scene(false)(cv::Rect({0, 0}, bumper_px().size())).convertTo(image(bumper_px()), image.type(), 0.4, 150);
}

using StaticPart = std::function<void(cv::Mat&)>;

cv::Mat image_of(int image, const StaticPart& add) {
  const int along_px = cvRound(kStepPx * image);
  const int x = way() < 0 ? 20 + along_px : scene(true).cols - kWidthPx - 20 - along_px;
  cv::Mat view = scene(true)(cv::Rect(x, 0, kWidthPx, kHeightPx)).clone();
  add(view);
  return test::expose(view, 1.0, static_cast<std::uint64_t>(10 + image));
}

PipelineOptions options() {
  PipelineOptions o;
  o.blur_field.block_size_px = 32;
  o.keypoints.detector = o.keypoints.descriptor = "ORB";
  o.keypoints.max_keypoints = 400;
  return o;
}

struct Seen {
  cv::Mat input;
  PipelineResult result;

  const cv::Mat& output() const { return result.image.empty() ? input : result.image; }
};

/// The first and the last of the images.
std::pair<Seen, Seen> process(const StaticPart& add, const PixelMask& mask, const PipelineOptions& with = options()) {
  Pipeline pipeline(with);
  pipeline.set_calibration(calibration());
  pipeline.set_mask(mask);
  std::pair<Seen, Seen> ends;
  for (int i = 0; i < kImages; ++i) {
    Seen seen{image_of(i, add), {}};
    PipelineRequest request;
    request.keypoints = i + 1 == kImages;
    request.luminance = true;
    seen.result = pipeline.process(seen.input, PixelLayout::GRAY, motion(), exposure_of(i), request);
    (i == 0 ? ends.first : ends.second) = seen;
  }
  return ends;
}

/// What lies on the one side of a static edge, or on both, and has it within its filter's reach along the motion.
cv::Mat along_edge(const cv::Mat& used, bool static_side_alone) {
  cv::Mat wide, narrow;
  const cv::Mat element = cv::getStructuringElement(cv::MORPH_RECT, {2 * 20 + 1, 1});
  cv::dilate(used, wide, element);
  cv::erode(used, narrow, element);
  return static_side_alone ? wide & (used == 0) : wide & (narrow == 0);
}

/// Mean change [grey levels] of what is static: rings.
double ringing(const Seen& seen, const cv::Mat& used) {
  cv::Mat change;
  cv::absdiff(seen.input, seen.output(), change);
  return cv::mean(change, along_edge(used, true))[0];
}

std::size_t corners_at_edge(const cv::Mat& image, const cv::Mat& used) {
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 2000, 0.01, 5, along_edge(used, false));
  return corners.size();
}

struct Case {
  const char* name;
  StaticPart add;
  cv::Mat used;
};

std::vector<Case> cases() { return {{"rim", add_rim, round_window()}, {"bumper", add_bumper, above_bumper()}}; }

TEST(StaticRim, IsFoundAndPassedThroughWithoutAMask) {
  for (const Case& each : cases()) {
    SCOPED_TRACE(each.name);
    PipelineOptions trusting = options();
    trusting.validation.rule = ValidationRule::NONE;
    trusting.optical_flow = false;
    for (const PipelineOptions& with : {options(), trusting}) {
      const auto [first, last] = process(each.add, {}, with);
      EXPECT_EQ(first.result.static_share, 0) << "nobody can know yet";
      const double share = 1 - cv::countNonZero(each.used) / (1.0 * kWidthPx * kHeightPx);
      EXPECT_GT(last.result.static_share, 0.2 * share);
      EXPECT_LT(last.result.static_share, 1.5 * share);
      EXPECT_GT(last.result.field.count(BlockStatus::STATIC_EDGE), 10u);
      EXPECT_EQ(last.result.field.count(BlockStatus::MASKED), 0u);
      EXPECT_GT(last.result.field.count(BlockStatus::DEBLURRED), 30u) << "the rest is deblurred";
      EXPECT_LT(ringing(last, each.used), 0.5);
      EXPECT_LE(corners_at_edge(last.output(), each.used), corners_at_edge(last.input, each.used));
      if (with.validation.rule == ValidationRule::NONE) {
        // What it comes to otherwise.
        EXPECT_GT(ringing(first, each.used), 10);
        EXPECT_GT(corners_at_edge(first.output(), each.used), 1.5 * corners_at_edge(first.input, each.used));
      }
    }
  }
}

TEST(StaticRim, MaskedPixelsLeaveAsTheyCame) {
  for (const Case& each : cases()) {
    SCOPED_TRACE(each.name);
    const PixelMask mask(each.used);
    PipelineOptions trusting = options();
    trusting.validation.rule = ValidationRule::NONE;
    PipelineOptions in_2d = trusting;
    in_2d.engine = "fourier";
    for (const PipelineOptions& with : {options(), trusting, in_2d}) {
      const auto [first, last] = process(each.add, mask, with);
      for (const Seen* seen : {&first, &last}) {
        const FrameBlur& field = seen->result.field;
        EXPECT_EQ(seen->result.static_share, 0) << "it is masked";
        EXPECT_GT(field.count(BlockStatus::MASKED), 5u);
        EXPECT_GT(field.count(BlockStatus::STATIC_EDGE), 5u);
        EXPECT_GT(field.count(BlockStatus::DEBLURRED), 20u);
        ASSERT_FALSE(seen->result.image.empty());
        EXPECT_EQ(cv::norm(seen->input, seen->result.image, cv::NORM_INF, each.used == 0), 0);
        EXPECT_GT(cv::norm(seen->input, seen->result.image, cv::NORM_INF, each.used), 20);
      }
      EXPECT_LE(corners_at_edge(last.output(), each.used), corners_at_edge(last.input, each.used));
    }
  }
}

TEST(StaticRim, NothingIsDescribedOrFollowedInTheMask) {
  for (const Case& each : cases()) {
    SCOPED_TRACE(each.name);
    const PixelMask mask(each.used), no_mask;
    const Seen masked = process(each.add, mask).second, unmasked = process(each.add, no_mask).second;
    const auto inside = [&](const Seen& seen) {
      const std::vector<cv::KeyPoint>& keypoints = seen.result.features.keypoints;
      return std::count_if(keypoints.begin(), keypoints.end(), [&](const cv::KeyPoint& keypoint) {
        return !mask.uses({cvRound(keypoint.pt.x), cvRound(keypoint.pt.y)});
      });
    };
    EXPECT_EQ(inside(masked), 0);
    EXPECT_GT(masked.result.features.keypoints.size(), 100u);
    if (each.used.at<uchar>(bumper_px().y + 20, 200) == 0) {
      EXPECT_GT(inside(unmasked), 5) << "the test would show nothing";
    }

    for (const bool with_mask : {true, false}) {
      FeatureTracker tracker{TrackerOptions()};
      if (with_mask) tracker.set_mask(mask);
      std::size_t in_mask = 0, followed = 0;
      for (int i = 0; i < 10; ++i) {
        for (const Track& track :
             tracker.track(image_of(i, each.add), Camera(calibration()), motion(), exposure_of(i))) {
          in_mask += !mask.uses({cvRound(track.pixel_px.x()), cvRound(track.pixel_px.y())});
          followed += track.length > 1;
        }
      }
      EXPECT_EQ(in_mask > 0, !with_mask);
      EXPECT_GT(followed, 100u);
    }
  }
}

TEST(StaticRim, MaskedCornersDoNotMeasureTheMotion) {
  const PixelMask mask(above_bumper());
  BlurFieldOptions blocks;
  const BlockGrid grid(kWidthPx, kHeightPx, blocks.block_size_px);
  for (const bool with_mask : {true, false}) {
    ResidualFlow flow;
    if (with_mask) flow.set_mask(mask);
    int in_mask = 0;
    std::size_t all = 0;
    for (int i = 0; i < 5; ++i) {
      flow.follow(image_of(i, add_bumper), Camera(calibration()), motion(), exposure_of(i), grid);
      for (const ResidualFlow::Sample& sample : flow.samples()) {
        in_mask += !mask.uses({cvRound(sample.pixel_px.x()), cvRound(sample.pixel_px.y())});
      }
      all += flow.samples().size();
    }
    EXPECT_EQ(in_mask > 20, !with_mask) << in_mask;
    EXPECT_EQ(in_mask == 0, with_mask) << in_mask;
    EXPECT_GT(all, 100u);
  }
}

TEST(StaticRim, GlobalShutterImageKeepsMaskedPixelsInPlace) {
  Pipeline pipeline(options());
  pipeline.set_calibration(calibration());
  const PixelMask mask(above_bumper());
  pipeline.set_mask(mask);
  ShutterTiming rolling;
  rolling.exposure_ns = kExposureNs;
  rolling.readout_ns = 20'000'000;
  PipelineRequest request;
  request.global_shutter = true;
  const cv::Mat input = image_of(0, add_bumper);
  const PipelineResult result =
      pipeline.process(input, PixelLayout::GRAY, motion(), RowExposure(kStartNs, kHeightPx, rolling), request);
  ASSERT_FALSE(result.global_shutter.empty());
  EXPECT_EQ(cv::norm(input, result.global_shutter, cv::NORM_INF, mask.pixels() == 0), 0);
  EXPECT_GT(cv::norm(input, result.global_shutter, cv::NORM_INF, mask.pixels()), 20);
}

TEST(StaticRim, MaskOfAnotherSizeIsRefused) {
  Pipeline pipeline(options());
  pipeline.set_calibration(calibration());
  pipeline.set_mask(PixelMask(cv::Mat::ones(10, 10, CV_8UC1)));
  const cv::Mat image = image_of(0, add_rim);
  EXPECT_THROW(pipeline.process(image, PixelLayout::GRAY, motion(), exposure_of(0), {}), std::invalid_argument);
  EXPECT_FALSE(pipeline.detect(image, PixelLayout::GRAY, kStartNs, calibration()).features.keypoints.empty());
  FeatureTracker tracker{TrackerOptions()};
  tracker.set_mask(PixelMask(cv::Mat::ones(10, 10, CV_8UC1)));
  EXPECT_THROW(tracker.track(image, Camera(calibration()), motion(), exposure_of(0)), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::static_rim_test
