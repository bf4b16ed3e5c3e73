#include "recorded_tracks.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <stdexcept>
#include <utility>

#include <Eigen/Dense>
#include <opencv2/imgcodecs.hpp>

#include "features/corner_prediction.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "lk_tracker.hpp"
#include "tools/recording.hpp"

namespace gyro_deblur::experiments {
namespace {

const std::vector<int> kImagesApart{1, 3, 10, 20};
/// Farther off a corner says nothing about the translation.
constexpr double kOutlierPx = 3;

/// A corner in two images: its directions at one instant, of depth 1.
struct SeenTwice {
  Eigen::Vector3d before, now;
};

/// Distance from the line through `before` that a translation in this direction moves the corner along [px].
double distance_px(const SeenTwice& corner, const Eigen::Vector3d& direction, double focal_px) {
  const double along = direction.cross(corner.before).head<2>().norm(),
               across = std::abs(direction.dot(corner.before.cross(corner.now)));
  return focal_px *
         std::min((corner.now - corner.before).norm(), across / std::max(along, std::numeric_limits<double>::min()));
}

/// Direction of the translation: RANSAC of two corners, then least squares of those that agree.
Eigen::Vector3d translation_direction(const std::vector<SeenTwice>& corners, double focal_px) {
  constexpr int kSamples = 500, kRefinements = 5;
  const auto normal = [](const SeenTwice& corner) { return corner.before.cross(corner.now); };
  Eigen::Vector3d best = Eigen::Vector3d::UnitX();
  double least = std::numeric_limits<double>::infinity();
  const auto try_direction = [&](const Eigen::Vector3d& direction) {
    if (!(direction.norm() > 0)) return;
    double cost = 0;
    for (const SeenTwice& corner : corners) {
      cost += std::pow(std::min(kOutlierPx, distance_px(corner, direction.normalized(), focal_px)), 2);
    }
    if (!(cost < least)) return;
    least = cost;
    best = direction.normalized();
  };
  std::mt19937 random(1);
  for (int sample = 0; sample < kSamples; ++sample) {
    const SeenTwice &first = corners[random() % corners.size()], &second = corners[random() % corners.size()];
    try_direction(normal(first).cross(normal(second)));
  }
  for (int refinement = 0; refinement < kRefinements; ++refinement) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (const SeenTwice& corner : corners) {
      const double along = best.cross(corner.before).head<2>().squaredNorm();
      if (!(along > 0) || distance_px(corner, best, focal_px) >= kOutlierPx) continue;
      sum += normal(corner) * normal(corner).transpose() / along;
    }
    try_direction(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(sum).eigenvectors().col(0));
  }
  return best;
}

/// The corners of one image.
struct SeenCorners {
  RowExposure exposure;
  std::map<std::int32_t, Eigen::Vector2d> places_px;
};

/// Distances of the corners that both images have from the epipolar lines; none of too few.
std::vector<double> epipolar_distances_px(const SeenCorners& before, const SeenCorners& now, const Camera& camera,
                                          const CameraMotion& motion) {
  constexpr std::size_t kFewest = 8;
  const TimeNs reference_ns = now.exposure.middle(0.5 * camera.calibration().height_px);
  const auto direction = [&](const Eigen::Vector2d& place_px, const RowExposure& exposure) {
    return rotated_ray(camera.ray(place_px), motion, exposure.middle(place_px.y()), reference_ns);
  };
  std::vector<SeenTwice> corners;
  for (const auto& [id, place_px] : now.places_px) {
    const auto earlier = before.places_px.find(id);
    if (earlier == before.places_px.end()) continue;
    const auto from = direction(earlier->second, before.exposure), to = direction(place_px, now.exposure);
    if (from && to) corners.push_back({*from / from->z(), *to / to->z()});
  }
  std::vector<double> distances_px;
  if (corners.size() < kFewest) return distances_px;
  const double focal_px = camera.calibration().fx_px;
  const Eigen::Vector3d translation = translation_direction(corners, focal_px);
  for (const SeenTwice& corner : corners) distances_px.push_back(distance_px(corner, translation, focal_px));
  return distances_px;
}

/// A recorded image, raw and deblurred.
struct RecordedImage {
  cv::Mat raw;
  RowExposure exposure;
  PipelineResult result;
};

struct RecordedMethod {
  std::string name;
  std::function<const std::vector<Track>&(const RecordedImage&)> track;
  std::vector<SeenCorners> seen;
};

std::vector<RecordedMethod> trackers(const Camera& camera, const CameraMotion& motion) {
  const auto tracker = std::make_shared<FeatureTracker>(TrackerOptions{});
  const auto on_raw = std::make_shared<LkTracker>(TrackerOptions{}),
             on_deblurred = std::make_shared<LkTracker>(TrackerOptions{});
  using Tracks = const std::vector<Track>&;
  return {{"FeatureTracker, raw",
           [=, &camera, &motion](const RecordedImage& image) -> Tracks {
             return tracker->track(image.raw, camera, motion, image.exposure, &image.result.field);
           },
           {}},
          {"LK, raw",
           [=, &camera, &motion](const RecordedImage& image) -> Tracks {
             return on_raw->track(image.raw, camera, motion, image.exposure);
           },
           {}},
          {"LK, deblurred",
           [=, &camera, &motion](const RecordedImage& image) -> Tracks {
             return on_deblurred->track(image.result.luminance, camera, motion, image.exposure);
           },
           {}}};
}

}  // namespace

std::vector<SharedCorners> recorded_tracks(const std::string& folder, const std::string& description) {
  const Recording recording = read_frames(folder, description);
  const RotationTrack rotation = rotation_of(recording);
  const Camera camera(recording.camera);
  PipelineOptions options;
  options.blur_field.max_extent_px = 200;  // shield_burst has 144
  Pipeline pipeline(options);
  pipeline.set_calibration(recording.camera);
  PipelineRequest request;
  request.keypoints = request.image = false;
  request.luminance = true;
  std::vector<RecordedMethod> methods = trackers(camera, rotation);
  for (const RecordedFrame& frame : recording.frames) {
    const cv::Mat raw = cv::imread(frame.path, cv::IMREAD_GRAYSCALE);
    if (raw.empty()) throw std::runtime_error(frame.path + " cannot be read");
    ShutterTiming timing;
    timing.exposure_ns = frame.exposure_ns;
    timing.readout_ns = recording.readout_ns;
    const RowExposure exposure(frame.stamp_ns, raw.rows, timing);
    const RecordedImage image{raw, exposure, pipeline.process(raw, PixelLayout::GRAY, rotation, exposure, request)};
    for (RecordedMethod& method : methods) {
      SeenCorners& seen = method.seen.emplace_back(SeenCorners{exposure, {}});
      for (const Track& track : method.track(image)) seen.places_px[track.id] = track.pixel_px;
    }
  }
  std::vector<SharedCorners> all;
  for (const RecordedMethod& method : methods) {
    for (const int apart : kImagesApart) {
      SharedCorners& followed = all.emplace_back(SharedCorners{method.name, apart, 0, {}});
      for (std::size_t now = static_cast<std::size_t>(apart); now < method.seen.size(); ++now) {
        const std::vector<double> distances_px = epipolar_distances_px(
            method.seen[now - static_cast<std::size_t>(apart)], method.seen[now], camera, rotation);
        followed.distances_px.insert(followed.distances_px.end(), distances_px.begin(), distances_px.end());
        ++followed.pairs;
      }
    }
  }
  return all;
}

}  // namespace gyro_deblur::experiments
