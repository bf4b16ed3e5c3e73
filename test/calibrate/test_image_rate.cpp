#include "calibrate/image_rate.hpp"

#include <optional>
#include <stdexcept>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::image_rate_test {
namespace {

constexpr int kWidth = 320, kHeight = 240;
constexpr TimeNs kMs = 1'000'000, kPeriod = 50 * kMs, kExposure = 10 * kMs;

CameraCalibration calibration(double focal_px = 260) {
  CameraCalibration c;
  c.width_px = kWidth;
  c.height_px = kHeight;
  c.fx_px = c.fy_px = focal_px;
  c.cx_px = 0.5 * (kWidth - 1);
  c.cy_px = 0.5 * (kHeight - 1);
  return c;
}

/// A rate that changes evenly about each axis, from 0 s on, of a scene at infinity.
struct Rotating {
  Eigen::Vector3d rate_rad_s, change_rad_s2 = Eigen::Vector3d::Zero();

  Eigen::Vector3d mean(double from_s, double to_s) const { return rate_rad_s + 0.5 * (from_s + to_s) * change_rad_s2; }
  /// Camera axes to those at 0 s. The axis stays, or the time is short.
  Eigen::Matrix3d orientation(double t_s) const { return so3_exp(t_s * mean(0, t_s)).toRotationMatrix(); }
};

/// Rows are exposed, for an instant, one after the other.
cv::Mat image(const Rotating& rotating, TimeNs stamp_ns, TimeNs readout_ns = 0, double focal_px = 260) {
  static const cv::Mat kScene = [] {
    cv::Mat grey;
    cv::extractChannel(sim::procedural_texture(900, 700, 3), grey, 1);
    return grey;
  }();
  const CameraCalibration c = calibration(focal_px);
  cv::Mat at(kHeight, kWidth, CV_32FC2);
  for (int y = 0; y < kHeight; ++y) {
    const Eigen::Matrix3d R = rotating.orientation(to_seconds(stamp_ns + kExposure / 2 + readout_ns * y / kHeight));
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d ray = R * Eigen::Vector3d((x - c.cx_px) / c.fx_px, (y - c.cy_px) / c.fy_px, 1);
      at.at<cv::Vec2f>(y, x) = {static_cast<float>(450 + c.fx_px * ray.x() / ray.z()),
                                static_cast<float>(350 + c.fy_px * ray.y() / ray.z())};
    }
  }
  cv::Mat result;
  cv::remap(kScene, result, at, cv::noArray(), cv::INTER_CUBIC);
  return result;
}

RowExposure exposure(TimeNs stamp_ns, TimeNs readout_ns = 0) { return {stamp_ns, kHeight, {kExposure, readout_ns}}; }

/// Of the second of two images.
std::optional<ImageRate> rate_of(const Rotating& rotating, TimeNs readout_ns, TimeNs given_readout_ns,
                                 const PixelMask& mask = {}) {
  const Camera camera(calibration());
  ImageRateTracker tracker;
  tracker.set_mask(mask);
  EXPECT_FALSE(tracker.add(image(rotating, 0, readout_ns), camera, exposure(0, given_readout_ns)));
  return tracker.add(image(rotating, kPeriod, readout_ns), camera, exposure(kPeriod, given_readout_ns));
}

TEST(ImageRate, IsThatOfTheCamera) {
  for (const Eigen::Vector3d& rate_rad_s : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(0.5, 0, 0),
                                            Eigen::Vector3d(0, -0.8, 0), Eigen::Vector3d(0.3, 0.6, -1)}) {
    const std::optional<ImageRate> rate = rate_of({rate_rad_s}, 0, 0);
    ASSERT_TRUE(rate);
    EXPECT_LT((rate->rate_rad_s - rate_rad_s).norm(), 0.01 + 0.02 * rate_rad_s.norm()) << rate->rate_rad_s.transpose();
    EXPECT_LT((rate->rate_rad_s - rate_rad_s).norm(), 4 * rate->stddev_rad_s);
    EXPECT_LT(rate->stddev_rad_s, 0.05);
    EXPECT_EQ(rate->begin_ns, kExposure / 2);
    EXPECT_EQ(rate->end_ns, kPeriod + kExposure / 2);
    EXPECT_NEAR(rate->speed_rad_s, rate_rad_s.head<2>().norm(), 0.2);
  }
}

TEST(ImageRate, ReportsWhatARollingShutterMakesOfIt) {
  constexpr TimeNs kReadout = 20 * kMs;
  const double readout_s = to_seconds(kReadout), from_s = to_seconds(kExposure / 2) + readout_s / 2;
  for (const Eigen::Vector3d& change_rad_s2 : {Eigen::Vector3d(0, 8, 0), Eigen::Vector3d(8, 0, 0)}) {
    const Rotating rotating{{0.1, 0.1, 0}, change_rad_s2};
    const Eigen::Vector3d truth = rotating.mean(from_s, from_s + to_seconds(kPeriod));
    const std::optional<ImageRate> rate = rate_of(rotating, kReadout, kReadout);
    ASSERT_TRUE(rate);
    EXPECT_NEAR(static_cast<double>(rate->begin_ns), 1e9 * from_s - 0.5 * kReadout / kHeight, 2)
        << "the row in the middle";
    const Eigen::Vector3d off = rate->rate_rad_s - truth;
    if (change_rad_s2.y() > 0) {
      EXPECT_GT(off.norm(), 0.03) << "rows that are shifted apart look rolled";
    }
    EXPECT_LT((off - rate->by_rows * readout_s * change_rad_s2).norm(), 0.02)
        << off.transpose() << " instead of " << (rate->by_rows * readout_s * change_rad_s2).transpose();
  }
}

