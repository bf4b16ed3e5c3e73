// The nodelet's parameters: as they are at the start, and as they change by dynamic_reconfigure.
#include "ros/deblur_nodelet.hpp"

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "gyro_deblur/config.hpp"
#include "ros/param_conversion.hpp"

namespace gyro_deblur {
namespace {

/// Private parameters that are not keys of the configuration.
const char* const kOtherParameters[] = {"image_transport"};

/// Names and values of the parameters that may change while running.
dynamic_reconfigure::Config entries_of(const DeblurConfig& config) {
  dynamic_reconfigure::Config entries;
  config.__toMessage__(entries);
  return entries;
}

}  // namespace

std::optional<Config> DeblurNodelet::load_parameters(std::string* error) {
  XmlRpc::XmlRpcValue parameters;
  if (getPrivateNodeHandle().getParam("", parameters) && parameters.getType() == XmlRpc::XmlRpcValue::TypeStruct) {
    for (auto& [key, value] : parameters) {
      if (std::find(std::begin(kOtherParameters), std::end(kOtherParameters), key) == std::end(kOtherParameters)) {
        given_parameters_[key] = value;
      }
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
  const dynamic_reconfigure::Config standard = entries_of(DeblurConfig::__getDefault__());
  dynamic_reconfigure::Config offered = standard;
  for_each_entry([this](auto& entry) { read_parameter(given_parameters_, entry.name, entry.value); }, offered);
  dynamic_.__fromMessage__(offered);
  DeblurConfig clamped = dynamic_;
  clamped.__clamp__();
  const dynamic_reconfigure::Config in_range = entries_of(clamped);
  for_each_entry(
      [](auto& entry, const auto& nearest, const auto& otherwise) {
        if (entry.value != nearest.value) entry.value = otherwise.value;
      },
      offered, in_range, standard);
  dynamic_.__fromMessage__(offered);
  reconfigure_->updateConfig(dynamic_);
  reconfigure_->setCallback([this](DeblurConfig& dynamic, std::uint32_t) { on_reconfigure(dynamic); });
  // The server has also written its values back. What was refused stays on the parameter server, so that it is refused
  // again when the nodelet is loaded again, instead of being replaced by a default that nobody chose.
  for_each_entry(
      [this](const auto& entry) {
        auto given = entry.value;
        if (!given_parameters_.hasMember(entry.name)) return;
        if (read_parameter(given_parameters_, entry.name, given) && given == entry.value) return;
        getPrivateNodeHandle().setParam(entry.name, given_parameters_[entry.name]);
      },
      offered);
  reconfigure_ready_ = true;
}

void DeblurNodelet::on_reconfigure(DeblurConfig& dynamic) {
  if (!reconfigure_ready_) return;  // the server's first call only repeats what load_parameters has applied
  try {
    XmlRpc::XmlRpcValue merged = given_parameters_;
    const dynamic_reconfigure::Config entries = entries_of(dynamic);
    for_each_entry([&merged](const auto& entry) { write_parameter(merged, entry.name, entry.value); }, entries);
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
