// Reading the maps of a calibration file, of a recording's description or of a scene, with errors that name file and
// key, and the keys that nobody asked for.
#pragma once

#include <initializer_list>
#include <memory>
#include <string>
#include <vector>

#include <yaml-cpp/yaml.h>
#include <Eigen/Core>
#include <Eigen/Geometry>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// A map of such a file. All functions that return a value throw OptionError that begins with file and key when
/// the key is missing or has the wrong form.
class Section {
 public:
  /// The whole file, of which `node` is the outermost map.
  /// @param path  for messages
  Section(std::string path, YAML::Node node);
  /// The whole file. Throws OptionError with the path when it cannot be read.
  static Section load(const std::string& path);

  const std::string& path() const { return path_; }
  const YAML::Node& node() const { return node_; }
  /// "PATH: cam0.KEY", for messages.
  std::string name(const std::string& key) const { return path_ + ": " + prefix_ + key; }

  bool has(const std::string& key) const;
  YAML::Node get(const std::string& key) const;
  Section child(const std::string& key) const;
  /// An element of a list of maps.
  Section element(const std::string& key, std::size_t index) const;
  std::string text(const std::string& key) const;
  double number(const std::string& key) const;
  /// @param path  keys of nested maps: "a.b"
  double number_at(const std::string& path) const;
  int integer(const std::string& key) const;
  TimeNs seconds(const std::string& key) const;
  std::vector<double> numbers(const std::string& key) const;
  std::vector<double> numbers(const std::string& key, std::size_t count) const;
  /// A list of rows, or OpenCV's map of rows, cols and data.
  Eigen::MatrixXd matrix(const std::string& key, int rows, int cols) const;
  /// A rigid transform as 4x4 numbers.
  Eigen::Isometry3d transform(const std::string& key) const;

  /// Keys that are allowed and not used.
  void ignore(std::initializer_list<const char*> keys) const;
  void ignore(const std::string& key) const;
  /// Keys of this map and of its maps that were read, which nobody has asked for.
  std::vector<std::string> unknown_keys() const;
  /// Throws OptionError if there are any: a misspelled key would be ignored.
  /// @param advice  end of the message: where all keys are
  void require_known_keys(const std::string& advice) const;

 private:
  struct KeyLog;

  Section(std::string path, std::string prefix, YAML::Node node, std::shared_ptr<KeyLog> log);

  std::string path_, prefix_;  // the latter ends with a dot, or is empty
  YAML::Node node_;
  std::shared_ptr<KeyLog> log_;  // of all sections of a file
};

}  // namespace gyro_deblur
