// Lists the topics of a bag and chooses one.
#include "tools/bag_topics.hpp"

#include <algorithm>
#include <vector>

namespace gyro_deblur {

std::string list_of(const BagTopics& topics) {
  std::string list;
  for (const auto& [name, type] : topics) list += (list.empty() ? "" : ", ") + name + " (" + type + ")";
  return list.empty() ? "no topics" : list;
}

std::string parent_namespace(const std::string& topic) { return topic.substr(0, topic.rfind('/')); }

BagTopics topics_of(const rosbag::Bag& bag) {
  rosbag::View view(bag);
  BagTopics topics;
  for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
    topics[connection->topic] = connection->datatype;
  }
  return topics;
}

namespace {

/// "camera_info" is named by --camera-info-topic.
std::string option_of(const std::string& kind) {
  std::string option = kind + "-topic";
  std::replace(option.begin(), option.end(), '_', '-');
  return option;
}

}  // namespace

std::string choose_topic(const BagTopics& topics, const std::string& kind, const std::string& type,
                         const std::string& named, const std::string& preferred, bool required) {
  const auto fail = [&](const std::string& problem) -> std::string {
    throw std::runtime_error(problem + "; the bag has " + list_of(topics));
  };
  if (!named.empty()) {
    const auto found = topics.find(named);
    if (found == topics.end()) return fail("no topic " + named + " for " + kind);
    if (found->second != type) {
      return fail("topic " + named + " for " + kind + " is of type " + found->second + ", not of type " + type);
    }
    return named;
  }
  const auto sibling = topics.find(preferred);
  if (sibling != topics.end() && sibling->second == type) return preferred;
  std::vector<std::string> candidates;
  for (const auto& [name, topic_type] : topics) {
    if (topic_type == type) candidates.push_back(name);
  }
  if (candidates.size() == 1) return candidates.front();
  if (candidates.empty()) return required ? fail("no topic of type " + type + " for " + kind) : std::string();
  std::string list;
  for (const std::string& name : candidates) list += (list.empty() ? "" : ", ") + name;
  throw std::runtime_error("several topics of type " + type + ", name the one for " + kind + " with --" +
                           option_of(kind) + ": " + list);
}

}  // namespace gyro_deblur
