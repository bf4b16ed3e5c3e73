#include "recorded_burst.hpp"

#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "displacement_errors.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "result_table.hpp"
#include "tools/recording.hpp"

namespace gyro_deblur::experiments {
namespace {

/// Matches by the ratio test that one homography explains.
int matches(const Features& a, const Features& b) {
  constexpr float kRatio = 0.8F;
  constexpr double kErrorPx = 3;
  constexpr std::size_t kFewest = 8;
  if (a.keypoints.size() < kFewest || b.keypoints.size() < kFewest) return 0;
  std::vector<std::vector<cv::DMatch>> nearest;
  cv::BFMatcher().knnMatch(a.descriptors, b.descriptors, nearest, 2);
  std::vector<cv::Point2f> from, to;
  for (const auto& pair : nearest) {
    if (pair.size() < 2 || pair[0].distance > kRatio * pair[1].distance) continue;
    from.push_back(a.keypoints[pair[0].queryIdx].pt);
    to.push_back(b.keypoints[pair[0].trainIdx].pt);
  }
  if (from.size() < kFewest) return 0;
  cv::Mat inliers;
  cv::findHomography(from, to, cv::RANSAC, kErrorPx, inliers);
  return inliers.empty() ? 0 : cv::countNonZero(inliers);
}

void fill_ratios(const FrameBlur& field, const Camera& camera, const RotationTrack& rotation,
                 const RowExposure& exposure, BurstFrame* frame) {
  std::vector<double> of_all, of_images, ratios;
  for (int b = 0; b < field.grid.size(); ++b) {
    if (field.blocks[b].status == BlockStatus::NO_GYRO) continue;
    const Eigen::Vector2d by_rotation = displacement_px(camera, rotation, exposure, field.grid.center(b));
    of_all.push_back(by_rotation.norm());
    const auto& residual = field.blocks[b].residual;
    if (!residual) continue;
    of_images.push_back(by_rotation.norm());
    const Eigen::Vector2d whole = by_rotation + to_seconds(field.exposure_ns) * residual->velocity_px_s;
    ratios.push_back(whole.norm() / by_rotation.norm());
  }
  frame->extent_px = quantile(ratios.empty() ? of_all : of_images, 0.5);
  frame->ratio_median = quantile(ratios, 0.5);
  frame->ratio_low = quantile(ratios, 0.25);
  frame->ratio_high = quantile(ratios, 0.75);
  frame->from_images = static_cast<double>(ratios.size()) / field.grid.size();
}

}  // namespace

std::vector<BurstFrame> burst_frames(const std::string& folder, const std::string& description) {
  const Recording recording = read_frames(folder, description);
  const RotationTrack rotation = rotation_of(recording);
  PipelineOptions with, without;
  with.blur_field.max_extent_px = 200;  // 124 px by the gyroscope, and a fifth more
  without.blur_field = with.blur_field;
  without.optical_flow = false;
  Pipeline images(with), alone(without);
  for (Pipeline* pipeline : {&images, &alone}) pipeline->set_calibration(recording.camera);
  const Camera camera(recording.camera);
  KeypointOptions keypoints;
  keypoints.max_keypoints = 5000;
  FeatureExtractor extractor(keypoints);
  PipelineRequest request;
  request.keypoints = false;
  std::vector<BurstFrame> frames;
  std::array<Features, 3> before;
  for (const RecordedFrame& recorded : recording.frames) {
    const cv::Mat image = cv::imread(recorded.path, cv::IMREAD_GRAYSCALE);
    if (image.empty()) throw std::runtime_error(recorded.path + " cannot be read");
    ShutterTiming timing;
    timing.exposure_ns = recorded.exposure_ns;
    timing.readout_ns = recording.readout_ns;
    const RowExposure exposure(recorded.stamp_ns, image.rows, timing);
    const PipelineResult by_images = images.process(image, PixelLayout::GRAY, rotation, exposure, request);
    const PipelineResult by_gyroscope = alone.process(image, PixelLayout::GRAY, rotation, exposure, request);
    BurstFrame& frame = frames.emplace_back();
    frame.number = static_cast<int>(frames.size());
    fill_ratios(by_images.field, camera, rotation, exposure, &frame);
    const std::array<cv::Mat, 3> shown = {image, by_gyroscope.image.empty() ? image : by_gyroscope.image,
                                          by_images.image.empty() ? image : by_images.image};
    std::array<int, 3> found{}, matched{};
    for (std::size_t k = 0; k < shown.size(); ++k) {
      Features features = extractor.extract(shown[k]);
      found[k] = static_cast<int>(features.keypoints.size());
      if (frames.size() > 1) matched[k] = matches(before[k], features);
      before[k] = std::move(features);
    }
    frame.deblurred_alone = static_cast<int>(by_gyroscope.field.count(BlockStatus::DEBLURRED));
    frame.deblurred_images = static_cast<int>(by_images.field.count(BlockStatus::DEBLURRED));
    frame.keypoints_blurred = found[0], frame.keypoints_alone = found[1], frame.keypoints_images = found[2];
    frame.matches_blurred = matched[0], frame.matches_alone = matched[1], frame.matches_images = matched[2];
  }
  return frames;
}

}  // namespace gyro_deblur::experiments
