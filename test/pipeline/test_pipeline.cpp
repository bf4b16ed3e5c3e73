#include "gyro_deblur/pipeline.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "analytic_motion.hpp"
#include "engine/engine.hpp"
#include "features/point_covariance.hpp"
#include "inverse/filter_bank.hpp"
#include "panning_camera.hpp"
#include "repeated_pictures.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::pipeline_test {
namespace {

using test::kFocalPx;
using test::kHeight;
using test::kWidth;
using test::pan;

constexpr TimeNs kExposureNs = 20'000'000;
constexpr TimeNs kStampNs = 1'000'000'000;

/// Rate [rad/s] that gives `extent_px` at the image centre.
double rate_for(double extent_px) { return 2 * std::atan(extent_px / (2 * kFocalPx)) / to_seconds(kExposureNs); }

RowExposure global_shutter() {
  ShutterTiming timing;
  timing.exposure_ns = kExposureNs;
  return RowExposure(kStampNs, kHeight, timing);
}

PipelineOptions options() {
  PipelineOptions o;
  o.keypoints.detector = o.keypoints.descriptor = "ORB";
  o.keypoints.max_keypoints = 300;
  return o;
}

Pipeline pipeline() {
  Pipeline p(options());
  p.set_calibration(test::small_camera());
  return p;
}

cv::Mat sharp_image() { return test::textured_image(kWidth, kHeight, 31); }
cv::Mat blurred_image(double extent_px) {
  return test::expose(test::blur_along_line(sharp_image(), 0, extent_px), 1.0, 3);
}

bool equal(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0;
}

TEST(Pipeline, DroppedFrameHasOnlyItsField) {
  Pipeline p = pipeline();
  PipelineRequest request;
  request.luminance = request.global_shutter = true;
  const auto motion = pan(rate_for(15));
  p.estimate(blurred_image(15), PixelLayout::GRAY, motion, global_shutter(), request);
  const std::size_t to_deblur = p.validate().field.count(BlockStatus::DEBLURRED);
  const PipelineResult result = p.deblur(FrameAction{"", "only the field is wanted"});
  EXPECT_GE(to_deblur, 18u) << "of 20";
  EXPECT_EQ(result.field.count(BlockStatus::DEBLURRED), to_deblur) << "what could be deblurred is still reported";
  EXPECT_TRUE(result.image.empty() && result.luminance.empty() && result.global_shutter.empty());
  EXPECT_TRUE(result.features.keypoints.empty());
  EXPECT_EQ(result.times.deconvolution_ms, 0);
}

TEST(Pipeline, CallsComeInTheirOrder) {
  Pipeline p = pipeline();
  const cv::Mat image = blurred_image(15);
  const auto motion = pan(rate_for(15));
  const auto estimate = [&](const PipelineRequest& request = {}) {
    p.estimate(image, PixelLayout::GRAY, motion, global_shutter(), request);
  };
  EXPECT_THROW(p.validate(), std::logic_error);
  EXPECT_THROW(p.deblur(), std::logic_error);
  estimate();
  EXPECT_THROW(p.deblur(), std::logic_error);
  EXPECT_THROW(p.validate(ExposureAnswer{kExposureNs}), std::logic_error) << "the exposure is not in question";
  p.validate();
  EXPECT_THROW(p.validate(), std::logic_error);
  const PipelineResult result = p.deblur();
  EXPECT_THROW(p.deblur(), std::logic_error);
  const PipelineResult at_once =
      pipeline().process(image, PixelLayout::GRAY, motion, global_shutter(), PipelineRequest());
  EXPECT_TRUE(equal(result.image, at_once.image)) << "a call out of order changes nothing";
  EXPECT_EQ(result.features.keypoints.size(), at_once.features.keypoints.size());

  PipelineRequest asks;
  asks.exposure = ExposureQuestion{};
  EXPECT_THROW(p.process(image, PixelLayout::GRAY, motion, global_shutter(), asks), std::logic_error);
  estimate(asks);
  EXPECT_THROW(p.validate(), std::logic_error) << "without an answer";
  EXPECT_TRUE(p.validate(ExposureAnswer{kExposureNs}).blur_is_known());
}

TEST(Pipeline, FrameIsForgottenWithWhatItWasEstimatedBy) {
  Pipeline p = pipeline();
  const cv::Mat image = blurred_image(15);
  const auto motion = pan(rate_for(15));
  CameraCalibration other = test::small_camera();
  other.fx_px += 1;
  const std::function<void()> changes[] = {
      [&] { p.set_options(options()); }, [&] { p.set_mask(PixelMask()); }, [&] { p.set_calibration(other); },
      [&] {
        const cv::Mat small = image.rowRange(0, 64);
        EXPECT_THROW(p.process(small, PixelLayout::GRAY, motion, global_shutter(), PipelineRequest()),
                     std::invalid_argument);
      }};
  for (const auto& change : changes) {
    p.set_calibration(test::small_camera());
    p.estimate(image, PixelLayout::GRAY, motion, global_shutter(), PipelineRequest());
    change();
    EXPECT_THROW(p.validate(), std::logic_error);
    p.set_calibration(test::small_camera());
    p.estimate(image, PixelLayout::GRAY, motion, global_shutter(), PipelineRequest());
    p.validate();
    change();
    EXPECT_THROW(p.deblur(), std::logic_error);
  }
}

TEST(Pipeline, PassesTheLuminanceOfTheInputOn) {
  const cv::Mat gray = blurred_image(15);
  cv::Mat bgr;
  cv::cvtColor(gray, bgr, cv::COLOR_GRAY2BGR);
  PipelineRequest request;
  for (const bool wanted : {false, true}) {
    request.input_luminance = wanted;
    const PipelineResult result =
        pipeline().process(bgr, PixelLayout::BGR, pan(rate_for(15)), global_shutter(), request);
    EXPECT_FALSE(result.image.empty());
    EXPECT_EQ(result.input_luminance.empty(), !wanted);
    if (wanted) {
      EXPECT_TRUE(equal(result.input_luminance, luminance8(bgr, PixelLayout::BGR, result.significant_bits)));
    }
  }
}

// By rule FIXED as by rule NOISE; longer blur is less certain, of the same corners or others.
TEST(Pipeline, SaysHowExactlyKeypointsArePlaced) {
  for (const Regularization rule : {Regularization::ADAPTIVE, Regularization::FIXED}) {
    PipelineOptions fixed = options();
    fixed.filter.regularization = rule;
    Pipeline p(fixed);
    p.set_calibration(test::small_camera());
    double before_px2 = 0;
    for (const double extent_px : {5.0, 20.0}) {
      const PipelineResult result =
          p.process(blurred_image(extent_px), PixelLayout::GRAY, pan(rate_for(extent_px)), global_shutter(), {});
      ASSERT_EQ(result.covariances_px2.size(), result.features.keypoints.size());
      double sum_px2 = 0;
      for (std::size_t i = 0; i < result.points.size(); ++i) {
        const cv::KeyPoint& keypoint = result.features.keypoints[i];
        const Eigen::Matrix2d& covariance_px2 = result.covariances_px2[i];
        EXPECT_GT(covariance_px2.determinant(), 0);
        sum_px2 += covariance_px2.trace();
        // A global shutter moves nothing, and a pan has no residual velocity: it is that of the point as detected.
        const PointCovariance covariance(result.image, result.field);
        EXPECT_TRUE(covariance_px2.isApprox(
            covariance.at({keypoint.pt.x, keypoint.pt.y}, corner_radius_px(keypoint, "ORB"), kCornerErrors)));
      }
      sum_px2 /= static_cast<double>(result.points.size());
      EXPECT_GT(sum_px2, before_px2);
      before_px2 = sum_px2;
      for (const BlockBlur& block : result.field.blocks) {
        if (block.status == BlockStatus::DEBLURRED) {
          EXPECT_NE(block.noise_gain, 1);
        }
      }
    }
  }
}

TEST(Pipeline, SharpensABlurredFrame) {
  Pipeline p = pipeline();
  const cv::Mat blurred = blurred_image(15);
  const PipelineResult result = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  ASSERT_EQ(result.image.size(), blurred.size());
  ASSERT_EQ(result.image.type(), CV_8UC1);
  EXPECT_GE(result.field.count(BlockStatus::DEBLURRED), 18u) << "of 20";
  const cv::Rect inner(20, 20, kWidth - 40, kHeight - 40);
  EXPECT_GE(test::psnr_db(result.image(inner), sharp_image()(inner)),
            test::psnr_db(blurred(inner), sharp_image()(inner)) + 2);
  EXPECT_GT(result.features.keypoints.size(), 100u);
  ASSERT_EQ(result.points.size(), result.features.keypoints.size());
  EXPECT_EQ(result.features.descriptors.rows, static_cast<int>(result.features.keypoints.size()));
  EXPECT_EQ(result.reference_ns, global_shutter().reference_time(RectifyTo::MIDDLE_ROW));
  EXPECT_EQ(result.field.exposure_ns, kExposureNs);
  EXPECT_GT(result.times.blur_field_ms, 0);
  EXPECT_GT(result.times.validation_ms, 0);
  EXPECT_GT(result.times.noise_ms, 0);
  EXPECT_GT(result.times.deconvolution_ms, 0);
  EXPECT_GT(result.times.keypoints_ms, 0);
}

TEST(Pipeline, PassesCurvedBlocksThroughBehindTheCamerasRate) {
  PipelineOptions trusting = options();
  trusting.validation.rule = ValidationRule::NONE;
  Pipeline p(trusting);
  p.set_calibration(test::small_camera());
  // Half a period within the exposure: an arc of 8 px.
  test::Swing across, arc;
  across.axis = Eigen::Vector3d::UnitY();
  across.rate_rad_s = rate_for(25);
  arc.axis = Eigen::Vector3d::UnitX();
  arc.amplitude_rad = 8 / kFocalPx;
  arc.frequency_hz = 0.5 / to_seconds(kExposureNs);
  const test::AnalyticMotion motion(across, arc);
  const cv::Mat blurred = blurred_image(25);
  PipelineRequest request;
  const PipelineResult with_time = p.process(blurred, PixelLayout::GRAY, motion, global_shutter(), request);
  EXPECT_GT(with_time.field.count(BlockStatus::DEBLURRED), 15u) << "of 20";
  EXPECT_EQ(with_time.field.count(BlockStatus::TOO_CURVED), 0u);
  EXPECT_FALSE(with_time.image.empty());
  request.behind_camera_rate = true;
  const PipelineResult overloaded = p.process(blurred, PixelLayout::GRAY, motion, global_shutter(), request);
  EXPECT_EQ(overloaded.field.count(BlockStatus::TOO_CURVED), with_time.field.count(BlockStatus::DEBLURRED));
  EXPECT_TRUE(overloaded.image.empty());
  // Straight blur is filtered as ever.
  EXPECT_GE(p.process(blurred, PixelLayout::GRAY, pan(rate_for(25)), global_shutter(), request)
                .field.count(BlockStatus::DEBLURRED),
            18u);
}

TEST(Pipeline, ReportsTheNoise) {
  Pipeline p = pipeline();
  const auto noise = [&](double added) {
    const cv::Mat blurred = test::expose(64 + 0.5 * blurred_image(15), added, 4);
    return p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {}).field.noise.value_or(-1);
  };
  // The image has noise already.
  const double own = noise(0);
  EXPECT_NEAR(noise(4), std::hypot(own, 4), 0.15 * 4);
}

