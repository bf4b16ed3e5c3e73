// Recorded flights through a room of photographs as bags for a SLAM stack: each flight blurred and sharp, in several
// lights, with several draws of noise, and its truth.
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <nlohmann/json.hpp>

#include "footage.hpp"
#include "gyro_deblur/exposure.hpp"
#include "ros/conversions.hpp"
#include "tools/bag_file.hpp"
#include "tools/bag_messages.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr char kCameraFrame[] = "camera", kImuFrame[] = "imu";

struct Arguments {
  std::string output, data = GYRO_DEBLUR_DATA_DIR, flight = "V1_02_medium";
  double seconds = 30, speed = 1, exposure_ms = 30, readout_ms = 0;
  std::vector<std::uint64_t> seeds = {1, 2, 3};
  std::vector<std::string> lights = {"day", "low"};
  std::size_t first_photograph = 0;
  bool quiet = false;
};

test::RecordedFlight flight_of(const std::string& name) {
  std::string known;
  for (const test::RecordedFlight& flight : test::recorded_flights()) {
    const std::string stem = std::filesystem::path(flight.file).stem().string();
    if (stem == name) return flight;
    known += (known.empty() ? "" : ", ") + stem;
  }
  throw std::runtime_error("--flight " + name + " is none of " + known);
}

/// One camera in one light with one draw of noise.
class SequenceWriter {
 public:
  SequenceWriter(const std::string& path, Footage& footage, std::uint64_t seed)
      : output_(path), footage_(footage), imu_(footage.imu(seed)) {
    info_ = camera_info_message(footage.camera().calibration());
    const ros::Time begin = bag_time(imu_.front().t_ns, "the first IMU sample");
    write_extrinsic(output_.bag(), begin, footage.truth().scene().imu.R_cam_imu, Footage::p_imu_cam_m(), kImuFrame,
                    kCameraFrame);
  }

  /// @param i  frame, in order
  /// @param with_exposure  false: an image that has none, of one instant
  void write(int i, const cv::Mat& image, TimeNs stamp_ns, bool with_exposure) {
    const RowExposure exposure = footage_.exposure(i);
    const TimeNs finished_ns = exposure.frame().end_ns;
    write_imu_until(finished_ns);
    const ros::Time finished = bag_time(finished_ns, "image");
    info_.header = make_header(bag_time(stamp_ns, "image stamp"), kCameraFrame);
    if (with_exposure) {
      const ShutterTiming timing = footage_.truth().scene().timing(i);
      output_.bag().write("/camera/exposure", finished,
                          exposure_message(info_.header, timing.exposure_ns, timing.readout_ns));
    }
    output_.bag().write("/camera/camera_info", finished, info_);
    output_.bag().write("/camera/image_raw", finished, to_image(image, info_.header, "mono8"));
  }

  void finish() {
    write_imu_until(imu_.back().t_ns);
    output_.finish();
  }

 private:
  void write_imu_until(TimeNs t_ns) {
    for (; next_imu_ < imu_.size() && imu_[next_imu_].t_ns <= t_ns; ++next_imu_) {
      const sim::ImuSample& sample = imu_[next_imu_];
      const ros::Time stamp = bag_time(sample.t_ns, "IMU sample");
      output_.bag().write("/imu", stamp,
                          imu_message(make_header(stamp, kImuFrame), sample.rate_rad_s, sample.specific_force_m_s2));
    }
  }

  OutputBag output_;
  Footage& footage_;
  const std::vector<sim::ImuSample> imu_;
  std::size_t next_imu_ = 0;
  sensor_msgs::CameraInfo info_;
};

/// The IMU's states at every sample of the simulated IMU: t [ns], p [m], q (w x y z), v [m/s], biases [rad/s, m/s^2],
/// in the columns of EuRoC's state_groundtruth_estimate0.
std::string truth_csv(const Footage& footage) {
  const sim::Scene& scene = footage.truth().scene();
  const Eigen::Quaterniond R_cam_imu(scene.imu.R_cam_imu);
  const auto position_m = [&](TimeNs t_ns) -> Eigen::Vector3d {
    const sim::Pose pose = footage.truth().pose(t_ns);
    return pose.p_world_m - pose.R_world_cam * (R_cam_imu * Footage::p_imu_cam_m());
  };
  // The motion's splines are smooth over some milliseconds.
  constexpr TimeNs kStepNs = 500'000;
  std::string text = "#timestamp [ns],p x,p y,p z [m],q w,q x,q y,q z,v x,v y,v z [m/s],bw [rad/s],,,ba [m/s^2],,\n";
  const std::vector<sim::ImuSample> imu = footage.imu(scene.seed);
  for (std::size_t k = 1; k + 1 < imu.size(); ++k) {
    const TimeNs t_ns = imu[k].t_ns;
    const Eigen::Vector3d p_m = position_m(t_ns);
    const Eigen::Vector3d v_m_s = (position_m(t_ns + kStepNs) - position_m(t_ns - kStepNs)) / to_seconds(2 * kStepNs);
    const Eigen::Quaterniond q = footage.truth().pose(t_ns).R_world_cam * R_cam_imu;
    char line[400];
    const Eigen::Vector3d &bw = scene.imu.gyro_bias_rad_s, &ba = scene.imu.accel_bias_m_s2;
    std::snprintf(line, sizeof(line), "%lld,%.6f,%.6f,%.6f,%.8f,%.8f,%.8f,%.8f,%.6f,%.6f,%.6f,%g,%g,%g,%g,%g,%g\n",
                  static_cast<long long>(t_ns), p_m.x(), p_m.y(), p_m.z(), q.w(), q.x(), q.y(), q.z(), v_m_s.x(),
                  v_m_s.y(), v_m_s.z(), bw.x(), bw.y(), bw.z(), ba.x(), ba.y(), ba.z());
    text += line;
  }
  return text;
}