TEST(ImageRate, OfAnUnknownLensIsTimesTheFocalLength) {
  for (const double focal_px : {100.0, 190.0, 500.0}) {
    for (const double guess_px : {100.0, 224.0, 640.0}) {
      for (const Eigen::Vector3d& rate_rad_s : {Eigen::Vector3d(0.5, 0, 0), Eigen::Vector3d(0.3, 0.4, -1)}) {
        const Camera camera(calibration(guess_px));
        ImageRateTracker tracker;
        tracker.add(image({rate_rad_s}, 0, 0, focal_px), camera, exposure(0), false);
        const std::optional<ImageRate> rate =
            tracker.add(image({rate_rad_s}, kPeriod, 0, focal_px), camera, exposure(kPeriod), false);
        ASSERT_TRUE(rate);
        EXPECT_FALSE(rate->lens_known);
        EXPECT_EQ(rate->larger_side_px, kWidth);
        const double focal_length = focal_px / kWidth;
        const Eigen::Vector3d truth(focal_length * rate_rad_s.x(), focal_length * rate_rad_s.y(), rate_rad_s.z());
        EXPECT_LT((rate->rate_rad_s - truth).norm(), 0.01 + 0.02 * truth.norm())
            << focal_px << ", guess " << guess_px << ": " << rate->rate_rad_s.transpose();
        EXPECT_LT((rate->rate_rad_s - truth).norm(), 4 * rate->stddev_rad_s);
        EXPECT_GT(rate->speed_rad_s, rate_rad_s.head<2>().norm()) << "as of the shortest focal length";
      }
    }
  }
}

TEST(ImageRate, OfAnUnknownLensReportsWhatARollingShutterMakesOfIt) {
  constexpr TimeNs kReadout = 20 * kMs;
  const double readout_s = to_seconds(kReadout), from_s = to_seconds(kExposure / 2) + readout_s / 2;
  const Rotating rotating{{0.1, 0.1, 0}, {0, 8, 0}};
  const Camera camera(calibration());
  ImageRateTracker tracker;
  tracker.add(image(rotating, 0, kReadout), camera, exposure(0, kReadout), false);
  const auto rate = tracker.add(image(rotating, kPeriod, kReadout), camera, exposure(kPeriod, kReadout), false);
  ASSERT_TRUE(rate);
  const Eigen::DiagonalMatrix<double, 3> scale(260.0 / kWidth, 260.0 / kWidth, 1);
  const Eigen::Vector3d off = rate->rate_rad_s - scale * rotating.mean(from_s, from_s + to_seconds(kPeriod));
  EXPECT_GT(off.norm(), 0.03);
  EXPECT_LT((off - rate->by_rows * (scale * rotating.change_rad_s2) * readout_s).norm(), 0.02) << off.transpose();
}

TEST(ImageRate, FollowsNothingThatIsMasked) {
  cv::Mat pixels(kHeight, kWidth, CV_8UC1, cv::Scalar(255));
  pixels(cv::Rect(40, 40, 200, 150)).setTo(0);
  const Rotating rotating{{0.2, 0.5, 0}};
  const Camera camera(calibration());
  // What is masked stands still in the image, as a part of the vehicle does.
  const auto with_vehicle = [&](TimeNs stamp_ns) {
    cv::Mat shown = image(rotating, stamp_ns);
    image({{0, 0, 0}}, 0)(cv::Rect(40, 40, 200, 150)).copyTo(shown(cv::Rect(40, 40, 200, 150)));
    return shown;
  };
  ImageRateTracker tracker;
  tracker.set_mask(PixelMask(pixels));
  tracker.add(with_vehicle(0), camera, exposure(0));
  const std::optional<ImageRate> rate = tracker.add(with_vehicle(kPeriod), camera, exposure(kPeriod));
  ASSERT_TRUE(rate);
  EXPECT_LT((rate->rate_rad_s - rotating.rate_rad_s).norm(), 0.03) << rate->rate_rad_s.transpose();
  tracker.set_mask(PixelMask(cv::Mat(10, 10, CV_8UC1, cv::Scalar(255))));
  EXPECT_THROW(tracker.add(with_vehicle(2 * kPeriod), camera, exposure(2 * kPeriod)), std::invalid_argument);
}

TEST(ImageRate, IsNotThereWithoutTextureOrAfterABreak) {
  const Camera camera(calibration());
  const Rotating rotating{{0.2, 0.5, 0}};
  ImageRateTracker tracker;
  tracker.add(image(rotating, 0), camera, exposure(0));
  EXPECT_FALSE(tracker.add(image(rotating, kPeriod), camera, exposure(300 * kMs))) << "a break";
  EXPECT_FALSE(tracker.add(image(rotating, 0), camera, exposure(0))) << "time went back";
  EXPECT_TRUE(tracker.add(image(rotating, kPeriod), camera, exposure(kPeriod)));
  tracker.reset();
  EXPECT_FALSE(tracker.add(image(rotating, 2 * kPeriod), camera, exposure(2 * kPeriod)));
  const cv::Mat plain(kHeight, kWidth, CV_8UC1, cv::Scalar(90));
  EXPECT_FALSE(tracker.add(plain, camera, exposure(3 * kPeriod)));
  EXPECT_FALSE(tracker.add(plain, camera, exposure(4 * kPeriod)));
  EXPECT_THROW(tracker.add(cv::Mat(10, 10, CV_8UC1), camera, exposure(5 * kPeriod)), std::invalid_argument);
  EXPECT_THROW(tracker.add(cv::Mat(kHeight, kWidth, CV_8UC3), camera, exposure(5 * kPeriod)), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::image_rate_test