// The image has 16 bit, the luminance for keypoints 8.
TEST(Pipeline, CountsBlocksLeftToTheFloatEngine) {
  PipelineOptions on_the_processor = options();
  on_the_processor.engine = "cpu";
  on_the_processor.validation.rule = ValidationRule::NONE;
  Pipeline p(on_the_processor);
  p.set_calibration(test::small_camera());
  cv::Mat deep;
  blurred_image(15).convertTo(deep, CV_16U, 257);
  const auto process = [&](const cv::Mat& image, const PipelineRequest& request) {
    return p.process(image, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), request);
  };
  PipelineRequest keypoints;
  keypoints.image = false;
  const PipelineResult both = process(deep, {});
  const std::size_t deblurred = both.field.count(BlockStatus::DEBLURRED);
  ASSERT_GT(deblurred, 0u);
  EXPECT_EQ(both.fallback_counts, (FallbackCounts{{"16 bit and blur below 36 px", deblurred}}));
  EXPECT_EQ(process(deep, keypoints).fallback_counts, FallbackCounts{});
  EXPECT_EQ(process(blurred_image(15), {}).fallback_counts, FallbackCounts{});
}

// What OpenCV 4.2 lacks, and the default.
TEST(Pipeline, DetectorThatIsMissingCostsKeypointsAlone) {
  PipelineOptions with_sift = options();
  with_sift.keypoints = KeypointOptions();
  ASSERT_EQ(with_sift.keypoints.detector, "SIFT");
  const std::vector<std::string> detectors = available_detectors();
  const bool has_sift = std::find(detectors.begin(), detectors.end(), "SIFT") != detectors.end();
  Pipeline p(with_sift);
  p.set_calibration(test::small_camera());
  const auto process = [&p](const PipelineRequest& request) {
    return p.process(blurred_image(15), PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), request);
  };
  const PipelineResult result = process({});
  EXPECT_FALSE(result.image.empty());
  EXPECT_EQ(result.points.size(), result.features.keypoints.size());
  const PipelineResult raw = p.detect(sharp_image(), PixelLayout::GRAY, kStampNs, test::small_camera());
  for (const PipelineResult* each : {&result, &raw}) {
    EXPECT_EQ(each->features.keypoints.size() > 100, has_sift);
    EXPECT_EQ(each->features.keypoints.empty(), !has_sift);
    EXPECT_EQ(each->keypoints_text.find("keypoint_detector = SIFT: OpenCV ") == 0, !has_sift) << each->keypoints_text;
    EXPECT_EQ(each->keypoints_text.empty(), has_sift);
  }
  PipelineRequest image;
  image.keypoints = false;
  EXPECT_EQ(process(image).keypoints_text, "") << "nobody asked";
  p.set_options(options());
  EXPECT_GT(process({}).features.keypoints.size(), 100u);
  EXPECT_EQ(process({}).keypoints_text, "");
}

