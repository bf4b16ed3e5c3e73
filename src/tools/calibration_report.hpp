// Reports of calibrate: text, JSON and YAML.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "gyro_deblur/config.hpp"
#include "tools/calibration_verdicts.hpp"
#include "tools/footage_calibration.hpp"
#include "tools/timing_footage.hpp"

namespace gyro_deblur {

/// Summary on stdout.
void print_summary(const FootageCalibration& found, const std::vector<Verdict>& verdicts);

/// Report for plot_calibration.py; without timing if none was found.
nlohmann::json report_of(const FootageCalibration& found, const std::vector<Verdict>& verdicts, const std::string& bag,
                         const FootageTopics& topics);

/// YAML that the launch files and deblur_bag read: what was estimated, and what else the configuration has. Values that
/// the footage does not determine are left out.
/// Precondition: there is timing.
/// @param everything   leaves none out
/// @param config_path  the file that `config` was read from, empty: none
std::string configuration_of(const FootageCalibration& found, const std::vector<Verdict>& verdicts,
                             const std::string& bag, bool everything, const std::string& config_path);

}  // namespace gyro_deblur
