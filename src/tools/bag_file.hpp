// Bags as the tools open them.
#pragma once

#include <string>

#include <ros/message_traits.h>
#include <rosbag/bag.h>

#include "tools/bag_topics.hpp"
#include "tools/output_file.hpp"

namespace gyro_deblur {

/// A bag to read. Throws std::runtime_error that names it and the remedy when it cannot be opened: cut or without an
/// index, of ROS 2, no bag at all.
class InputBag {
 public:
  explicit InputBag(const std::string& path);

  const std::string& path() const { return path_; }
  const rosbag::Bag& bag() const { return bag_; }
  const BagTopics& topics() const { return topics_; }

  /// gyro_deblur::choose_topic for messages of the type, as they are defined here. Throws as require_definition, too.
  template <typename Message>
  std::string choose_topic(const std::string& kind, const std::string& named, const std::string& preferred,
                           bool required) const {
    const std::string topic =
        gyro_deblur::choose_topic(topics_, kind, ros::message_traits::datatype<Message>(), named, preferred, required);
    if (!topic.empty()) require_definition<Message>(bag_, topic);
    return topic;
  }

 private:
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

}  // namespace gyro_deblur