/// An 8-bit image as a camera of `bits` gives it in 16: it and 1/2^(bits - 8) grey levels of nothing below.
cv::Mat in_16_bits(const cv::Mat& image, int bits, int shift = 0) {
  cv::Mat wide;
  image.convertTo(wide, CV_16U, ((1 << bits) - 1) / 255.0 * (1 << shift));
  if (shift > 0) cv::bitwise_and(wide, cv::Scalar::all(65535 ^ ((1 << shift) - 1)), wide);
  return wide;
}

// Grey levels are those of the camera's full scale, however many bits it has.
TEST(Pipeline, SameSceneGivesTheSameInEveryDepth) {
  struct Depth {
    int bits, shift, given;
  };
  const Depth depths[] = {{10, 0, 0}, {12, 0, 0}, {14, 0, 0},  {16, 0, 0},
                          {12, 4, 0}, {14, 2, 0}, {11, 0, 11}, {12, 0, 12}};
  struct Seen {
    std::size_t deblurred, rejected, keypoints;
  };
  for (const bool is_sharp : {true, false}) {
    for (const PixelLayout layout : {PixelLayout::GRAY, PixelLayout::BAYER_RGGB, PixelLayout::RGB}) {
      // A mosaic of grey.
      cv::Mat image = is_sharp ? sharp_image() : blurred_image(15);
      if (layout == PixelLayout::RGB) cv::merge(std::vector<cv::Mat>{image, image, image}, image);
      const auto see = [&](const cv::Mat& pixels, int given, int bits) -> Seen {
        PipelineOptions o = options();
        o.significant_bits = given;
        Pipeline p(o);
        p.set_calibration(test::small_camera());
        const PipelineResult r = p.process(pixels, layout, pan(rate_for(15)), global_shutter(), {});
        EXPECT_EQ(r.significant_bits, bits);
        EXPECT_EQ(p.take_warning().empty(), given != 0 || bits == 8 || bits == 16);
        EXPECT_EQ(p.take_warning(), "");
        if (!r.image.empty()) {
          EXPECT_EQ(r.image.type(), pixels.type());
          double greatest = 0;
          cv::minMaxLoc(r.image.reshape(1), nullptr, &greatest);
          EXPECT_LE(greatest, (1 << bits) - 1);
        }
        return {r.field.count(BlockStatus::DEBLURRED), r.field.count(BlockStatus::REJECTED),
                r.features.keypoints.size()};
      };
      const Seen expected = see(image, 0, 8);
      if (is_sharp) {
        EXPECT_GE(expected.rejected, 15u) << "of 20";
      } else {
        EXPECT_GE(expected.deblurred, 18u);
      }
      for (const Depth& depth : depths) {
        SCOPED_TRACE(testing::Message() << depth.bits << " bits << " << depth.shift << ", sharp " << is_sharp
                                        << ", layout " << static_cast<int>(layout));
        const Seen seen =
            see(in_16_bits(image, depth.bits, depth.shift), depth.given, depth.shift > 0 ? 16 : depth.bits);
        // Finer values may carry one block over the threshold.
        EXPECT_NEAR(static_cast<double>(seen.deblurred), static_cast<double>(expected.deblurred), 1);
        EXPECT_NEAR(static_cast<double>(seen.rejected), static_cast<double>(expected.rejected), 1);
        EXPECT_NEAR(static_cast<double>(seen.keypoints), static_cast<double>(expected.keypoints),
                    0.05 * static_cast<double>(expected.keypoints));
      }
    }
  }
}

