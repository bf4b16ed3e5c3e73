#include "tools/bag_file.hpp"

#include <filesystem>
#include <stdexcept>

namespace gyro_deblur {

InputBag::InputBag(const std::string& path) : path_(path) {
  if (!std::filesystem::is_regular_file(path)) throw std::runtime_error(path + ": no such file");
  try {
    bag_.open(path, rosbag::bagmode::Read);
  } catch (const rosbag::BagException& error) {
    throw std::runtime_error(path + ": not a bag that can be read: " + error.what());
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
