#include "recording.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <boost/make_shared.hpp>

#include "ros/conversions.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"
#include "tools/bag_messages.hpp"

namespace gyro_deblur::test {

Config load_known_config(const std::string& path) {
  std::vector<std::string> unknown;
  Config config = load_config(path, &unknown);
  if (!unknown.empty()) throw OptionError(path + ": " + unknown_key_message(unknown.front()));
  return config;
}

Stream stream_of(const Delivery& delivery) {
  constexpr Stream kStreamOfKind[] = {Stream::IMU, Stream::IMAGE, Stream::CAMERA_INFO, Stream::EXPOSURE, Stream::CLOCK};
  return kStreamOfKind[delivery.message.index()];
}

void deliver(const Delivery& delivery, Processor* processor) {
  if (const auto* imu = std::get_if<sensor_msgs::ImuConstPtr>(&delivery.message)) {
    processor->add_imu(**imu);
  } else if (const auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message)) {
    processor->add_image(*image);
  } else if (const auto* info = std::get_if<sensor_msgs::CameraInfoConstPtr>(&delivery.message)) {
    processor->add_camera_info(*info);
  } else if (const auto* exposure = std::get_if<ExposureConstPtr>(&delivery.message)) {
    processor->add_exposure(**exposure);
  } else {
    (*std::get<ActionConstPtr>(delivery.message))(*processor);
  }
}

Recording::Recording(const std::string& scene_path, double seconds) {
  sim::Scene scene = sim::load_scene(scene_path);
  scene.frames = std::clamp(static_cast<int>(std::lround(seconds * scene.camera.fps)), 1, scene.frames);
  frame_period_ns_ = to_ns(1 / scene.camera.fps);
  sim::Simulator simulator(std::move(scene));
  const sim::Scene& simulated = simulator.scene();

  std_msgs::Header header;
  header.frame_id = "imu";
  for (const sim::ImuSample& sample : simulator.imu()) {
    header.stamp = to_ros_time(sample.t_ns);
    const TimeNs at_ns = sample.t_ns - simulated.imu.time_offset_ns;
    deliveries_.push_back({at_ns, at_ns,
                           sensor_msgs::ImuConstPtr(boost::make_shared<sensor_msgs::Imu>(
                               imu_message(header, sample.rate_rad_s, sample.specific_force_m_s2))),
                           0});
  }
  header.frame_id = "camera";
  auto info = camera_info_message(simulated.camera.calibration);
  const double center_x = (simulated.camera.calibration.width_px - 1) / 2.0;
  const double center_y = (simulated.camera.calibration.height_px - 1) / 2.0;
  for (int i = 0; i < simulator.frames(); ++i) {
    const sim::Frame frame = simulator.frame(i);
    const TimeNs at_ns = simulator.exposure(i).frame().end_ns;
    header.stamp = to_ros_time(frame.stamp_ns);
    const Exposure exposure = exposure_message(header, frame.timing.exposure_ns, frame.timing.readout_ns);
    info.header = header;
    const auto index = static_cast<std::size_t>(i);
    deliveries_.push_back({at_ns, at_ns, ExposureConstPtr(boost::make_shared<Exposure>(exposure)), index});
    deliveries_.push_back(
        {at_ns, at_ns, sensor_msgs::CameraInfoConstPtr(boost::make_shared<sensor_msgs::CameraInfo>(info)), index});
    deliveries_.push_back(
        {at_ns, at_ns, sensor_msgs::ImageConstPtr(to_image(frame.image, header, simulated.camera.encoding)), index});
    center_extents_px_.push_back(simulator.recorded_displacement(i, {center_x, center_y}).norm());
  }
  std::stable_sort(deliveries_.begin(), deliveries_.end(),
                   [](const Delivery& a, const Delivery& b) { return a.at_ns < b.at_ns; });
}

std::vector<Delivery> Recording::repeatable(TimeNs* length_ns) const {
  const auto first_image = std::find_if(deliveries_.begin(), deliveries_.end(),
                                        [](const Delivery& delivery) { return stream_of(delivery) == Stream::IMAGE; });
  const TimeNs from_ns = first_image->at_ns - frame_period_ns_ / 2;
  *length_ns = static_cast<TimeNs>(frames()) * frame_period_ns_;
  std::vector<Delivery> piece;
  std::copy_if(deliveries_.begin(), deliveries_.end(), std::back_inserter(piece), [&](const Delivery& delivery) {
    return delivery.at_ns >= from_ns && delivery.at_ns < from_ns + *length_ns;
  });
  return piece;
}

}  // namespace gyro_deblur::test
