#include "calibrate/frame_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "base/median.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::frame_tracker_test {
namespace {

cv::Mat grey_texture() {
  cv::Mat grey;
  cv::extractChannel(sim::procedural_texture(700, 500, 3), grey, 1);
  return grey;
}

TEST(FrameTracker, FollowsAShift) {
  const cv::Mat grey = grey_texture();
  FrameTracker tracker;
  tracker.add({1, 0}, grey(cv::Rect(100, 50, 500, 400)));
  EXPECT_TRUE(tracker.take().empty()) << "nothing comes after the first";
  for (int i = 0; i < 6; ++i) tracker.add({i, 0}, grey(cv::Rect(40 + 23 * i, 60 - 11 * i, 500, 400)));
  EXPECT_THROW(tracker.add({9, 0}, grey), std::invalid_argument) << "another size";
  const std::vector<TrackWindow> windows = tracker.take();
  ASSERT_EQ(windows.size(), 5u);
  for (std::size_t w = 0; w < windows.size(); ++w) {
    ASSERT_EQ(windows[w].frames.size(), std::min<std::size_t>(4, 6 - w));
    EXPECT_EQ(windows[w].frames[1].stamp_ns, static_cast<TimeNs>(w) + 1);
    ASSERT_GT(windows[w].tracks.size(), 50u);
    std::size_t to_the_end = 0;
    std::vector<double> errors_px;
    for (const PointTrack& track : windows[w].tracks) {
      for (std::size_t k = 0; k < track.to_px.size(); ++k) {
        const double steps = static_cast<double>(k) + 1;
        errors_px.push_back((track.to_px[k] - track.from_px - steps * Eigen::Vector2d(-23, 11)).norm());
        // The image ends within the window of a corner that is nearer to its border.
        constexpr int kWholeWindowPx = 12;
        const auto is_inside = [](const Eigen::Vector2d& p) {
          return cv::Rect2d(kWholeWindowPx, kWholeWindowPx, 500 - 2 * kWholeWindowPx, 400 - 2 * kWholeWindowPx)
              .contains({p.x(), p.y()});
        };
        const bool whole = is_inside(track.from_px) && is_inside(track.to_px[k]);
        EXPECT_LT(errors_px.back(), whole ? 0.1 : 0.3) << track.from_px.transpose();
      }
      to_the_end += track.to_px.size() + 1 == windows[w].frames.size();
    }
    EXPECT_GT(to_the_end, 40u);
    EXPECT_LT(median(errors_px), 0.02);
  }
  EXPECT_THROW(FrameTracker().add({}, cv::Mat(400, 500, CV_8UC3)), std::invalid_argument) << "another type";
  EXPECT_THROW(FrameTracker(5), OptionError);
}

TEST(FrameTracker, KnowsNothingAcrossACut) {
  const cv::Mat grey = grey_texture();
  FrameTracker tracker;
  for (int i = 0; i < 2; ++i) tracker.add({i, 0}, grey(cv::Rect(40 + 5 * i, 60, 500, 400)));
  tracker.cut();
  for (int i = 2; i < 5; ++i) tracker.add({i, 0}, grey(cv::Rect(40 + 5 * i, 60, 500, 400)));
  const std::vector<TrackWindow> windows = tracker.take();
  ASSERT_EQ(windows.size(), 3u);
  EXPECT_EQ(windows[0].frames.size(), 2u);
  EXPECT_EQ(windows[1].frames.size(), 3u);
  EXPECT_EQ(windows[1].frames[0].stamp_ns, 2);
}

TEST(FrameTracker, IsNotPulledAlongByAPatchThatRotatesAndGrows) {
  // 2 degrees and 3 % a frame: what pulls on a point is the same in every frame, and adds up over a window.
  const cv::Mat grey = grey_texture();
  FrameTracker tracker;
  std::vector<cv::Mat> maps;
  for (int i = 0; i < 4; ++i) {
    cv::Mat image;
    maps.push_back(cv::getRotationMatrix2D({350, 250}, 2.0 * i, std::pow(1.03, i)));
    cv::warpAffine(grey, image, maps.back(), grey.size(), cv::INTER_CUBIC);
    tracker.add({i, 0}, image);
  }
  const std::vector<TrackWindow> windows = tracker.take();
  std::vector<double> errors_px;
  for (const PointTrack& track : windows.front().tracks) {
    if (track.to_px.size() < 3) continue;
    const cv::Mat to = maps[3] * cv::Vec3d(track.from_px.x(), track.from_px.y(), 1);
    errors_px.push_back((track.to_px[2] - Eigen::Vector2d(to.at<double>(0), to.at<double>(1))).norm());
  }
  ASSERT_GT(errors_px.size(), 60u);
  EXPECT_LT(median(errors_px), 0.02);
}

/// What a camera sees that moves by `length_px` along `direction` during the exposure, its middle at `middle_px`.
cv::Mat smeared(const cv::Mat& grey, const Eigen::Vector2d& direction, double middle_px, double length_px) {
  constexpr int kInstants = 21;
  cv::Mat sum = cv::Mat::zeros(grey.size(), CV_32F), image;
  for (int k = 0; k < kInstants; ++k) {
    const Eigen::Vector2d shift_px = (middle_px + length_px * ((k + 0.5) / kInstants - 0.5)) * direction;
    cv::warpAffine(grey, image, cv::Matx23d(1, 0, shift_px.x(), 0, 1, shift_px.y()), grey.size(), cv::INTER_CUBIC);
    cv::accumulateWeighted(image, sum, 1.0 / (k + 1));
  }
  sum.convertTo(image, CV_8U);
  return image;
}

TEST(FrameTracker, AllowsForTheBlurOfMotion) {
  // Exposed for 60 % of the time between frames: 3 px of blur in the first, 12 in the last.
  constexpr TimeNs kPeriodNs = 50'000'000, kExposureNs = 30'000'000;
  constexpr double kShare = 0.6;
  const cv::Mat grey = grey_texture();
  const Eigen::Vector2d direction = Eigen::Vector2d(3, -1).normalized();
  const auto middle_px = [](int i) { return 5.0 * i + 2.5 * i * i; };
  FrameTracker knowing, unknowing;
  for (int i = 0; i < 4; ++i) {
    const cv::Mat image = smeared(grey, direction, middle_px(i), kShare * (5.0 + 5.0 * i));
    knowing.add({i * kPeriodNs, kExposureNs}, image);
    unknowing.add({i * kPeriodNs, 0}, image);
  }
  const auto errors_px = [&](FrameTracker* tracker) {
    std::vector<double> errors;
    for (const PointTrack& track : tracker->take().front().tracks) {
      if (track.to_px.size() == 3) errors.push_back((track.to_px[2] - track.from_px - middle_px(3) * direction).norm());
    }
    return errors;
  };
  const std::vector<double> by_paths_px = errors_px(&knowing), without_px = errors_px(&unknowing);
  ASSERT_GT(by_paths_px.size(), 60u);
  std::printf("%zu points with paths: %.3f px; %zu without\n", by_paths_px.size(), median(by_paths_px),
              without_px.size());
  EXPECT_GT(by_paths_px.size(), 2 * without_px.size());
  EXPECT_LT(median(by_paths_px), 0.05);
}

TEST(FrameTracker, LosesWhatIsHidden) {
  const cv::Mat grey = grey_texture();
  const cv::Rect hidden(150, 100, 200, 200);
  FrameTracker tracker;
  cv::Mat image = grey(cv::Rect(100, 50, 500, 400)).clone();
  tracker.add({0, 0}, image);
  cv::flip(image(hidden), image(hidden), -1);
  tracker.add({1, 0}, image);
  const std::vector<TrackWindow> windows = tracker.take();
  ASSERT_EQ(windows.size(), 1u);
  std::size_t outside = 0;
  for (const PointTrack& track : windows[0].tracks) {
    const bool was_hidden = hidden.contains(cv::Point(cvRound(track.from_px.x()), cvRound(track.from_px.y())));
    if (!was_hidden) ++outside;
    // Windows of points next to the border see some of what hides the rest.
    EXPECT_LT((track.to_px[0] - track.from_px).norm(), 0.5) << track.from_px.transpose();
  }
  EXPECT_GT(outside, 80u);
}

TEST(FrameTracker, FindsNothingInImagesSmallerThanItsWindow) {
  const cv::Mat grey = grey_texture();
  for (const cv::Size& size : {cv::Size(1, 1), cv::Size(3, 2), cv::Size(13, 9), cv::Size(20, 20), cv::Size(500, 2)}) {
    FrameTracker tracker;
    for (int i = 0; i < 3; ++i) tracker.add({i, 0}, grey(cv::Rect({10 + i, 10}, size)));
    for (const TrackWindow& window : tracker.take()) EXPECT_TRUE(window.tracks.empty()) << size;
  }
}

}  // namespace
}  // namespace gyro_deblur::frame_tracker_test
