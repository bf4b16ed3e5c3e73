// Reads values from a map of a YAML file.
#include "config/yaml_section.hpp"

#include <set>
#include <utility>

#include <Eigen/LU>

#include "base/join.hpp"
#include "config/yaml_reading.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

struct Section::KeyLog {
  std::set<std::string> asked;  ///< with prefix
  std::vector<std::pair<std::string, YAML::Node>> maps;
};

Section::Section(std::string path, std::string prefix, YAML::Node node, std::shared_ptr<KeyLog> log)
    : path_(std::move(path)), prefix_(std::move(prefix)), node_(std::move(node)), log_(std::move(log)) {
  log_->maps.emplace_back(prefix_, node_);
}

Section::Section(std::string path, YAML::Node node)
    : Section(std::move(path), "", std::move(node), std::make_shared<KeyLog>()) {}

Section Section::load(const std::string& path) { return {path, load_yaml_file(path)}; }

bool Section::has(const std::string& key) const {
  ignore(key);
  return node_.IsMap() && node_[key];
}

YAML::Node Section::get(const std::string& key) const {
  if (!has(key)) throw OptionError(name(key) + " is missing: this kind of file has to have it");
  return node_[key];
}

Section Section::child(const std::string& key) const {
  const YAML::Node node = get(key);
  if (!node.IsMap()) refuse(name(key), node, "a map of keys");
  return {path_, prefix_ + key + ".", node, log_};
}

Section Section::element(const std::string& key, std::size_t index) const {
  const YAML::Node node = get(key);
  const std::string place = key + "[" + std::to_string(index) + "]";
  if (!node.IsSequence()) refuse(name(key), node, "a list");
  if (index >= node.size()) {
    throw OptionError(name(place) + " is missing; the list has " + std::to_string(node.size()) + " elements");
  }
  if (!node[index].IsMap()) refuse(name(place), node[index], "a map of keys");
  return {path_, prefix_ + place + ".", node[index], log_};
}

std::string Section::text(const std::string& key) const {
  const YAML::Node node = get(key);
  if (!node.IsScalar()) refuse(name(key), node, "a string");
  return node.Scalar();
}

double Section::number(const std::string& key) const { return read_number(name(key), get(key), "a finite number"); }

double Section::number_at(const std::string& path) const {
  const std::size_t dot = path.find('.');
  return dot == std::string::npos ? number(path) : child(path.substr(0, dot)).number_at(path.substr(dot + 1));
}

int Section::integer(const std::string& key) const { return read_integer(name(key), get(key)); }

TimeNs Section::seconds(const std::string& key) const { return read_seconds(name(key), get(key)); }

std::vector<double> Section::numbers(const std::string& key) const {
  const YAML::Node node = get(key);
  const std::string allowed = "a list of finite numbers";
  if (!node.IsSequence()) refuse(name(key), node, allowed);
  std::vector<double> values;
  for (const YAML::Node& element : node) values.push_back(read_number(name(key), element, allowed));
  return values;
}

std::vector<double> Section::numbers(const std::string& key, std::size_t count) const {
  const std::vector<double> values = numbers(key);
  if (values.size() != count) refuse(name(key), get(key), "a list of " + std::to_string(count) + " numbers");
  return values;
}

Eigen::MatrixXd Section::matrix(const std::string& key, int rows, int cols) const {
  const YAML::Node node = get(key);
  const std::string allowed = "a matrix of " + std::to_string(rows) + "x" + std::to_string(cols) + " finite numbers";
  std::vector<double> values;
  if (node.IsMap()) {
    const Section map = child(key);
    map.ignore("dt");  // OpenCV's type of the elements
    if (map.integer("rows") != rows || map.integer("cols") != cols) refuse(name(key), node, allowed);
    values = map.numbers("data");
  } else if (node.IsSequence()) {
    for (const YAML::Node& row : node) {
      if (!row.IsSequence() || row.size() != static_cast<std::size_t>(cols)) refuse(name(key), node, allowed);
      for (const YAML::Node& element : row) values.push_back(read_number(name(key), element, allowed));
    }
  }
  if (values.size() != static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols)) {
    refuse(name(key), node, allowed);
  }
  return Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(values.data(), rows,
                                                                                                  cols);
}

Eigen::Isometry3d Section::transform(const std::string& key) const {
  const Eigen::Matrix4d T = matrix(key, 4, 4);
  constexpr double kRounding = 1e-9;
  if ((T.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > kRounding) {
    refuse(name(key), get(key), "a transform: its last row has to be [0, 0, 0, 1]");
  }
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = require_rotation(name(key).c_str(), T.topLeftCorner<3, 3>());
  result.translation() = T.topRightCorner<3, 1>();
  return result;
}

void Section::ignore(std::initializer_list<const char*> keys) const {
  for (const char* key : keys) ignore(std::string(key));
}

void Section::ignore(const std::string& key) const { log_->asked.insert(prefix_ + key); }

std::vector<std::string> Section::unknown_keys() const {
  std::set<std::string> named;
  std::vector<std::string> unknown;
  for (const auto& [prefix, map] : log_->maps) {
    if (prefix.compare(0, prefix_.size(), prefix_) != 0 || !map.IsMap()) continue;
    for (const auto& entry : map) {
      const std::string key = prefix + (entry.first.IsScalar() ? entry.first.Scalar() : describe(entry.first));
      if (log_->asked.count(key) == 0 && named.insert(key).second) unknown.push_back(key);
    }
  }
  return unknown;
}

void Section::require_known_keys(const std::string& advice) const {
  const std::vector<std::string> unknown = unknown_keys();
  if (!unknown.empty()) throw OptionError(path_ + ": unknown keys: " + join(unknown) + "; " + advice);
}

}  // namespace gyro_deblur