TEST(Pipeline, DarkFramesDoNotChangeTheScale) {
  Pipeline p = pipeline();
  const auto bits = [&p](double brightness) {
    const cv::Mat image = in_16_bits(blurred_image(15) * brightness, 12);
    const PipelineResult result = p.process(image, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
    EXPECT_EQ(p.detect(image, PixelLayout::GRAY, kStampNs, std::nullopt).significant_bits, result.significant_bits);
    return result.significant_bits;
  };
  EXPECT_EQ(bits(0.05), 10);
  EXPECT_EQ(bits(1), 12);
  for (const double brightness : {0.05, 1.0, 0.2, 0.0}) EXPECT_EQ(bits(brightness), 12);
  PipelineOptions o = options();
  o.significant_bits = 14;
  p.set_options(o);
  EXPECT_EQ(bits(1), 14);
}

TEST(Pipeline, DoesOnlyWhatIsAskedFor) {
  Pipeline p = pipeline();
  const cv::Mat blurred = blurred_image(15);
  PipelineRequest nothing, keypoints, image;
  nothing.image = nothing.keypoints = keypoints.image = image.keypoints = false;

  const PipelineResult bare = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), nothing);
  EXPECT_TRUE(bare.image.empty());
  EXPECT_TRUE(bare.features.keypoints.empty());
  EXPECT_EQ(bare.times.deconvolution_ms, 0);
  EXPECT_EQ(bare.times.keypoints_ms, 0);
  EXPECT_EQ(bare.field.blocks.size(), 20u);

  const PipelineResult pixels = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), image);
  EXPECT_FALSE(pixels.image.empty());
  EXPECT_TRUE(pixels.points.empty());

  // Keypoints come from the deblurred luminance whether or not the image is wanted.
  const PipelineResult points = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), keypoints);
  const PipelineResult both = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  EXPECT_TRUE(points.image.empty());
  EXPECT_TRUE(equal(both.image, pixels.image));
  ASSERT_EQ(points.features.keypoints.size(), both.features.keypoints.size());
  EXPECT_TRUE(equal(points.features.descriptors, both.features.descriptors));
}

