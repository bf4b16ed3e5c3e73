// Which topics of a bag a tool works on.
#pragma once

#include <map>
#include <stdexcept>
#include <string>

#include <ros/message_traits.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>

namespace gyro_deblur {

/// "/camera" of "/camera/image_raw".
std::string parent_namespace(const std::string& topic);

/// Topics of a bag by name, with their type.
using BagTopics = std::map<std::string, std::string>;
BagTopics topics_of(const rosbag::Bag& bag);
/// "NAME (TYPE), ...", or "no topics".
std::string list_of(const BagTopics& topics);

/// The topic to use for one kind of message: the one named, else the only one of its type.
/// @param kind  such as "camera_info", which the option --camera-info-topic names
/// @param preferred  taken, when nothing is named, if the bag has it; may be empty
/// @return empty when there is none and none is required
/// Throws std::runtime_error that lists the candidates when there are several, else the bag's topics.
std::string choose_topic(const BagTopics& topics, const std::string& kind, const std::string& type,
                         const std::string& named, const std::string& preferred, bool required);

/// Throws std::runtime_error when the bag's messages of a topic have the type's name, but the definition of another
/// version.
template <typename Message>
void require_definition(const rosbag::Bag& bag, const std::string& topic) {
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  const std::string expected = ros::message_traits::md5sum<Message>();
  for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
    if (connection->md5sum != expected) {
      throw std::runtime_error("topic " + topic + " has another version of " + connection->datatype + " (md5 " +
                               connection->md5sum + ", here " + expected + "): convert the bag with rosbag fix");
    }
  }
}

}  // namespace gyro_deblur
