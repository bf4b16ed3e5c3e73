// Values in text, as YAML writes them.
#pragma once

#include <optional>
#include <string>

namespace gyro_deblur {

/// The number that all of the text is: 0.02, 2e-2, .inf. Absent for other text.
std::optional<double> to_number(const std::string& text);

/// true, yes, on, y or false, no, off, n in YAML's spellings. Absent for other text.
std::optional<bool> to_truth_value(const std::string& text);

}  // namespace gyro_deblur