TEST(Pipeline, LeavesTheImageEmptyWhenNothingWasChanged) {
  Pipeline p = pipeline();
  const cv::Mat sharp = sharp_image();
  // At rest.
  PipelineResult result = p.process(sharp, PixelLayout::GRAY, pan(0), global_shutter(), {});
  EXPECT_TRUE(result.image.empty());
  EXPECT_EQ(result.field.count(BlockStatus::SHARP), 20u);
  EXPECT_FALSE(result.features.keypoints.empty());
  // A sharp image that the gyroscope calls blurred: the block's keypoints must not be rectified either.
  result = p.process(sharp, PixelLayout::GRAY, pan(rate_for(40)), global_shutter(), {});
  EXPECT_EQ(result.field.count(BlockStatus::REJECTED), 20u);
  EXPECT_TRUE(result.image.empty());
  for (const RectifiedPoint& point : result.points) EXPECT_FALSE(point.rectified || point.deblurred);
  // Without gyroscope.
  const RotationTrack none({}, {}, Eigen::Matrix3d::Identity());
  result = p.process(sharp, PixelLayout::GRAY, none, global_shutter(), {});
  EXPECT_EQ(result.field.count(BlockStatus::NO_GYRO), 20u);
  EXPECT_TRUE(result.image.empty());
  EXPECT_FALSE(result.features.keypoints.empty());
  for (const Eigen::Matrix2d& covariance_px2 : result.covariances_px2) EXPECT_TRUE(std::isinf(covariance_px2(1, 1)));
  // Too fast.
  result = p.process(sharp, PixelLayout::GRAY, pan(rate_for(250)), global_shutter(), {});
  EXPECT_EQ(result.field.count(BlockStatus::TOO_LARGE), 20u);
  EXPECT_TRUE(result.image.empty());
}

// Its luminance is deblurred as a grey image is, and its colours are copied.
TEST(Pipeline, DeblursTheLuminanceOfYuv422) {
  const cv::Mat grey = blurred_image(15);
  PipelineRequest request;
  request.luminance = request.global_shutter = true;
  Pipeline of_grey = pipeline();
  const PipelineResult expected =
      of_grey.process(grey, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), request);
  ASSERT_GT(expected.field.count(BlockStatus::DEBLURRED), 0u);
  cv::Mat chroma(grey.size(), CV_8UC1);
  cv::RNG rng(3);
  rng.fill(chroma, cv::RNG::UNIFORM, 0, 256);
  for (const PixelLayout layout : {PixelLayout::YUV422_UYVY, PixelLayout::YUV422_YUYV}) {
    const bool light_first = layout == PixelLayout::YUV422_YUYV;
    const auto with_chroma = [&](const cv::Mat& light) {
      cv::Mat image;
      cv::merge(std::vector<cv::Mat>{light_first ? light : chroma, light_first ? chroma : light}, image);
      return image;
    };
    Pipeline p = pipeline();
    const cv::Mat image = with_chroma(grey);
    const PipelineResult result = p.process(image, layout, pan(rate_for(15)), global_shutter(), request);
    ASSERT_EQ(result.image.type(), CV_8UC2);
    EXPECT_TRUE(equal(result.image, with_chroma(expected.image)));
    EXPECT_TRUE(equal(result.luminance, expected.luminance));
    EXPECT_EQ(result.field.noise, expected.field.noise);
    EXPECT_EQ(result.field.contrast, expected.field.contrast);
    EXPECT_EQ(result.features.keypoints.size(), expected.features.keypoints.size());
    EXPECT_EQ(result.global_shutter.channels(), result.global_shutter.data == result.image.data ? 2 : 3);
    EXPECT_EQ(p.detect(image, layout, kStampNs, std::nullopt).features.keypoints.size(),
              of_grey.detect(grey, PixelLayout::GRAY, kStampNs, std::nullopt).features.keypoints.size());
  }
}

TEST(Pipeline, HandlesEveryLayout) {
  const cv::Mat grey = blurred_image(15);
  const PixelLayout layouts[] = {PixelLayout::GRAY, PixelLayout::BGR,        PixelLayout::RGB,        PixelLayout::BGRA,
                                 PixelLayout::RGBA, PixelLayout::BAYER_GBRG, PixelLayout::YUV422_UYVY};
  for (const PixelLayout layout : layouts) {
    for (const int depth : {CV_8U, CV_16U}) {
      if (is_yuv422(layout) && depth != CV_8U) continue;
      cv::Mat deep, image;
      grey.convertTo(deep, depth, depth == CV_8U ? 1 : 257);
      cv::merge(std::vector<cv::Mat>(channels_of(layout), deep), image);
      Pipeline p = pipeline();
      const PipelineResult result = p.process(image, layout, pan(rate_for(15)), global_shutter(), {});
      EXPECT_EQ(result.image.type(), image.type());
      EXPECT_EQ(result.image.size(), image.size());
      EXPECT_FALSE(result.features.keypoints.empty());

      // A listener to the image must not change what the listener to the keypoints gets.
      PipelineRequest keypoints;
      keypoints.image = false;
      const PipelineResult alone = p.process(image, layout, pan(rate_for(15)), global_shutter(), keypoints);
      ASSERT_EQ(alone.features.keypoints.size(), result.features.keypoints.size())
          << "layout " << static_cast<int>(layout) << " depth " << depth;
      EXPECT_TRUE(equal(alone.features.descriptors, result.features.descriptors));
    }
  }
}

