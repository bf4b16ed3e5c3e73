#include "tools/deblur_topics.hpp"

#include <algorithm>
#include <stdexcept>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include "ros/messages.hpp"

namespace gyro_deblur {
namespace {

constexpr char kCompressedType[] = "sensor_msgs/CompressedImage";
constexpr char kCompressedSuffix[] = "/compressed";  // image_transport's name for the topic beside that of the image

bool has_type(const BagTopics& topics, const std::string& type) {
  return std::any_of(topics.begin(), topics.end(), [&type](const auto& topic) { return topic.second == type; });
}

/// Raw images where the bag has them, else compressed ones.
void choose_images(const InputBag& input, const NamedTopics& named, DeblurTopics* chosen) {
  const BagTopics& topics = input.topics();
  std::string image = named.image;
  if (image.empty() && !named.camera_namespace.empty()) {
    image = named.camera_namespace + "/image_raw";
    if (topics.count(image) == 0 && topics.count(image + kCompressedSuffix) > 0) image += kCompressedSuffix;
  }
  const auto found = topics.find(image);
  chosen->compressed = image.empty() ? !has_type(topics, "sensor_msgs/Image") && has_type(topics, kCompressedType)
                                     : found != topics.end() && found->second == kCompressedType;
  chosen->image = chosen->compressed ? input.choose_topic<sensor_msgs::CompressedImage>("images", image, "", true)
                                     : input.choose_topic<sensor_msgs::Image>("images", image, "", true);
}

/// What belongs to the image stands beside it, not beside its compressed version.
std::string namespace_of_images(const DeblurTopics& chosen) {
  std::string image = chosen.image;
  const std::size_t suffix = std::string(kCompressedSuffix).size();
  if (chosen.compressed && image.size() > suffix && image.substr(image.size() - suffix) == kCompressedSuffix) {
    image.resize(image.size() - suffix);
  }
  return parent_namespace(image);
}

DeblurTopics choose(const InputBag& input, const NamedTopics& named, const Config& config) {
  DeblurTopics chosen;
  choose_images(input, named, &chosen);
  const std::string beside = namespace_of_images(chosen);
  const bool info_required = !config.calibration || !config.calibration->camera;
  chosen.camera_info = input.choose_topic<sensor_msgs::CameraInfo>("camera_info", named.camera_info,
                                                                   beside + "/camera_info", info_required);
  chosen.imu = input.choose_topic<sensor_msgs::Imu>("imu", named.imu, "", true);
  if (!reads_driver_messages(config)) {
    chosen.exposure = input.choose_topic<Exposure>("exposure", named.exposure, beside + "/exposure", false);
  } else if (input.topics().count(named.exposure) > 0) {
    chosen.exposure = named.exposure;
  } else {
    throw std::runtime_error("exposure_source of the configuration needs --exposure-topic with a topic of the bag");
  }
  chosen.output_namespace = named.output_namespace.empty() ? beside : named.output_namespace;
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
