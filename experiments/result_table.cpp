#include "result_table.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "tools/output_file.hpp"

namespace gyro_deblur::experiments {
namespace {

std::string joined(const std::vector<std::string>& cells, const char* separator) {
  std::string line;
  for (const std::string& cell : cells) line += (&cell == &cells.front() ? "" : separator) + cell;
  return line;
}

}  // namespace

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto last = static_cast<double>(values.size() - 1);
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(std::ceil(share * last));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

std::string text_of(double value, int digits) {
  if (std::isnan(value)) return "-";
  char text[400];
  std::snprintf(text, sizeof(text), "%.*f", digits, value);
  return text;
}

std::string ResultTable::markdown() const {
  const std::vector<std::string> rule(header_.size(), "---");
  std::string text = "| " + joined(header_, " | ") + " |\n| " + joined(rule, " | ") + " |\n";
  for (const auto& row : rows_) text += "| " + joined(row, " | ") + " |\n";
  return text;
}

void ResultTable::write(const std::string& folder, const std::string& name) const {
  write_text(folder + "/" + name + ".md", markdown());
  const auto quoted = [](std::vector<std::string> cells) {
    for (std::string& cell : cells) {
      if (cell.find(',') != std::string::npos) cell = '"' + cell + '"';
    }
    return joined(cells, ",") + "\n";
  };
  std::string csv = quoted(header_);
  for (const auto& row : rows_) csv += quoted(row);
  write_text(folder + "/" + name + ".csv", csv);
}

}  // namespace gyro_deblur::experiments