TEST(Pipeline, TakesNewOptions) {
  Pipeline p = pipeline();
  const cv::Mat blurred = blurred_image(15);
  const PipelineResult before = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  PipelineOptions changed = options();
  changed.filter.noise_to_signal_ratio = 0.1;
  changed.blur_field.block_size_px = 32;
  changed.validation.rule = ValidationRule::NONE;
  changed.keypoints.max_keypoints = 20;
  changed.rectify_to = RectifyTo::STAMP;
  p.set_options(changed);
  const PipelineResult after = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  EXPECT_EQ(after.field.grid.block_size_px(), 32);
  EXPECT_EQ(after.field.count(BlockStatus::DEBLURRED), 80u);
  EXPECT_FALSE(equal(before.image, after.image));
  EXPECT_LE(after.features.keypoints.size(), 20u);
  EXPECT_EQ(after.reference_ns, kStampNs);
  changed = options();
  changed.filter.regularization = Regularization::PAPER;
  p.set_options(changed);
  EXPECT_FALSE(
      equal(before.image, p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {}).image));
  p.set_options(options());
  EXPECT_TRUE(
      equal(before.image, p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {}).image));
}

/// A pipeline that goes by images, too, and a camera that moves before a wall.
class PipelineByImages : public testing::Test {
 protected:
  PipelineByImages() : pipeline_(options()), rotation_(samples(), GyroOptions{}, Eigen::Matrix3d::Identity()) {
    pipeline_.set_calibration(camera_.simulator().camera().calibration());
  }

