// Opens bags, and says why one cannot be opened.
#include "tools/bag_file.hpp"

#include <array>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string_view>

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

}  // namespace

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
  topics_ = topics_of(bag_);
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

}  // namespace gyro_deblur
