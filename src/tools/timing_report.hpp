// What calibrate_timing says and writes.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/config.hpp"
#include "tools/timing_footage.hpp"

namespace gyro_deblur {

/// An estimate, and what it takes to say what it is an estimate of.
struct TimingResult {
  std::string bag;
  TimingEstimate estimate;
  Estimate sensor_readout_s;  ///< of the whole sensor; the estimate's is that of the image's region of interest
  std::string rotation_from;  ///< "estimated", "as configured" or "tf"
};

/// For people, on stdout.
void print_summary(const TimingResult& result);

/// For plot_timing.py.
nlohmann::json report_of(const TimingResult& result, const FootageTopics& topics);

/// YAML that the launch files and deblur_bag read: what was estimated, and what else the configuration has.
/// @param config_path  the file that `config` was read from, empty: none
std::string configuration_of(const TimingResult& result, const Config& config, const std::string& config_path);

}  // namespace gyro_deblur