  std::vector<GyroSample> samples() const {
    std::vector<GyroSample> samples;
    for (const sim::ImuSample& sample : camera_.simulator().imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
    return samples;
  }
  PipelineResult process(int i, bool repeats) {
    PipelineRequest request;
    request.repeats_picture = repeats;
    return pipeline_.process(camera_.picture(i), PixelLayout::GRAY, rotation_, camera_.simulator().exposure(i),
                             request);
  }

  const test::HandheldCamera camera_{12};
  Pipeline pipeline_;
  const RotationTrack rotation_;
};

TEST_F(PipelineByImages, RepeatedPictureIsWhatItWasAndDisturbsNothing) {
  std::vector<PipelineResult> once;
  for (int i = 0; i < camera_.frames(); ++i) once.push_back(process(i, false));
  pipeline_ = Pipeline(options());
  pipeline_.set_calibration(camera_.simulator().camera().calibration());
  std::size_t by_images = 0;
  for (int i = 0; i < camera_.frames(); ++i) {
    const PipelineResult& expected = once[static_cast<std::size_t>(i)];
    for (const bool repeats : {false, true, true}) {
      const PipelineResult result = process(i, repeats);
      EXPECT_TRUE(equal(result.image, expected.image)) << "picture " << i << ", repeats " << repeats;
      for (std::size_t b = 0; b < result.field.blocks.size(); ++b) {
        EXPECT_EQ(result.field.blocks[b].residual.has_value(), expected.field.blocks[b].residual.has_value());
        by_images += result.field.blocks[b].residual ? 1 : 0;
      }
      // A rotation that has been given once is no second witness of an error of the gyroscope.
      EXPECT_EQ(result.residual_rotation.has_value(), expected.residual_rotation.has_value() && !repeats);
    }
  }
  EXPECT_GT(by_images, 100u);
}

// From an exposure that is half the true one.
TEST_F(PipelineByImages, ExposureThatIsFoundIsUsedThroughout) {
  Pipeline certain(options());
  certain.set_calibration(camera_.simulator().camera().calibration());
  for (int i = 0; i < 6; ++i) {
    const RowExposure exposure = camera_.simulator().exposure(i);
    const TimeNs true_ns = exposure.timing().exposure_ns;
    PipelineRequest request;
    request.exposure = ExposureQuestion{true, true_ns};
    pipeline_.estimate(camera_.picture(i), PixelLayout::GRAY, rotation_, exposure.with_exposure(true_ns / 2), request);
    pipeline_.validate(ExposureAnswer{true_ns});
    EXPECT_THROW(pipeline_.validate(ExposureAnswer{true_ns}), std::logic_error) << "one answer";
    const PipelineResult found = pipeline_.deblur();
    const PipelineResult given =
        certain.process(camera_.picture(i), PixelLayout::GRAY, rotation_, exposure, PipelineRequest());
    EXPECT_TRUE(found.exposure_is_known);
    EXPECT_EQ(found.exposure_ns, true_ns);
    EXPECT_EQ(found.field.exposure_ns, true_ns);
    EXPECT_EQ(found.reference_ns, given.reference_ns);
    ASSERT_EQ(found.field.blocks.size(), given.field.blocks.size());
    for (std::size_t b = 0; b < given.field.blocks.size(); ++b) {
      EXPECT_NEAR(found.field.blocks[b].extent_px, given.field.blocks[b].extent_px, 0.3) << i << " " << b;
    }
    if (i == 0) {
      EXPECT_TRUE(equal(found.image, given.image)) << "nothing is followed yet";
    }
  }
}

// What one image says is assumed for the next. The first image has the rotation alone: no corner is followed
// yet.
TEST_F(PipelineByImages, ExposureIsFoundFromHalfOfItWithinTwoImages) {
  const TimeNs true_ns = camera_.simulator().exposure(0).timing().exposure_ns;
  TimeNs assumed_ns = true_ns / 2;
  int estimates = 0;
  for (int i = 0; i < 6; ++i) {
    const RowExposure assumed = camera_.simulator().exposure(i).with_exposure(assumed_ns);
    PipelineRequest request;
    request.exposure = ExposureQuestion{true, 2 * true_ns};
    if (const std::optional<ExposureEstimate> estimate =
            pipeline_.estimate(camera_.picture(i), PixelLayout::GRAY, rotation_, assumed, request).exposure_estimate) {
      ++estimates;
      assumed_ns = std::llround(estimate->ratio * static_cast<double>(assumed_ns));
    }
    pipeline_.validate(ExposureAnswer{assumed_ns, i > 0});
    const PipelineResult result = pipeline_.deblur();
    EXPECT_EQ(result.exposure_ns, assumed_ns);
    EXPECT_EQ(result.field.exposure_ns, assumed_ns) << "the likeliest one, whether or not it is known";
    if (i > 0) {
      EXPECT_NEAR(static_cast<double>(assumed_ns) / static_cast<double>(true_ns), 1, 0.1) << i;
    }
  }
  EXPECT_GE(estimates, 5);
}

TEST_F(PipelineByImages, ExposureThatIsNotKnownLeavesTheImageAsItIs) {
  constexpr TimeNs kAssumedNs = 15'000'000;
  PipelineRequest request;
  request.exposure = ExposureQuestion{false, 20'000'000};
  const PipelineResult& estimated =
      pipeline_.estimate(camera_.picture(0), PixelLayout::GRAY, rotation_, camera_.simulator().exposure(0), request);
  EXPECT_FALSE(estimated.exposure_estimate) << "it is not to be looked at";
  EXPECT_GT(estimated.mean_brightness, 0);
  pipeline_.validate(ExposureAnswer{kAssumedNs, false});
  const PipelineResult result = pipeline_.deblur();
  EXPECT_FALSE(result.exposure_is_known);
  EXPECT_FALSE(result.sharp_at_any_exposure);
  EXPECT_TRUE(result.image.empty());
  EXPECT_EQ(result.field.count(BlockStatus::DEBLURRED), 0u);
  EXPECT_NE(result.exposure_need, ExposureNeed::NOTHING);
}

// It passed through the first time.
TEST_F(PipelineByImages, RepetitionOfAPictureThatWasNotSeenIsFollowed) {
  Pipeline expected(options());
  expected.set_calibration(camera_.simulator().camera().calibration());
  for (int i = 0; i < 4; ++i) {
    const PipelineResult result = process(i, i == 3);
    const PipelineResult clean =
        expected.process(camera_.picture(i), PixelLayout::GRAY, rotation_, camera_.simulator().exposure(i), {});
    EXPECT_TRUE(equal(result.image, clean.image)) << i;
  }
}

/// Writes down for what it is prepared.
class PreparedEngine : public Engine {
 public:
  explicit PreparedEngine(std::vector<std::pair<double, double>>* extents_px) : extents_px_(extents_px) {}
  void filter(const cv::Mat& src, const FilterGrid&, cv::Mat& dst) override { src.copyTo(dst); }
  void prepare(const std::vector<const LineKernel*>& kernels) override {
    extents_px_->emplace_back(kernels.front()->box_extent_px, kernels.back()->box_extent_px);
  }
  std::string name() const override { return "prepared"; }

