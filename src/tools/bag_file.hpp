// Bags as the tools open them, and their configuration.
#pragma once

#include <map>
#include <string>

#include <ros/message_traits.h>
#include <rosbag/bag.h>

#include "gyro_deblur/config.hpp"
#include "tools/output_file.hpp"

namespace gyro_deblur {

/// "/camera" of "/camera/image_raw".
std::string parent_namespace(const std::string& topic);

/// Topics of a bag by name, with their type.
using BagTopics = std::map<std::string, std::string>;
/// "NAME (TYPE), ...", or "no topics".
std::string list_of(const BagTopics& topics);

/// A bag to read. Throws std::runtime_error that names it and the remedy when it cannot be opened: cut or without an
/// index, of ROS 2, no bag at all.
class InputBag {
 public:
  explicit InputBag(const std::string& path);

  const std::string& path() const { return path_; }
  const rosbag::Bag& bag() const { return bag_; }
  const BagTopics& topics() const { return topics_; }
  /// Type of a topic; empty where the bag does not have it.
  std::string type_of(const std::string& topic) const;

  /// The topic to use for one kind of message: the one named, else the only one of its type.
  /// @param kind  such as "camera_info", which the option --camera-info-topic names
  /// @param preferred  taken, when nothing is named, if the bag has it; may be empty
  /// @return empty when there is none and none is required
  /// Throws std::runtime_error that lists the candidates when there are several, else the bag's topics, and when the
  /// topic's messages have the type's name, but the definition of another version.
  template <typename Message>
  std::string choose_topic(const std::string& kind, const std::string& named, const std::string& preferred,
                           bool required) const {
    namespace traits = ros::message_traits;
    const std::string topic = choose_topic(kind, traits::datatype<Message>(), named, preferred, required);
    if (!topic.empty()) require_definition(topic, traits::md5sum<Message>());
    return topic;
  }

 private:
  std::string choose_topic(const std::string& kind, const std::string& type, const std::string& named,
                           const std::string& preferred, bool required) const;
  void require_definition(const std::string& topic, const std::string& md5sum) const;

  std::string path_;
  rosbag::Bag bag_;
  BagTopics topics_;
};

/// A bag to write, which has its name when it is complete (see PartialFile). Throws std::runtime_error that names it
/// when it cannot be written.
class OutputBag {
 public:
  explicit OutputBag(const std::string& path);

  rosbag::Bag& bag() { return bag_; }
  /// Everything is written. Throws rosbag::BagException and std::filesystem::filesystem_error.
  void finish();

 private:
  PartialFile file_;  // outlives the bag, which writes when it is closed
  rosbag::Bag bag_;
};

/// Reads a configuration; keys of it that are not known are written to stderr. Throws OptionError as load_config()
/// does.
/// @param tool  its name, which begins each line
Config read_config(const std::string& tool, const std::string& path);

}  // namespace gyro_deblur
