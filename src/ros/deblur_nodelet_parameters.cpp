// The nodelet's parameters: as they are at the start, and as they change by dynamic_reconfigure.
#include "ros/deblur_nodelet.hpp"

#include <cstdint>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include "config/config_table.hpp"
#include "gyro_deblur/config.hpp"
#include "ros/param_conversion.hpp"

namespace gyro_deblur {
namespace {

/// Sets the entry of that name.
template <typename Entries, typename T>
void set_entry(const char* name, const T& value, Entries* entries) {
  for (auto& entry : *entries) {
    if (entry.name == name) entry.value = value;
  }
}

/// What dynamic_reconfigure shows of a configuration.
DeblurConfig dynamic_of(const Config& config) {
  dynamic_reconfigure::Config entries;
  DeblurConfig::__getDefault__().__toMessage__(entries);
  for_each_parameter(config, [&entries](const Row& row, const auto& value) {
    using T = std::decay_t<decltype(value)>;
    if constexpr (std::is_same_v<T, bool>) set_entry(row.key, value, &entries.bools);
    if constexpr (std::is_same_v<T, int>) set_entry(row.key, value, &entries.ints);
    if constexpr (std::is_same_v<T, double>) set_entry(row.key, value, &entries.doubles);
    if constexpr (std::is_same_v<T, std::string>) set_entry(row.key, value, &entries.strs);
    if constexpr (HasNames<T>::value) set_entry(row.key, name_of(value), &entries.strs);
  });
  DeblurConfig dynamic = DeblurConfig::__getDefault__();
  dynamic.__fromMessage__(entries);
  return dynamic;
}

}  // namespace

std::optional<Config> DeblurNodelet::load_parameters(std::string* error) {
  XmlRpc::XmlRpcValue parameters;
  if (getPrivateNodeHandle().getParam("", parameters) && parameters.getType() == XmlRpc::XmlRpcValue::TypeStruct) {
    for (auto& [key, value] : parameters) {
      if (key != "image_transport") given_parameters_[key] = value;  // the others are keys of the configuration
    }
  }

  std::vector<std::string> unknown;
  std::optional<Config> config;
  try {
    config = parse_config(to_yaml(given_parameters_), &unknown);
    if (config->given.time_offset) {
      NODELET_INFO("time_offset = %.6f s: t_imu = t_cam + time_offset (from Kalibr: see doc/guides/calibration.md)",
                   to_seconds(config->gyro.time_offset_ns));
    }
    if (config->calibration) NODELET_INFO_STREAM("calibration from " << config->calibration->origin);
  } catch (const std::exception& refused) {
    *error = refused.what();
    config.reset();
  }
  for (const std::string& key : unknown) {
    // Namespaces below the node belong to others, to plugins of image_transport for example.
    if (given_parameters_[key].getType() != XmlRpc::XmlRpcValue::TypeStruct) {
      NODELET_WARN_STREAM('~' << unknown_key_message(key));
    }
  }
  return config;
}

void DeblurNodelet::start_reconfigure() {
  const boost::recursive_mutex::scoped_lock lock(reconfigure_mutex_);
  reconfigure_ =
      std::make_unique<dynamic_reconfigure::Server<DeblurConfig>>(reconfigure_mutex_, getPrivateNodeHandle());
  // The server has read the parameters, but moved what was out of range to the nearest end without a word. That would
  // be nobody's choice: it offers the default instead, and the error that load_parameters has reported stays in force.
  Config offered;
  std::vector<std::string> refused;
  for (auto& [key, value] : given_parameters_) {
    Config with_key = offered;
    try {
      set_parameter(key, to_yaml(value), &with_key);
      offered = with_key;
    } catch (const std::exception&) {
      refused.push_back(key);
    }
  }
  dynamic_ = dynamic_of(offered);
  reconfigure_->updateConfig(dynamic_);
  reconfigure_->setCallback([this](DeblurConfig& dynamic, std::uint32_t) { on_reconfigure(dynamic); });
  // The server has also written its values back. What was refused stays on the parameter server, so that it is refused
  // again when the nodelet is loaded again, instead of being replaced by a default that nobody chose.
  for (const std::string& key : refused) getPrivateNodeHandle().setParam(key, given_parameters_[key]);
  reconfigure_ready_ = true;
}

void DeblurNodelet::on_reconfigure(DeblurConfig& dynamic) {
  if (!reconfigure_ready_) return;  // the server's first call only repeats what load_parameters has applied
  try {
    XmlRpc::XmlRpcValue merged = given_parameters_;
    dynamic_reconfigure::Config entries;
    dynamic.__toMessage__(entries);
    for (const auto& entry : entries.bools) merged[entry.name] = entry.value != 0;
    for (const auto& entry : entries.ints) merged[entry.name] = entry.value;
    for (const auto& entry : entries.doubles) merged[entry.name] = entry.value;
    for (const auto& entry : entries.strs) merged[entry.name] = XmlRpc::XmlRpcValue(entry.value);
    const Config config = parse_config(to_yaml(merged));
    processor_->set_config(config);
    if (!configured_) {
      // What is decided once was decided without a configuration.
      imu_->source()->set_options(GyroSource::options_of(config));
      subscribe_exposure(config.exposure_source);
    }
    configured_ = true;
    dynamic_ = dynamic;
    NODELET_INFO_THROTTLE(1.0, "parameters changed");
  } catch (const std::exception& error) {
    NODELET_ERROR_STREAM("parameters not changed: " << error.what());
    dynamic = dynamic_;
  }
}

}  // namespace gyro_deblur
