// A ROS bag from a simulated camera and IMU whose truth is known.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <std_msgs/Header.h>
#include <nlohmann/json.hpp>

#include "base/median.hpp"
#include "ros/conversions.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"
#include "tools/bag_file.hpp"
#include "tools/bag_messages.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

using sim::Frame;
using sim::ImuSample;
using sim::Pose;
using sim::Scene;
using sim::Simulator;

constexpr char kCameraFrame[] = "camera";
constexpr char kImuFrame[] = "imu";
constexpr char kWorldFrame[] = "world";

struct Arguments {
  std::string output;
  std::string scene;
  int frames = 0;       // 0: as the scene says
  long long seed = -1;  // -1: as the scene says
  CommonArguments common;
  bool no_truth = false;
};

geometry_msgs::PoseStamped pose_message(const std_msgs::Header& header, const Pose& pose) {
  geometry_msgs::PoseStamped message;
  message.header = header;
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
      const double extent = simulator.recorded_displacement(frame, pixel).norm();
      if (std::isfinite(extent)) extents.push_back(extent);
    }
  }
  return extents;
}

/// Writes what a simulator shows. Recorded in the camera clock, which is also that of truth: an IMU sample when it was
/// taken, whatever its stamp.
class SimulationWriter {
 public:
  SimulationWriter(rosbag::Bag& bag, Simulator& simulator, bool truth_images)
      : bag_(bag),
        simulator_(simulator),
        scene_(simulator.scene()),
        truth_images_(truth_images),
        imu_(simulator.imu()),
        info_(camera_info_message(scene_.camera.calibration)) {}

  std::size_t imu_samples() const { return imu_.size(); }

  void write_extrinsic() {
    const ros::Time begin = bag_time(scene_.start_ns, "the scene's start");
    gyro_deblur::write_extrinsic(bag_, begin, scene_.imu.R_cam_imu, Eigen::Vector3d::Zero(), kImuFrame, kCameraFrame);
  }

  /// The IMU samples up to a frame's end, and the frame. Returns the frame's part of the report.
  nlohmann::json write_frame(int i) {
    const Frame frame = simulator_.frame(i);
    const TimeNs finished_ns = simulator_.exposure(i).frame().end_ns, reference_ns = simulator_.reference_time(i);
    const ros::Time finished = bag_time(finished_ns, "image");
    write_imu_until(finished_ns);

    info_.header = make_header(bag_time(frame.stamp_ns, "image stamp"), kCameraFrame);
    bag_.write("/camera/exposure", finished,
               exposure_message(info_.header, frame.timing.exposure_ns, frame.timing.readout_ns));
    bag_.write("/camera/camera_info", finished, info_);
    bag_.write("/camera/image_raw", finished, to_image(frame.image, info_.header, scene_.camera.encoding));
    write_truth(i, finished, reference_ns);
    const std::vector<double> extents = true_extents(simulator_, i);
    return {{"stamp_ns", frame.stamp_ns},
            {"reference_ns", reference_ns},
            {"exposure_ns", frame.timing.exposure_ns},
            {"sub_exposures", frame.sub_exposures},
            {"median_extent_px", median(extents)},
            {"max_extent_px", extents.empty() ? 0.0 : *std::max_element(extents.begin(), extents.end())}};
  }

  void write_imu_until(TimeNs t_ns) {
    const TimeNs time_offset_ns = scene_.imu.time_offset_ns;
    for (; next_imu_ < imu_.size() && imu_[next_imu_].t_ns - time_offset_ns <= t_ns; ++next_imu_) {
      const ImuSample& sample = imu_[next_imu_];
      bag_.write("/imu", bag_time(sample.t_ns - time_offset_ns, "IMU sample"),
                 imu_message(make_header(bag_time(sample.t_ns, "IMU sample"), kImuFrame), sample.rate_rad_s,
                             sample.specific_force_m_s2));
    }
  }

