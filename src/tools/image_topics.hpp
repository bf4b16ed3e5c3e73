// Which topic of a bag has the images.
#pragma once

#include <string>

#include <rosbag/message_instance.h>
#include <sensor_msgs/Image.h>

#include "tools/bag_file.hpp"
#include "tools/command_line.hpp"

namespace gyro_deblur {

/// Topics that the user named, as arguments of the launch files.
struct NamedImages {
  std::string camera_namespace;  ///< of a topic that does not begin with "/"; empty: "/"
  std::string topic;             ///< empty: image_raw where there is a namespace, else whatever is found

  /// Where exposures are and outputs go: the camera's namespace, "/" before it, else `images_namespace`.
  std::string home(const std::string& images_namespace) const;
};

/// Adds --camera-ns and --image-topic.
void add_image_options(CommandLine& app, NamedImages* named);

/// Name of the topic of a camera's mask, in the camera's namespace.
inline constexpr char kMaskTopic[] = "mask";

struct ImageTopic {
  std::string name;
  bool compressed = false;  ///< sensor_msgs/CompressedImage

  /// The namespace of what belongs to the images: "/camera" for "/camera/image_raw/compressed".
  std::string name_space() const;
};

/// The image of a message of the topic, decoded where it is compressed; null for a message of another type, or that
/// cannot be decoded as a whole. Throws MessageError.
sensor_msgs::ImageConstPtr read_image(const rosbag::MessageInstance& instance, bool compressed);

/// The images to work on: the topic that is named, or its compressed version; without a name the only images of the
/// bag. A compressed version of a raw topic is not another one. Depth (by the encoding of the first message, or by
/// "depth" or "disparity" in the name) and masks are taken only where they are named.
/// Throws std::runtime_error that lists the candidates when there are several, else the bag's topics; MessageError for
/// a first message that cannot be read.
ImageTopic choose_images(const InputBag& input, const NamedImages& named);

}  // namespace gyro_deblur
