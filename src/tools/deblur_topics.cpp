#include "tools/deblur_topics.hpp"

#include <stdexcept>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Imu.h>

#include "ros/messages.hpp"

namespace gyro_deblur {
namespace {

DeblurTopics choose(const InputBag& input, const NamedTopics& named, const Config& config) {
  DeblurTopics chosen;
  chosen.image = choose_images(input, named.images);
  const std::string beside = chosen.image.name_space();
  const std::string home = named.images.home(beside);
  const bool info_required = !config.calibration || !config.calibration->camera;
  chosen.camera_info = input.choose_topic<sensor_msgs::CameraInfo>("camera_info", named.camera_info,
                                                                   beside + "/camera_info", info_required);
  chosen.imu = input.choose_topic<sensor_msgs::Imu>("imu", named.imu, "", true);
  if (!reads_driver_messages(config)) {
    chosen.exposure = input.choose_topic<Exposure>("exposure", named.exposure, home + "/exposure", false);
  } else if (input.topics().count(named.exposure) > 0) {
    chosen.exposure = named.exposure;
  } else {
    throw std::runtime_error("exposure_source of the configuration needs --exposure-topic with a topic of the bag");
  }
  chosen.output_namespace = named.output_namespace.empty() ? home : named.output_namespace;
  return chosen;
}

}  // namespace

OutputTopics::OutputTopics(const std::string& name_space)
    : image(name_space + "/deblurred/image_raw"),
      camera_info(name_space + "/deblurred/camera_info"),
      keypoints(name_space + "/keypoints"),
      blur_field(name_space + "/blur_field"),
      quality(name_space + "/image_quality"),
      trust_mask(name_space + "/trust_mask"),
      overlay(name_space + "/blur_overlay"),
      markers(name_space + "/blur_markers"),
      tracks(name_space + "/feature_tracks"),
      global_shutter(name_space + "/global_shutter/image_raw"),
      global_shutter_info(name_space + "/global_shutter/camera_info") {}

std::set<std::string> OutputTopics::all() const {
  return {image,   camera_info, keypoints,      blur_field,         quality, trust_mask, overlay,
          markers, tracks,      global_shutter, global_shutter_info};
}

bool reads_driver_messages(const Config& config) {
  return config.exposure_source.kind != ExposureSource::Kind::MESSAGE;
}

DeblurTopics choose_topics(const InputBag& input, const NamedTopics& named, const Config& config) {
  try {
    return choose(input, named, config);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(input.path() + ": " + error.what());
  }
}

}  // namespace gyro_deblur