 private:
  void write_truth(int i, ros::Time finished, TimeNs reference_ns) {
    const ros::Time reference = bag_time(reference_ns, "reference time");
    const std::string& encoding = scene_.camera.encoding;
    bag_.write("/truth/pose", finished,
               pose_message(make_header(reference, kWorldFrame), simulator_.pose(reference_ns)));
    if (!truth_images_) return;
    bag_.write("/truth/sharp", finished, to_image(simulator_.sharp(i), info_.header, encoding));
    bag_.write("/truth/global_shutter", finished,
               to_image(simulator_.global_shutter(reference_ns), make_header(reference, kCameraFrame), encoding));
  }

  rosbag::Bag& bag_;
  Simulator& simulator_;
  const Scene& scene_;
  const bool truth_images_;
  const std::vector<ImuSample> imu_;
  std::size_t next_imu_ = 0;
  sensor_msgs::CameraInfo info_;
};

nlohmann::json write_simulation(rosbag::Bag& bag, Simulator& simulator, const Arguments& arguments) {
  const Scene& scene = simulator.scene();
  SimulationWriter writer(bag, simulator, !arguments.no_truth);
  writer.write_extrinsic();
  Progress progress(static_cast<std::size_t>(simulator.frames()), "images", arguments.common.quiet);
  nlohmann::json frames = nlohmann::json::array();
  const auto started = std::chrono::steady_clock::now();
  for (int i = 0; i < simulator.frames(); ++i) {
    frames.push_back(writer.write_frame(i));
    progress.done(static_cast<std::size_t>(i) + 1);
  }
  writer.write_imu_until(scene.end_ns());
  bag.close();
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - started;
  return {{"bag", arguments.output},
          {"scene", arguments.scene},
          {"seed", scene.seed},
          {"images", simulator.frames()},
          {"imu_samples", writer.imu_samples()},
          {"encoding", scene.camera.encoding},
          {"width_px", scene.camera.calibration.width_px},
          {"height_px", scene.camera.calibration.height_px},
          {"readout_ns", scene.camera.readout_ns},
          {"time_offset_ns", scene.imu.time_offset_ns},
          {"truth_images", !arguments.no_truth},
          {"seconds_per_image", elapsed.count() / simulator.frames()},
          {"frames", frames}};
}

void run(const Arguments& arguments) {
  Scene scene = sim::load_scene(arguments.scene);
  if (arguments.frames > 0) scene.frames = arguments.frames;
  if (arguments.seed >= 0) scene.seed = static_cast<std::uint64_t>(arguments.seed);
  Simulator simulator(std::move(scene));

  OutputBag output(arguments.output);
  const nlohmann::json report = write_simulation(output.bag(), simulator, arguments);
  output.finish();
  std::cout << arguments.output << ": " << report["images"] << " images, " << report["imu_samples"] << " IMU samples\n";
  write_json(arguments.common.json, report);
}

int main_of(int argc, char** argv) {
  CommandLine app{"Simulates a moving rolling-shutter camera and an IMU with known truth into a ROS bag.",
                  "simulate_bag"};
  app.footer(
      "Topics: /camera/image_raw, /camera/camera_info, /camera/exposure, /imu, /tf_static (imu -> camera), /truth/pose "
      "(world, at the middle of the middle row's exposure), /truth/sharp (every row at its mid-exposure) and "
      "/truth/global_shutter (all rows at the stamp, the middle of the middle row's exposure).");
  Arguments arguments;
  app.add_option("OUT", arguments.output, "bag to write").required();
  app.add_option("--scene", arguments.scene, "YAML scene; config/scenes/handheld.yaml documents the keys").required();
  app.add_option("--frames", arguments.frames, "number of images [as in the scene]").range(1, 1000000);
  app.add_option("--seed", arguments.seed, "seed of all noise [as in the scene]").range(0, 1000000000);
  app.add_flag("--no-truth", arguments.no_truth, "leave the truth images out (faster)");
  add_common_options(app, &arguments.common);
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
