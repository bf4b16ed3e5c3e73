// simulate_bag: a ROS bag from a simulated camera and IMU whose truth is known.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <std_msgs/Header.h>
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "gyro_deblur/Exposure.h"
#include "gyro_deblur/options.hpp"
#include "sim/simulator.hpp"
#include "tools/bag_messages.hpp"
#include "tools/progress.hpp"

namespace {

using gyro_deblur::bag_time;
using gyro_deblur::TimeNs;
using gyro_deblur::sim::Frame;
using gyro_deblur::sim::ImuSample;
using gyro_deblur::sim::Pose;
using gyro_deblur::sim::Scene;
using gyro_deblur::sim::Simulator;

constexpr char kCameraFrame[] = "camera";
constexpr char kImuFrame[] = "imu";
constexpr char kWorldFrame[] = "world";

struct Arguments {
  std::string output;
  std::string scene;
  int frames = 0;       // 0: as the scene says
  long long seed = -1;  // -1: as the scene says
  std::string json;
  bool no_truth = false;
  bool quiet = false;
};

std_msgs::Header header(TimeNs stamp_ns, const char* frame_id, const std::string& what) {
  std_msgs::Header h;
  h.stamp = bag_time(stamp_ns, what);
  h.frame_id = frame_id;
  return h;
}

geometry_msgs::PoseStamped pose_message(const std_msgs::Header& h, const Pose& pose) {
  geometry_msgs::PoseStamped message;
  message.header = h;
  message.pose.position.x = pose.p_world_m.x();
  message.pose.position.y = pose.p_world_m.y();
  message.pose.position.z = pose.p_world_m.z();
  message.pose.orientation.w = pose.R_world_cam.w();
  message.pose.orientation.x = pose.R_world_cam.x();
  message.pose.orientation.y = pose.R_world_cam.y();
  message.pose.orientation.z = pose.R_world_cam.z();
  return message;
}

// True blur extents [px] on a grid over one frame; pixels without truth are left out.
std::vector<double> true_extents(const Simulator& simulator, int frame) {
  constexpr int kColumns = 12, kRows = 8;
  const auto& camera = simulator.camera().calibration();
  std::vector<double> extents;
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < kColumns; ++c) {
      const Eigen::Vector2d pixel((c + 0.5) * camera.width_px / kColumns, (r + 0.5) * camera.height_px / kRows);
      const double extent = simulator.truth_displacement(frame, pixel).norm();
      if (std::isfinite(extent)) extents.push_back(extent);
    }
  }
  std::sort(extents.begin(), extents.end());
  return extents;
}