void run(const Arguments& arguments) {
  const FootageCase footage_case{flight_of(arguments.flight),
                                 to_ns(1e-3 * arguments.exposure_ms),
                                 to_ns(1e-3 * arguments.readout_ms),
                                 arguments.speed,
                                 CameraPath::FLIGHT,
                                 Walls::PAPERED,
                                 arguments.first_photograph};
  Footage footage(footage_case, arguments.data, arguments.seconds);
  std::filesystem::create_directories(arguments.output);
  write_text(arguments.output + "/truth.csv", truth_csv(footage));

  Progress progress(arguments.lights.size() * arguments.seeds.size(), "sequences", arguments.quiet);
  std::size_t done = 0;
  nlohmann::json bags = nlohmann::json::array();
  std::vector<cv::Mat> sharp;
  for (int i = 0; i < footage.frames(); ++i) sharp.push_back(footage.at_one_instant(i));
  for (const std::string& light_name : arguments.lights) {
    const Light& light = light_name == "low" ? kLowLight : kDaylight;
    for (const std::uint64_t seed : arguments.seeds) {
      const std::string name = light_name + "_" + std::to_string(seed);
      SequenceWriter blurred(arguments.output + "/" + name + "_blurred.bag", footage, seed);
      SequenceWriter without(arguments.output + "/" + name + "_sharp.bag", footage, seed);
      for (int i = 0; i < footage.frames(); ++i) {
        // Noise of its own for every image of every draw.
        const std::uint64_t noise_seed = 2 * (seed * 1'000'000 + static_cast<std::uint64_t>(i));
        blurred.write(i, footage.image(i, light, noise_seed), footage.truth().stamp(i), true);
        without.write(i, lit(sharp[static_cast<std::size_t>(i)], light, noise_seed + 1),
                      footage.truth().reference_time(i), false);
      }
      blurred.finish();
      without.finish();
      bags.push_back({{"light", light_name}, {"seed", seed}});
      progress.done(++done);
    }
  }
  const CameraCalibration& calibration = footage.camera().calibration();
  const Eigen::Matrix3d R = footage.truth().scene().imu.R_cam_imu;
  const Eigen::Vector3d p = Footage::p_imu_cam_m();
  nlohmann::json rotation = nlohmann::json::array();
  for (int r = 0; r < 3; ++r) rotation.push_back({R(r, 0), R(r, 1), R(r, 2)});
  write_json(arguments.output + "/sequence.json",
             {{"flight", arguments.flight},
              {"conditions", footage_case.conditions()},
              {"exposure_s", to_seconds(footage_case.exposure_ns)},
              {"readout_s", to_seconds(footage_case.readout_ns)},
              {"speed", arguments.speed},
              {"frames", footage.frames()},
              {"bags", bags},
              {"camera",
               {{"intrinsics", {calibration.fx_px, calibration.fy_px, calibration.cx_px, calibration.cy_px}},
                {"size", {calibration.width_px, calibration.height_px}},
                {"R_cam_imu", rotation},
                {"p_imu_cam_m", {p.x(), p.y(), p.z()}}}},
              {"imu",
               {{"rate_hz", footage.truth().scene().imu.rate_hz},
                {"gyro_noise_rad_s", footage.truth().scene().imu.gyro_noise_rad_s},
                {"accel_noise_m_s2", footage.truth().scene().imu.accel_noise_m_s2}}}});
  std::cout << arguments.output << ": " << bags.size() << " sequences of " << footage.frames() << " images\n";
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Writes bags for a SLAM stack: a recorded flight through a room of photographs, seen by a camera of 752x480 at "
      "20 Hz, in daylight and in low light, blurred (LIGHT_SEED_blurred.bag) and sharp at one instant "
      "(LIGHT_SEED_sharp.bag), both with the IMU, and truth.csv and sequence.json next to them.",
      "slam_sequences"};
  app.add_option("--out", arguments.output, "folder").required();
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--flight", arguments.flight, "file of trajectories/ without its ending [V1_02_medium]");
  app.add_option("--seconds", arguments.seconds, "[30]").range(1.0, 85.0);
  app.add_option("--speed", arguments.speed, "of the flight, 1: as recorded [1]").range(0.2, 3.0);
  app.add_option("--exposure-ms", arguments.exposure_ms, "[30]").range(0.1, 49.0);
  app.add_option("--readout-ms", arguments.readout_ms, "[0]").range(0.0, 40.0);
  app.add_option("--seeds", arguments.seeds, "draws of noise [1 2 3]");
  app.add_option("--lights", arguments.lights, "day, low [both]").one_of({"day", "low"});
  app.add_option("--first-photograph", arguments.first_photograph, "another number: another room [0]");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
