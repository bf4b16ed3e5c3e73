// Chooses the image topic of a bag.
#include "tools/image_topics.hpp"

#include <cstddef>
#include <stdexcept>

#include <rosbag/view.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <boost/algorithm/string.hpp>

#include "ros/compressed_image.hpp"
#include "tools/bag_reading.hpp"

namespace gyro_deblur {
namespace {

constexpr char kRawType[] = "sensor_msgs/Image";
constexpr char kCompressedType[] = "sensor_msgs/CompressedImage";
constexpr char kCompressedSuffix[] = "/compressed";            // image_transport's name below that of the image
constexpr char kCompressedDepthSuffix[] = "/compressedDepth";  // of compressed_depth_image_transport

std::string without_suffix(const std::string& topic) {
  return boost::ends_with(topic, kCompressedSuffix) ? boost::erase_last_copy(topic, kCompressedSuffix) : topic;
}

bool is_named_like_depth(const std::string& topic) {
  return boost::icontains(topic, "depth") || boost::icontains(topic, "disparity");
}

/// Millimetres, and metres (REP 118), which compressed images have at the beginning of their format.
bool is_encoded_like_depth(const std::string& encoding) {
  return boost::starts_with(encoding, "16UC1") || boost::starts_with(encoding, "32FC1") ||
         boost::contains(encoding, "compressedDepth");
}

/// Encoding or format of the first message of a topic; empty where there is none.
std::string first_encoding(const InputBag& input, const std::string& topic) {
  rosbag::View view(input.bag(), rosbag::TopicQuery(topic));
  const rosbag::View::iterator first = view.begin();  // has the message
  if (first == view.end()) return {};
  if (const auto image = read_message<sensor_msgs::Image>(*first)) return image->encoding;
  const auto compressed = read_message<sensor_msgs::CompressedImage>(*first);
  return compressed ? compressed->format : std::string();
}

bool is_depth(const InputBag& input, const std::string& topic) {
  return is_named_like_depth(topic) || is_encoded_like_depth(first_encoding(input, topic));
}

/// Topics of images by type, less the compressed versions of raw ones.
BagTopics image_topics(const BagTopics& topics) {
  BagTopics found;
  for (const auto& [name, type] : topics) {
    const bool version_of_raw =
        type == kCompressedType && topics.count(without_suffix(name)) > 0 && without_suffix(name) != name;
    const bool is_image = type == kRawType || type == kCompressedType;
    if (is_image && !version_of_raw && !boost::ends_with(name, kCompressedDepthSuffix)) found.emplace(name, type);
  }
  return found;
}

std::string only_images(const InputBag& input) {
  const BagTopics all = image_topics(input.topics());
  BagTopics candidates;
  for (const auto& [name, type] : all) {
    const bool is_mask = boost::ends_with(name, std::string("/") + kMaskTopic);
    if (!is_mask && !is_depth(input, name)) candidates.emplace(name, type);
  }
  if (candidates.size() == 1) return candidates.begin()->first;
  if (!candidates.empty()) {
    throw std::runtime_error("several topics of images, name one with --image-topic: " + list_of(candidates));
  }
  const std::string only_depth =
      all.empty() ? "" : ", only depth or masks, which are taken where --image-topic names it";
  throw std::runtime_error("no topic of type " + std::string(kRawType) + " or " + kCompressedType + " for images" +
                           only_depth + "; the bag has " + list_of(input.topics()));
}

/// The topic that the user means.
std::string named_topic(const BagTopics& topics, const NamedImages& named) {
  std::string topic = named.topic.empty() ? "image_raw" : named.topic;
  if (topic.front() != '/') topic = named.home("") + "/" + topic;
  const std::string compressed = topic + kCompressedSuffix;
  return topics.count(topic) == 0 && topics.count(compressed) > 0 ? compressed : topic;
}

}  // namespace

void add_image_options(CommandLine& app, NamedImages* named) {
  app.add_option("--camera-ns", named->camera_namespace, "namespace of the camera");
  app.add_option(
      "--image-topic", named->topic,
      "sensor_msgs/Image or sensor_msgs/CompressedImage, in --camera-ns unless it begins with / [image_raw in "
      "--camera-ns, else the only one, depth left out]");
}

std::string NamedImages::home(const std::string& images_namespace) const {
  const std::size_t begin = camera_namespace.find_first_not_of('/'), end = camera_namespace.find_last_not_of('/');
  return begin == std::string::npos ? images_namespace : "/" + camera_namespace.substr(begin, end + 1 - begin);
}

std::string ImageTopic::name_space() const { return parent_namespace(compressed ? without_suffix(name) : name); }

sensor_msgs::ImageConstPtr read_image(const rosbag::MessageInstance& instance, bool compressed) {
  if (!compressed) return read_message<sensor_msgs::Image>(instance);
  const auto message = read_message<sensor_msgs::CompressedImage>(instance);
  if (!message) return nullptr;
  const DecodedImage decoded = decode_image(*message);
  return decoded.problem.empty() ? decoded.image : nullptr;
}

ImageTopic choose_images(const InputBag& input, const NamedImages& named) {
  const bool is_named = !named.topic.empty() || !named.camera_namespace.empty();
  const std::string topic = is_named ? named_topic(input.topics(), named) : only_images(input);
  ImageTopic chosen;
  chosen.compressed = input.type_of(topic) == kCompressedType;
  chosen.name = chosen.compressed ? input.choose_topic<sensor_msgs::CompressedImage>("images", topic, "", true)
                                  : input.choose_topic<sensor_msgs::Image>("images", topic, "", true);
  return chosen;
}

}  // namespace gyro_deblur
