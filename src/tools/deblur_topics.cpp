// Finds the input topics of deblur_bag.
#include "tools/deblur_topics.hpp"

#include <stdexcept>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include "ros/exposure_adapter.hpp"
#include "ros/messages.hpp"
#include "sync/missing_inputs.hpp"

namespace gyro_deblur {
namespace {

void choose_exposure(const InputBag& input, const NamedTopics& named, const Config& config, const std::string& home,
                     DeblurTopics* chosen) {
  const ExposureSource::Kind kind = config.exposure_source.kind;
  const std::string own_type = ros::message_traits::datatype<Exposure>(), named_type = input.type_of(named.exposure);
  const bool takes_own = kind == ExposureSource::Kind::MESSAGE ||
                         (kind == ExposureSource::Kind::AUTO && (named_type.empty() || named_type == own_type));
  if (!takes_own) {
    if (named_type.empty()) {
      throw std::runtime_error(
          "exposure_source of the configuration reads a driver's messages, and --exposure-topic \"" + named.exposure +
          "\" is no topic of the bag, which has " + list_of(input.topics()));
    }
    chosen->exposure = named.exposure;
    chosen->reads_driver_messages = true;
    return;
  }
  chosen->exposure = input.choose_topic<Exposure>("exposure", named.exposure, home + "/exposure", false);
  const std::string metadata = home + "/metadata";
  if (kind != ExposureSource::Kind::AUTO || !chosen->exposure.empty() || input.type_of(metadata) != kRealsenseMetadata)
    return;
  chosen->exposure = metadata;
  chosen->reads_driver_messages = true;
}

}  // namespace

DeblurTopics choose_topics(const InputBag& input, const NamedTopics& named, const Config& config) {
  try {
    DeblurTopics chosen;
    chosen.image = choose_images(input, named.images);
    const std::string name_space = chosen.image.name_space();
    const std::string home = named.images.home(name_space);
    const bool info_required = (!config.calibration || !config.calibration->camera) && !goes_without_imu(config);
    chosen.camera_info = input.choose_topic<sensor_msgs::CameraInfo>("camera_info", named.camera_info,
                                                                     name_space + "/camera_info", info_required);
    chosen.imu = input.choose_topic<sensor_msgs::Imu>("imu", named.imu, "", !goes_without_imu(config));
    choose_exposure(input, named, config, home, &chosen);
    const std::string mask = home + "/" + kMaskTopic;
    const bool has_mask = input.type_of(mask) == ros::message_traits::datatype<sensor_msgs::Image>();
    if (has_mask && !named.mask_by_file) chosen.mask = mask;
    chosen.output_namespace = named.output_namespace.empty() ? home : named.output_namespace;
    return chosen;
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(input.path() + ": " + error.what());
  }
}

}  // namespace gyro_deblur
