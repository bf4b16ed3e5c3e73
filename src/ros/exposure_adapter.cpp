// Reads exposure times from the messages of drivers.
#include "ros/exposure_adapter.hpp"

#include <cmath>
#include <stdexcept>

#include <dynamic_reconfigure/Config.h>
#include <ros/message_traits.h>
#include <nlohmann/json.hpp>

#include "base/join.hpp"
#include "ros/deserialization.hpp"
#include "ros/messages.hpp"
#include "ros/processor.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

/// The stamp that belongs to a field: the header's, or the one next to the field. A stamp of 0 was never set.
std::optional<TimeNs> stamp_of(const MessageLayout& layout, const std::string& field, const std::uint8_t* bytes,
                               std::size_t size) {
  const std::size_t dot = field.rfind('.');
  const std::string next_to_field = (dot == std::string::npos ? "" : field.substr(0, dot + 1)) + "stamp";
  for (const std::string& path : {std::string("header.stamp"), next_to_field}) {
    const std::optional<FieldValue> value = layout.find(path, bytes, size);
    if (value && std::holds_alternative<FieldTime>(*value) && std::get<FieldTime>(*value).ns != 0) {
      return std::get<FieldTime>(*value).ns;
    }
  }
  return std::nullopt;
}

ExposureReading reading_of(const std::string& field, double value_s, const std::optional<TimeNs>& stamp_ns) {
  constexpr double kLongestS = 1e6;  // what to_ns can hold; the exposure's own range is checked where it is used
  if (!(std::abs(value_s) < kLongestS)) {
    throw std::runtime_error("exposure: " + field + " = " + std::to_string(value_s) + " s is not an exposure time");
  }
  return {to_ns(value_s), stamp_ns};
}

}  // namespace

const MessageLayout& ExposureAdapter::layout_of(const std::string& type, const std::string& definition) {
  auto found = layouts_.find(type);
  if (found == layouts_.end()) found = layouts_.emplace(type, MessageLayout(type, definition)).first;
  return found->second;
}

double ExposureAdapter::seconds(double value) const {
  static constexpr double kUnitsS[] = {1, 1e-3, 1e-4, 1e-5, 1e-6};  // in the order of ExposureUnit
  return value * kUnitsS[static_cast<std::size_t>(source_.unit)];
}

std::optional<ExposureReading> ExposureAdapter::read(const std::string& type, const std::string& definition,
                                                     const std::uint8_t* bytes, std::size_t size) {
  if (source_.kind == ExposureSource::Kind::AUTO && type != kRealsenseMetadata) {
    throw std::runtime_error("exposure: exposure_source = auto recognises " +
                             std::string(ros::message_traits::datatype<Exposure>()) + " and " + kRealsenseMetadata +
                             ", the topic is of type " + type + ": say by exposure_source what its messages have");
  }
  if (source_.kind == ExposureSource::Kind::AUTO || source_.kind == ExposureSource::Kind::REALSENSE_METADATA) {
    return read_metadata(type, definition, bytes, size);
  }
  double value_s = 0;
  std::optional<TimeNs> stamp_ns;
  const std::string& field = source_.field;
  if (source_.kind == ExposureSource::Kind::DYNAMIC_RECONFIGURE) {
    using Setting = dynamic_reconfigure::Config;
    if (type != ros::message_traits::datatype<Setting>()) {
      throw std::runtime_error("exposure: the topic is of type " + type + ", not dynamic_reconfigure/Config");
    }
    Setting config;
    deserialize_checked(bytes, size, &config);
    std::optional<double> value;
    std::vector<std::string> names;
    const auto look_through = [&](const auto& parameters) {
      for (const auto& parameter : parameters) {
        names.push_back(parameter.name);
        if (parameter.name == field) value = parameter.value;
      }
    };
    look_through(config.doubles);
    look_through(config.ints);
    if (!value) {
      throw std::runtime_error("exposure: no number of the parameters is called exposure_field = \"" + field +
                               "\"; there are " + join(names));
    }
    value_s = seconds(*value);
  } else {
    const MessageLayout& layout = layout_of(type, definition);
    const std::optional<FieldValue> value = layout.find(field, bytes, size);
    if (!value || std::holds_alternative<std::string>(*value)) {
      throw std::runtime_error("exposure: " + type + " has no number exposure_field = \"" + field + "\"; it has " +
                               join(layout.paths()));
    }
    value_s = std::holds_alternative<FieldTime>(*value) ? to_seconds(std::get<FieldTime>(*value).ns)
                                                        : seconds(std::get<double>(*value));
    stamp_ns = stamp_of(layout, field, bytes, size);
  }
  return reading_of(field, value_s, stamp_ns);
}

std::optional<ExposureReading> ExposureAdapter::read_metadata(const std::string& type, const std::string& definition,
                                                              const std::uint8_t* bytes, std::size_t size) {
  const std::string field = source_.field.empty() ? "actual_exposure" : source_.field;
  const MessageLayout& layout = layout_of(type, definition);
  const std::optional<FieldValue> text = layout.find("json_data", bytes, size);
  if (!text || !std::holds_alternative<std::string>(*text)) {
    throw std::runtime_error("exposure: " + type + " has no string json_data; it has " + join(layout.paths()));
  }
  const nlohmann::json json = nlohmann::json::parse(std::get<std::string>(*text), nullptr, false);
  if (!json.is_object() || !json.contains(field) || !json[field].is_number()) {
    throw std::runtime_error("exposure: the metadata have no number \"" + field +
                             "\": " + std::get<std::string>(*text).substr(0, 200));
  }
  const double value = json[field].get<double>();
  const std::optional<TimeNs> stamp_ns = stamp_of(layout, "json_data", bytes, size);
  if (source_.kind != ExposureSource::Kind::AUTO) return reading_of(field, seconds(value), stamp_ns);
  // Colour streams alone have a saturation (librealsense, ds-color-common.cpp).
  if (!json.contains("saturation")) return reading_of(field, value * 1e-6, stamp_ns);
  const auto by_itself = json.find("auto_exposure");
  if (by_itself != json.end() && by_itself->is_number() && by_itself->get<double>() != 0) return std::nullopt;
  return reading_of(field, value * 1e-4, stamp_ns);
}

void ExposureAdapter::pass_on(const std::string& type, const std::string& definition,
                              const std::vector<std::uint8_t>& bytes, Processor* processor) {
  constexpr char kKind[] = "exposure source";
  std::optional<ExposureReading> reading;
  try {
    if (source_.kind == ExposureSource::Kind::AUTO && type == ros::message_traits::datatype<Exposure>()) {
      Exposure exposure;  // it may also bring a readout time
      deserialize_checked(bytes.data(), bytes.size(), &exposure);
      processor->record_unreadable(kKind, "");
      processor->add_exposure(exposure);
      return;
    }
    reading = read(type, definition, bytes.data(), bytes.size());
  } catch (const std::runtime_error& error) {
    processor->record_unreadable(kKind, error.what());
    return;
  }
  processor->record_unreadable(kKind, "");
  if (!reading) return;
  if (!reading->stamp_ns) {
    processor->add_exposure_setting(reading->exposure_ns);
    return;
  }
  Exposure exposure;
  exposure.header.stamp = to_ros_time(*reading->stamp_ns);
  exposure.exposure_time.fromNSec(reading->exposure_ns);
  processor->add_exposure(exposure);
}

}  // namespace gyro_deblur
