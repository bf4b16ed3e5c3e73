// Chooses the image topic of a bag.
#include "tools/image_topics.hpp"

#include <algorithm>
#include <cctype>
#include <cstddef>
#include <iterator>
#include <stdexcept>
#include <vector>

#include <rosbag/view.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include "ros/compressed_image.hpp"
#include "tools/bag_reading.hpp"

namespace gyro_deblur {
namespace {

constexpr char kRawType[] = "sensor_msgs/Image";
constexpr char kCompressedType[] = "sensor_msgs/CompressedImage";
constexpr char kCompressedSuffix[] = "/compressed";            // image_transport's name below that of the image
constexpr char kCompressedDepthSuffix[] = "/compressedDepth";  // of compressed_depth_image_transport

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

std::string without_suffix(const std::string& topic) {
  return ends_with(topic, kCompressedSuffix) ? topic.substr(0, topic.size() - std::string(kCompressedSuffix).size())
                                             : topic;
}

bool holds(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

bool is_named_like_depth(std::string topic) {
  std::transform(topic.begin(), topic.end(), topic.begin(), [](unsigned char c) { return std::tolower(c); });
  return holds(topic, "depth") || holds(topic, "disparity");
}

/// Millimetres, and metres (REP 118), which compressed images have at the beginning of their format.
bool is_encoded_like_depth(const std::string& encoding) {
  return encoding.rfind("16UC1", 0) == 0 || encoding.rfind("32FC1", 0) == 0 || holds(encoding, "compressedDepth");
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
std::vector<std::string> image_topics(const BagTopics& topics) {
  std::vector<std::string> found;
  for (const auto& [name, type] : topics) {
    const bool version_of_raw =
        type == kCompressedType && topics.count(without_suffix(name)) > 0 && without_suffix(name) != name;
    if ((type == kRawType || type == kCompressedType) && !version_of_raw && !ends_with(name, kCompressedDepthSuffix)) {
      found.push_back(name);
    }
  }
  return found;
}

std::string only_images(const InputBag& input) {
  const std::vector<std::string> all = image_topics(input.topics());
  std::vector<std::string> candidates;
  std::copy_if(all.begin(), all.end(), std::back_inserter(candidates), [&input](const std::string& topic) {
    return !ends_with(topic, std::string("/") + kMaskTopic) && !is_depth(input, topic);
  });
  if (candidates.size() == 1) return candidates.front();
  if (!candidates.empty()) {
    std::string list;
    for (const std::string& topic : candidates) {
      list += (list.empty() ? "" : ", ") + topic + " (" + input.topics().at(topic) + ")";
    }
    throw std::runtime_error("several topics of images, name one with --image-topic: " + list);
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
  const auto found = input.topics().find(topic);
  ImageTopic chosen;
  chosen.compressed = found != input.topics().end() && found->second == kCompressedType;
  chosen.name = chosen.compressed ? input.choose_topic<sensor_msgs::CompressedImage>("images", topic, "", true)
                                  : input.choose_topic<sensor_msgs::Image>("images", topic, "", true);
  return chosen;
}

}  // namespace gyro_deblur