 private:
  std::vector<std::pair<double, double>>* extents_px_;
};

// Ahead, for all extents that may come, and again only where they or the kernels are others.
TEST(Pipeline, PreparesItsEngineForTheOptions) {
  using Extents = std::pair<double, double>;
  std::vector<Extents> prepared;
  PipelineOptions o = options();
  o.blur_field.min_extent_px = 6;
  o.blur_field.max_extent_px = 40;
  Pipeline p(o, [&](const std::string&, int) { return std::make_unique<PreparedEngine>(&prepared); });
  const Extents halves_too(3, 40);
  EXPECT_EQ(prepared, std::vector<Extents>{halves_too});
  o.validation.tau = 9;
  o.keypoints.max_keypoints = 100;
  o.blur_field.curved_path_threshold_px = 3;
  p.set_options(o);
  EXPECT_EQ(prepared.size(), 1u) << "nothing that kernels depend on";
  o.filter.noise_to_signal_ratio = 0.02;
  p.set_options(o);
  EXPECT_EQ(prepared.size(), 2u) << "other kernels";
  o.threads = 1;
  p.set_options(o);
  EXPECT_EQ(prepared.size(), 3u) << "another engine";
  o.blur_field.max_extent_px = 60;
  p.set_options(o);
  ASSERT_EQ(prepared.size(), 4u) << "longer blur";
  EXPECT_EQ(prepared.back(), Extents(3, 60));
}

TEST(Pipeline, KeepsItsStateWhenNewOptionsAreBad) {
  Pipeline p = pipeline();
  const cv::Mat blurred = blurred_image(15);
  const PipelineResult before = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  std::vector<PipelineOptions> bad(7, options());
  // Each also changes something good, which must not be taken over.
  for (PipelineOptions& o : bad) o.blur_field.block_size_px = 32;
  bad[0].filter.noise_to_signal_ratio = -1;
  bad[1].engine = "abacus";
  bad[2].keypoints.detector = "EYE";
  bad[3].keypoints.detector = "FAST", bad[3].keypoints.descriptor = "AKAZE";
  bad[4].blur_field.min_extent_px = 0;
  bad[5].validation.tau = std::nan("");
  bad[6].threads = 1000;
  for (const PipelineOptions& o : bad) {
    EXPECT_THROW(p.set_options(o), OptionError);
    EXPECT_THROW(Pipeline{o}, OptionError);
    EXPECT_EQ(p.options().blur_field.block_size_px, 64);
  }
  CameraCalibration flat = test::small_camera();
  flat.fx_px = 0;
  EXPECT_THROW(p.set_calibration(flat), OptionError);
  const PipelineResult after = p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  EXPECT_TRUE(equal(before.image, after.image));
  EXPECT_EQ(before.features.keypoints.size(), after.features.keypoints.size());
}

// A rectified image is that of an ideal camera, whatever it was rotated by and whether or not its motion is known.
TEST(Pipeline, NormalizedCoordinatesAreThoseOfTheRectifiedImage) {
  CameraCalibration rotated = test::small_camera();
  rotated.R_image_cam = Eigen::AngleAxisd(3.3 * M_PI / 180, Eigen::Vector3d(1, 2, 0.5).normalized()).toRotationMatrix();
  Pipeline p(options());
  p.set_calibration(rotated);
  const PipelineResult passed = p.detect(sharp_image(), PixelLayout::GRAY, kStampNs, rotated);
  const PipelineResult processed = p.process(sharp_image(), PixelLayout::GRAY, pan(0), global_shutter(), {});
  for (const PipelineResult* result : {&passed, &processed}) {
    ASSERT_GT(result->points.size(), 100u);
    for (std::size_t i = 0; i < result->points.size(); ++i) {
      const cv::Point2f& at = result->features.keypoints[i].pt;
      const Eigen::Vector2d ideal((at.x - rotated.cx_px) / kFocalPx, (at.y - rotated.cy_px) / kFocalPx);
      EXPECT_LT((result->points[i].normalized - ideal).norm() * kFocalPx, 1e-3) << "px, at " << at;
    }
  }
}

TEST(Pipeline, WarnsOnceAboutAnAbsentDevice) {
  PipelineOptions o = options();
  o.engine = "opencl:no such device";
  Pipeline p(o);
  p.set_calibration(test::small_camera());
  const cv::Mat blurred = blurred_image(15);
  EXPECT_FALSE(p.process(blurred, PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {}).image.empty());
  EXPECT_NE(p.take_warning().find("OpenCL failed"), std::string::npos);
  EXPECT_EQ(p.take_warning(), "");
  EXPECT_NE(p.engine().find("OpenCL failed"), std::string::npos);
  p.set_options(options());
  EXPECT_EQ(p.take_warning(), "");
}

TEST(Pipeline, RefusesImagesThatDoNotFit) {
  Pipeline bare(options());
  const RotationTrack motion = pan(0);
  EXPECT_THROW(bare.process(sharp_image(), PixelLayout::GRAY, motion, global_shutter(), {}), std::logic_error);
  Pipeline p = pipeline();
  const auto process = [&](const cv::Mat& image, PixelLayout layout) {
    return p.process(image, layout, motion, global_shutter(), {});
  };
  EXPECT_THROW(process(cv::Mat(), PixelLayout::GRAY), std::invalid_argument);
  EXPECT_THROW(process(cv::Mat(kHeight, kWidth - 1, CV_8UC1), PixelLayout::GRAY), std::invalid_argument);
  EXPECT_THROW(process(cv::Mat(kHeight, kWidth, CV_8UC3), PixelLayout::GRAY), std::invalid_argument);
  EXPECT_THROW(process(cv::Mat(kHeight, kWidth, CV_32FC1), PixelLayout::GRAY), std::invalid_argument);
}

TEST(Pipeline, FollowsTheCalibration) {
  Pipeline p = pipeline();
  CameraCalibration wide = test::small_camera();
  wide.fx_px = wide.fy_px = kFocalPx / 2;
  p.set_calibration(wide);
  const PipelineResult result =
      p.process(blurred_image(15), PixelLayout::GRAY, pan(rate_for(15)), global_shutter(), {});
  const int center = result.field.grid.index_at(kWidth / 2.0, kHeight / 2.0);
  EXPECT_NEAR(result.field.blocks[center].extent_px, 7.5, 0.3);
  EXPECT_EQ(p.engine(), make_engine("auto")->name());
}

}  // namespace
}  // namespace gyro_deblur::pipeline_test