nlohmann::json write_bag(Simulator& simulator, const Arguments& arguments, const std::string& path) {
  const Scene& scene = simulator.scene();
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  const std::vector<ImuSample> imu = simulator.imu();
  const TimeNs time_offset_ns = scene.imu.time_offset_ns;

  // Recorded in the camera clock, which is also that of truth: an IMU sample when it was taken, whatever its stamp.
  const ros::Time begin = bag_time(scene.start_ns, "the scene's start");
  gyro_deblur::write_tf_static(
      bag, begin,
      gyro_deblur::extrinsic_message(scene.imu.R_cam_imu, Eigen::Vector3d::Zero(), kImuFrame, kCameraFrame, begin));
  std::size_t next_imu = 0;
  const auto write_imu_until = [&](TimeNs t_ns) {
    for (; next_imu < imu.size() && imu[next_imu].t_ns - time_offset_ns <= t_ns; ++next_imu) {
      const ImuSample& sample = imu[next_imu];
      bag.write("/imu", bag_time(sample.t_ns - time_offset_ns, "IMU sample"),
                gyro_deblur::imu_message(header(sample.t_ns, kImuFrame, "IMU sample"), sample.rate_rad_s,
                                         sample.specific_force_m_s2));
    }
  };

  sensor_msgs::CameraInfo info = gyro_deblur::camera_info_message(scene.camera.calibration);
  const std::string& encoding = scene.camera.encoding;
  gyro_deblur::Progress progress(static_cast<std::size_t>(simulator.frames()), "images", arguments.quiet);
  nlohmann::json per_frame = nlohmann::json::array();
  const auto started = std::chrono::steady_clock::now();
  for (int i = 0; i < simulator.frames(); ++i) {
    const Frame frame = simulator.frame(i);
    const TimeNs finished_ns = simulator.exposure(i).frame().end_ns, reference_ns = simulator.reference_time(i);
    const ros::Time finished = bag_time(finished_ns, "image");
    write_imu_until(finished_ns);

    const std_msgs::Header h = header(frame.stamp_ns, kCameraFrame, "image stamp");
    gyro_deblur::Exposure exposure;
    exposure.header = h;
    exposure.exposure_time = gyro_deblur::bag_duration(frame.timing.exposure_ns);
    exposure.readout_time = gyro_deblur::bag_duration(frame.timing.readout_ns);
    info.header = h;
    bag.write("/camera/exposure", finished, exposure);
    bag.write("/camera/camera_info", finished, info);
    bag.write("/camera/image_raw", finished, gyro_deblur::image_message(h, frame.image, encoding));

    bag.write("/truth/pose", finished,
              pose_message(header(reference_ns, kWorldFrame, "reference time"), simulator.pose(reference_ns)));
    if (!arguments.no_truth) {
      bag.write("/truth/sharp", finished, gyro_deblur::image_message(h, simulator.sharp(i), encoding));
      bag.write("/truth/global_shutter", finished,
                gyro_deblur::image_message(header(reference_ns, kCameraFrame, "reference time"),
                                           simulator.global_shutter(reference_ns), encoding));
    }
    const std::vector<double> extents = true_extents(simulator, i);
    per_frame.push_back({{"stamp_ns", frame.stamp_ns},
                         {"reference_ns", reference_ns},
                         {"exposure_ns", frame.timing.exposure_ns},
                         {"sub_exposures", frame.sub_exposures},
                         {"median_extent_px", extents.empty() ? 0.0 : extents[extents.size() / 2]},
                         {"max_extent_px", extents.empty() ? 0.0 : extents.back()}});
    progress.done(static_cast<std::size_t>(i) + 1);
  }
  write_imu_until(scene.end_ns());
  bag.close();
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - started;
  return {{"bag", arguments.output},
          {"scene", arguments.scene},
          {"seed", scene.seed},
          {"images", simulator.frames()},
          {"imu_samples", imu.size()},
          {"encoding", encoding},
          {"width_px", scene.camera.calibration.width_px},
          {"height_px", scene.camera.calibration.height_px},
          {"readout_ns", scene.camera.readout_ns},
          {"time_offset_ns", time_offset_ns},
          {"truth_images", !arguments.no_truth},
          {"seconds_per_image", elapsed.count() / simulator.frames()},
          {"frames", per_frame}};
}

int run(const Arguments& arguments) {
  Scene scene = gyro_deblur::sim::load_scene(arguments.scene);
  if (arguments.frames > 0) scene.frames = arguments.frames;
  if (arguments.seed >= 0) scene.seed = static_cast<std::uint64_t>(arguments.seed);
  Simulator simulator(std::move(scene));

  // Written beside the target, so that a failure leaves no half bag under the name asked for.
  const std::string partial = arguments.output + ".part";
  nlohmann::json report;
  try {
    report = write_bag(simulator, arguments, partial);
    std::filesystem::rename(partial, arguments.output);
  } catch (...) {
    std::error_code ignored;
    std::filesystem::remove(partial, ignored);
    throw;
  }
  std::cout << arguments.output << ": " << report["images"] << " images, " << report["imu_samples"] << " IMU samples\n";
  if (!arguments.json.empty()) {
    std::ofstream file(arguments.json);
    file << report.dump(2) << '\n';
    if (!file) throw std::runtime_error(arguments.json + ": cannot be written");
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Simulates a moving rolling-shutter camera and an IMU with known truth into a ROS bag.", "simulate_bag"};
  app.footer(
      "Topics: /camera/image_raw, /camera/camera_info, /camera/exposure, /imu, /tf_static (imu -> camera), /truth/pose "
      "(world, at the middle of the middle row's exposure), /truth/sharp (every row at its mid-exposure) and "
      "/truth/global_shutter (all rows at the stamp, the middle of the middle row's exposure).");
  Arguments arguments;
  app.add_option("OUT", arguments.output, "bag to write")->required();
  app.add_option("--scene", arguments.scene, "YAML scene; config/scenes/handheld.yaml documents the keys")->required();
  app.add_option("--frames", arguments.frames, "number of images [as in the scene]")->check(CLI::Range(1, 1000000));
  app.add_option("--seed", arguments.seed, "seed of all noise [as in the scene]")->check(CLI::Range(0, 1000000000));
  app.add_option("--json", arguments.json, "write what was simulated to this file as JSON");
  app.add_flag("--no-truth", arguments.no_truth, "leave the truth images out (faster)");
  app.add_flag("--quiet", arguments.quiet, "no progress on stderr");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(arguments);
  } catch (const std::exception& error) {
    std::cerr << "simulate_bag: " << error.what() << '\n';
    return 1;
  }
}
