// Stores the estimated calibration in a file and loads it.
#include "calibrate/stored_calibration.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

using MatrixByRows = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

std::vector<double> numbers(double value) { return {value}; }
std::vector<double> numbers(const Eigen::Vector3d& value) { return {value.x(), value.y(), value.z()}; }
std::vector<double> numbers(const Eigen::Matrix3d& value) {
  const MatrixByRows by_rows = value;
  return {by_rows.data(), by_rows.data() + by_rows.size()};
}

template <typename Value>
void write(const char* key, const Learned<Value>& learned, nlohmann::json* json) {
  if (!learned.known) return;
  (*json)[key] = {{"value", numbers(learned.value)}, {"stddev", learned.stddev}, {"seconds", learned.seconds}};
}

/// @param largest  of the absolute values
/// Throws std::exception.
template <typename Value>
void read(const nlohmann::json& json, const char* key, double largest, Learned<Value>* learned) {
  if (!json.contains(key)) return;
  const nlohmann::json& entry = json.at(key);
  const auto values = entry.at("value").get<std::vector<double>>();
  const auto is_sane = [largest](double value) { return std::isfinite(value) && std::abs(value) <= largest; };
  const auto stddev = entry.at("stddev").get<double>();
  if (values.size() != numbers(learned->value).size() || !std::all_of(values.begin(), values.end(), is_sane) ||
      !(stddev > 0)) {
    throw std::runtime_error(std::string(key) + " has values that it cannot have");
  }
  if constexpr (std::is_same_v<Value, double>) {
    learned->value = values.front();
  } else if constexpr (std::is_same_v<Value, Eigen::Vector3d>) {
    learned->value = Eigen::Map<const Eigen::Vector3d>(values.data());
  } else {
    learned->value = require_rotation(key, Eigen::Map<const MatrixByRows>(values.data()));
  }
  learned->stddev = stddev;
  learned->seconds = entry.at("seconds").get<double>();
  learned->known = true;
  learned->missing.clear();
}

}  // namespace

std::string stored_calibration_path(const std::string& node_name, int width_px, int height_px) {
  fs::path folder;
  if (const char* ros_home = std::getenv("ROS_HOME")) {
    folder = ros_home;
  } else if (const char* home = std::getenv("HOME")) {
    folder = fs::path(home) / ".ros";
  } else {
    return {};
  }
  std::string name = node_name.substr(std::min(node_name.find_first_not_of('/'), node_name.size()));
  // A name has no dot, so that two nodes have two files.
  std::replace(name.begin(), name.end(), '/', '.');
  return (folder / "gyro_deblur" / (name + "." + std::to_string(width_px) + "x" + std::to_string(height_px) + ".json"))
      .string();
}

std::optional<LearnedCalibration> load_stored_calibration(const std::string& path) {
  if (!fs::exists(path)) return std::nullopt;
  try {
    std::ifstream file(path);
    const nlohmann::json json = nlohmann::json::parse(file);
    if (!json.is_object()) throw std::runtime_error("it is no map of values");
    LearnedCalibration calibration;
    constexpr double kMostOffsetS = 4e9, kMostReadoutS = 1, kMostBiasRadS = 1;
    read(json, "R_cam_imu", 1.001, &calibration.R_cam_imu);
    read(json, "time_offset", kMostOffsetS, &calibration.time_offset_s);
    read(json, "readout_time", kMostReadoutS, &calibration.readout_s);
    read(json, "gyro_bias", kMostBiasRadS, &calibration.bias_rad_s);
    read(json, "focal_length", kLongestFocalLength, &calibration.focal_length);
    if (calibration.focal_length.known) {
      if (calibration.focal_length.value < kShortestFocalLength) throw std::runtime_error("focal_length is too short");
      calibration.focal_image_px = json.at("focal_image_px").get<int>();
    }
    return calibration;
  } catch (const std::exception& error) {
    throw std::runtime_error("stored calibration " + path + " cannot be used: " + error.what());
  }
}

void save_stored_calibration(const std::string& path, const LearnedCalibration& calibration) {
  try {
    nlohmann::json json;
    write("R_cam_imu", calibration.R_cam_imu, &json);
    write("time_offset", calibration.time_offset_s, &json);
    write("readout_time", calibration.readout_s, &json);
    write("gyro_bias", calibration.bias_rad_s, &json);
    write("focal_length", calibration.focal_length, &json);
    if (calibration.focal_length.known) json["focal_image_px"] = calibration.focal_image_px;
    fs::create_directories(fs::path(path).parent_path());
    const std::string written = path + ".new";
    {
      std::ofstream file(written);
      file << json.dump(2) << "\n";
      if (!file.flush()) throw std::runtime_error("it cannot be written");
    }
    fs::rename(written, path);
  } catch (const std::exception& error) {
    throw std::runtime_error("calibration is not stored in " + path + ": " + error.what());
  }
}

void remove_stored_calibration(const std::string& path) {
  try {
    fs::remove(path);
  } catch (const std::exception& error) {
    throw std::runtime_error("stored calibration " + path + " cannot be removed: " + error.what());
  }
}

}  // namespace gyro_deblur
