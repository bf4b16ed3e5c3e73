#include "shaken_frames.hpp"

#include <filesystem>
#include <stdexcept>
#include <utility>

#include "features/point_motion.hpp"

namespace gyro_deblur::experiments {
namespace {

/// A camera before a wall of photographs that shakes as recorded, and looks where the view says in the middle of its
/// one exposure.
sim::Simulator shaken(const ShakenCamera& camera, const std::vector<sim::TraceSample>& trace, double scale,
                      TimeNs exposure_ns, const View& view, const std::vector<ImagePair>& photographs) {
  constexpr double kDepthM = 2;
  constexpr double kWallViews = 2.5;    // wide and high
  constexpr double kTileWidthPx = 800;  // of a photograph: much what it has itself
  sim::Scene scene;
  scene.camera.calibration.width_px = camera.width_px;
  scene.camera.calibration.height_px = camera.height_px;
  scene.camera.calibration.fx_px = scene.camera.calibration.fy_px = camera.focal_px;
  scene.camera.calibration.cx_px = (camera.width_px - 1) / 2.0;
  scene.camera.calibration.cy_px = (camera.height_px - 1) / 2.0;
  scene.camera.exposures_ns = {exposure_ns};
  scene.camera.encoding = "mono16";
  scene.imu.gyro_noise_rad_s = 0.003;
  scene.lead_ns = 100'000'000;
  scene.seed = static_cast<std::uint64_t>(1 + view.middle_s * 1e6);
  const double middle_s = to_seconds(scene.lead_ns) + 0.5 * to_seconds(exposure_ns);
  const auto motion = [&](const Eigen::Quaterniond& R_world_cam_0) {
    return sim::make_gyro_trace_motion(trace, view.middle_s - middle_s, scale, Eigen::Matrix3d::Identity(),
                                       R_world_cam_0, {});
  };
  const Eigen::Quaterniond rotated = motion(Eigen::Quaterniond::Identity())->pose(middle_s).R_world_cam;
  scene.motion = motion(view.R_world_cam * rotated.conjugate());
  const cv::Size size_px(cvRound(kWallViews * camera.width_px), cvRound(kWallViews * camera.height_px));
  const double tiles = size_px.width / kTileWidthPx;
  sim::Plane wall;
  wall.texture =
      photo_wall(size_px, cvCeil(tiles), cvCeil(tiles * size_px.height / size_px.width), photographs, view.photograph);
  wall.width_m = size_px.width * kDepthM / camera.focal_px;
  wall.height_m = size_px.height * kDepthM / camera.focal_px;
  wall.center_m = {0, 0, kDepthM};
  scene.planes = {wall};
  return sim::Simulator(std::move(scene));
}

RotationTrack rotation_of(const sim::Simulator& simulator) {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
  return RotationTrack(samples, GyroOptions{}, simulator.scene().imu.R_cam_imu);
}

}  // namespace

std::vector<View> random_views(std::uint64_t seed, double length_s) {
  constexpr double kMarginS = 1, kTiltRad = 0.09, kRollRad = 0.2;
  cv::RNG rng(seed);
  std::vector<View> views;
  for (std::size_t photograph = 0; photograph < kPhotographs; ++photograph) {
    for (int i = 0; i < kViewsOfEach; ++i) {
      const double middle_s = rng.uniform(kMarginS, length_s - kMarginS);
      const double yaw = rng.uniform(-kTiltRad, kTiltRad), pitch = rng.uniform(-kTiltRad, kTiltRad);
      const double roll = rng.uniform(-kRollRad, kRollRad);
      views.push_back(
          {middle_s,
           Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitX()) *
               Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()),
           photograph});
    }
  }
  return views;
}

Shot take_shot(const ShakenCamera& camera, const std::vector<sim::TraceSample>& trace, double scale, TimeNs exposure_ns,
               const View& view, const std::vector<ImagePair>& photographs) {
  sim::Simulator simulator = shaken(camera, trace, scale, exposure_ns, view, photographs);
  const cv::Mat blurred = simulator.frame(0).image, sharp = simulator.sharp(0);
  RotationTrack rotation = rotation_of(simulator);
  return {std::move(simulator), blurred, sharp, std::move(rotation)};
}

Features rectified(Features features, const FrameBlur& field, const Shot& shot) {
  std::vector<Eigen::Vector2d> points_px;
  for (const cv::KeyPoint& keypoint : features.keypoints) points_px.emplace_back(keypoint.pt.x, keypoint.pt.y);
  const auto points = rectify_points(points_px, field, shot.simulator.camera(), shot.rotation,
                                     shot.simulator.exposure(0), shot.simulator.reference_time(0));
  for (std::size_t i = 0; i < points.size(); ++i) {
    features.keypoints[i].pt =
        cv::Point2f(static_cast<float>(points[i].rectified_px.x()), static_cast<float>(points[i].rectified_px.y()));
  }
  return features;
}

std::vector<sim::TraceSample> load_hand_shake(const std::string& data) {
  const std::string path = data + "/handshake_gyro/gyro_test.txt";
  if (!std::filesystem::exists(path)) throw std::runtime_error("there is no " + path + "; see test/data/README.md");
  return sim::load_gyro_trace(path);
}

}  // namespace gyro_deblur::experiments
