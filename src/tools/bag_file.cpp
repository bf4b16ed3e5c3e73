// Opens bags, says why one cannot be opened, and chooses topics.
#include "tools/bag_file.hpp"

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string_view>
#include <vector>

#include <rosbag/view.h>

#include "base/join.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;
using std::literals::operator""sv;

std::string ros2_text(const std::string& path, const fs::path& name) {
  return "is a ROS 2 bag: convert it with rosbags-convert (pip install rosbags): rosbags-convert --src " + path +
         " --dst " + name.string() + ".bag";
}

/// Why `path` cannot be a bag of ROS 1, and what to do; empty where it looks like one.
std::string problem_of(const std::string& path) {
  const fs::path file(path);
  if (fs::is_directory(file)) {
    const fs::path name = file.has_filename() ? file : file.parent_path();
    return fs::is_regular_file(file / "metadata.yaml") ? ros2_text(path, name)
                                                       : "is a folder, not a bag: give a .bag file";
  }
  if (!fs::is_regular_file(file)) return "no such file";
  std::array<char, 16> bytes{};
  std::ifstream(file, std::ios::binary).read(bytes.data(), bytes.size());
  const std::string_view begin(bytes.data(), bytes.size());
  const auto begins_with = [begin](std::string_view magic) { return begin.substr(0, magic.size()) == magic; };
  // The storages of rosbag2: sqlite3 and mcap.
  if (begins_with("SQLite format 3"sv) || begins_with("\x89MCAP0\r\n"sv)) {
    return ros2_text(path, fs::path(file).replace_extension());
  }
  return begins_with("#ROSBAG V"sv) ? "" : "is not a bag: it does not begin with #ROSBAG V";
}

/// "camera_info" is named by --camera-info-topic.
std::string option_of(const std::string& kind) {
  std::string option = kind + "-topic";
  std::replace(option.begin(), option.end(), '_', '-');
  return option;
}

}  // namespace

std::string parent_namespace(const std::string& topic) { return topic.substr(0, topic.rfind('/')); }

std::string list_of(const BagTopics& topics) {
  std::string list;
  for (const auto& [name, type] : topics) list += (list.empty() ? "" : ", ") + name + " (" + type + ")";
  return list.empty() ? "no topics" : list;
}

InputBag::InputBag(const std::string& path) : path_(path) {
  if (const std::string problem = problem_of(path); !problem.empty()) throw std::runtime_error(path + ": " + problem);
  try {
    bag_.open(path, rosbag::bagmode::Read);
  } catch (const rosbag::BagUnindexedException&) {
    throw std::runtime_error(path + ": has no index, as of a recording that did not end well: run rosbag reindex " +
                             path);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(path + ": is damaged or cut (" + error.what() + "): run rosbag reindex " + path);
  }
  rosbag::View view(bag_);
  for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
    topics_[connection->topic] = connection->datatype;
  }
}

std::string InputBag::type_of(const std::string& topic) const {
  const auto found = topics_.find(topic);
  return found == topics_.end() ? std::string() : found->second;
}

std::string InputBag::choose_topic(const std::string& kind, const std::string& type, const std::string& named,
                                   const std::string& preferred, bool required) const {
  const auto fail = [&](const std::string& problem) -> std::string {
    throw std::runtime_error(problem + "; the bag has " + list_of(topics_));
  };
  if (!named.empty()) {
    const auto found = topics_.find(named);
    if (found == topics_.end()) return fail("no topic " + named + " for " + kind);
    if (found->second != type) {
      return fail("topic " + named + " for " + kind + " is of type " + found->second + ", not of type " + type);
    }
    return named;
  }
  if (type_of(preferred) == type) return preferred;
  std::vector<std::string> candidates;
  for (const auto& [name, topic_type] : topics_) {
    if (topic_type == type) candidates.push_back(name);
  }
  if (candidates.size() == 1) return candidates.front();
  if (candidates.empty()) return required ? fail("no topic of type " + type + " for " + kind) : std::string();
  throw std::runtime_error("several topics of type " + type + ", name the one for " + kind + " with --" +
                           option_of(kind) + ": " + join(candidates));
}

void InputBag::require_definition(const std::string& topic, const std::string& md5sum) const {
  rosbag::View view(bag_, rosbag::TopicQuery(topic));
  for (const rosbag::ConnectionInfo* connection : view.getConnections()) {
    if (connection->md5sum == md5sum) continue;
    throw std::runtime_error("topic " + topic + " has another version of " + connection->datatype + " (md5 " +
                             connection->md5sum + ", here " + md5sum + "): convert the bag with rosbag fix");
  }
}

OutputBag::OutputBag(const std::string& path) : file_(path) {
  try {
    bag_.open(file_.path(), rosbag::bagmode::Write);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(path + ": cannot be written: " + error.what());
  }
}

void OutputBag::finish() {
  bag_.close();
  file_.finish();
}

Config read_config(const std::string& tool, const std::string& path) {
  std::vector<std::string> unknown;
  Config config = load_config(path, &unknown);
  for (const std::string& key : unknown) {
    if (key == "image_transport") continue;  // of the nodelet; a bag's messages say by their type how to read them
    std::cerr << tool << ": " << path << ": " << unknown_key_message(key) << '\n';
  }
  return config;
}

}  // namespace gyro_deblur
