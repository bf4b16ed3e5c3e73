// Results as a table, for the screen, a CSV file and a Markdown file.
#pragma once

#include <string>
#include <vector>

namespace gyro_deblur::experiments {

/// Value at a share of the sorted values, the upper one of two; NaN of none.
/// @param share  [0, 1]
double quantile(std::vector<double> values, double share);

/// A number as text; "-" for NaN.
std::string text_of(double value, int digits);

class ResultTable {
 public:
  explicit ResultTable(std::vector<std::string> header) : header_(std::move(header)) {}

  /// Precondition: as many cells as the header has.
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  std::string markdown() const;
  /// FOLDER/NAME.csv and FOLDER/NAME.md. Throws std::runtime_error with the path.
  void write(const std::string& folder, const std::string& name) const;

 private:
  std::vector<std::string> header_;
  std::vector<std::vector<std::string>> rows_;
};

}  // namespace gyro_deblur::experiments
