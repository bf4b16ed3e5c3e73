// A camera that flies through a textured room along a recorded trajectory: rotation and translation of the same size.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "gyro_deblur/time.hpp"
#include "sim/motion.hpp"
#include "sim/scene.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::test {

/// A recorded flight or walk.
struct RecordedFlight {
  const char* name;
  const char* file;           ///< of the folder `trajectories`
  double start_s;             ///< after take-off, and where the motion capture has no holes
  double length_s;            ///< that can be used from there on
  Eigen::Matrix3d R_cam_imu;  ///< rounded to right angles; the recorded poses are those of the IMU
};

inline std::vector<RecordedFlight> recorded_flights() {
  Eigen::Matrix3d euroc, tum_vi;
  euroc << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  tum_vi << -1, 0, 0, 0, 0, -1, 0, -1, 0;
  return {{"EuRoC V1_02", "V1_02_medium.txt", 12, 60, euroc},
          {"EuRoC V2_02", "V2_02_medium.txt", 12, 90, euroc},
          {"TUM VI room2", "tum_vi_room2.txt", 110.5, 30, tum_vi}};
}

/// The poses of the camera without the scatter of the motion capture: means over a Gaussian of 15 ms, which keeps what
/// a hand or a drone can do (up to some 8 Hz). Taken as it is, TUM VI's scatter of 3 mrad would be a camera that
/// rattles.
inline std::vector<sim::TrajectorySample> smoothed_camera_poses(const std::vector<sim::TrajectorySample>& imu_poses,
                                                                const Eigen::Matrix3d& R_cam_imu) {
  constexpr double kSigmaS = 0.015, kReachS = 3 * kSigmaS;
  std::vector<sim::TrajectorySample> smoothed;
  std::size_t first = 0;
  for (const sim::TrajectorySample& center : imu_poses) {
    while (imu_poses[first].t_s < center.t_s - kReachS) ++first;
    sim::TrajectorySample mean{center.t_s, {}};
    Eigen::Vector4d rotation = Eigen::Vector4d::Zero();
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    double t_s = 0, sum = 0;
    for (std::size_t i = first; i < imu_poses.size() && imu_poses[i].t_s <= center.t_s + kReachS; ++i) {
      const double distance = (imu_poses[i].t_s - center.t_s) / kSigmaS, weight = std::exp(-0.5 * distance * distance);
      const Eigen::Vector4d q = imu_poses[i].pose.R_world_cam.coeffs();
      rotation += (q.dot(center.pose.R_world_cam.coeffs()) < 0 ? -weight : weight) * q;
      position += weight * imu_poses[i].pose.p_world_m;
      t_s += weight * imu_poses[i].t_s;
      sum += weight;
    }
    mean.t_s = t_s / sum;  // next to a hole the neighbours are on one side
    mean.pose.R_world_cam =
        Eigen::Quaterniond(rotation).normalized() * Eigen::Quaterniond(Eigen::Matrix3d(R_cam_imu.transpose()));
    mean.pose.p_world_m = position / sum;
    if (smoothed.empty() || mean.t_s > smoothed.back().t_s) smoothed.push_back(mean);
  }
  return smoothed;
}

/// Six textured planes around what was flown through, `margin_m` beyond it on every side.
inline std::vector<sim::Plane> room_around(const Eigen::AlignedBox3d& flown_m, double margin_m) {
  constexpr double kTexelsPerM = 250;
  const Eigen::Vector3d size_m = flown_m.sizes() + Eigen::Vector3d::Constant(2 * margin_m);
  std::vector<sim::Plane> planes;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      // A plane faces its own -z: its z axis goes along `axis`, the other two follow.
      const int across = (axis + 1) % 3, along = (axis + 2) % 3;
      Eigen::Matrix3d R = Eigen::Matrix3d::Zero();
      R(across, 0) = R(along, 1) = R(axis, 2) = 1;
      sim::Plane plane;
      plane.width_m = size_m[across];
      plane.height_m = size_m[along];
      plane.R_world_plane = Eigen::Quaterniond(R);
      plane.center_m = flown_m.center();
      plane.center_m[axis] += 0.5 * side * size_m[axis];
      plane.texture = sim::procedural_texture(static_cast<int>(kTexelsPerM * plane.width_m),
                                              static_cast<int>(kTexelsPerM * plane.height_m),
                                              static_cast<std::uint64_t>(20 + planes.size()));
      planes.push_back(plane);
    }
  }
  return planes;
}

/// The scene of a flight, without camera and IMU models beyond what is given here.
/// @param folder   of the trajectories
/// @param seconds  [0.5, flight.length_s / speed - lead_ns twice]
/// @param speed    1: as recorded
/// Throws OptionError when the trajectory cannot be read.
inline sim::Scene room_flight_scene(const RecordedFlight& flight, const std::string& folder, double seconds,
                                    double speed = 1) {
  constexpr double kMarginM = 1.2;
  sim::Scene scene;
  scene.camera.fps = 20;
  scene.frames = static_cast<int>(seconds * scene.camera.fps);
  scene.lead_ns = 800'000'000;
  std::vector<sim::TrajectorySample> poses =
      smoothed_camera_poses(sim::load_trajectory(folder + "/trajectories/" + flight.file), flight.R_cam_imu);
  Eigen::AlignedBox3d flown_m;
  for (sim::TrajectorySample& sample : poses) {
    sample.t_s /= speed;
    const double since_s = sample.t_s - flight.start_s / speed;
    if (since_s >= 0 && since_s <= seconds + 2 * to_seconds(scene.lead_ns)) flown_m.extend(sample.pose.p_world_m);
  }
  scene.planes = room_around(flown_m, kMarginM);
  scene.motion = sim::make_trajectory_motion(poses, flight.start_s / speed);
  return scene;
}

}  // namespace gyro_deblur::test
