#include "parameter_documents.hpp"

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <iterator>
#include <regex>
#include <sstream>
#include <type_traits>
#include <vector>

namespace gyro_deblur {
namespace test {
namespace {

constexpr std::size_t kColumns = 120;
constexpr std::size_t kCommentColumn = 28;

/// A parameter in the documents.
struct Entry {
  Row row;
  std::vector<std::string> choices;
  std::string default_value;  ///< in YAML
  std::string python_type;
  bool has_components;  ///< the limits are those of each
};

/// What is documented together.
struct Group {
  std::string name, text;
  std::vector<Entry> entries;
};

template <typename T>
constexpr const char* python_type_of() {
  if (std::is_same_v<T, bool>) return "bool_t";
  if (std::is_same_v<T, int>) return "int_t";
  return std::is_same_v<T, double> ? "double_t" : "str_t";
}

/// A visitor of the tables that collects the groups in the order of their first rows.
template <typename Options>
class Collector {
 public:
  Collector(const Options& options, std::vector<Group>* groups, std::size_t* current)
      : options_(options), groups_(groups), current_(current) {}

  void group(const std::string& name, const std::string& text = "") {
    const auto found =
        std::find_if(groups_->begin(), groups_->end(), [&name](const Group& group) { return group.name == name; });
    *current_ = static_cast<std::size_t>(found - groups_->begin());
    if (found == groups_->end()) groups_->push_back({name, text, {}});
  }

  template <typename T>
  void operator()(const Row& row, T Options::*member) {
    if (row.change == Change::NEVER) return;
    const bool may_be_empty =
        std::any_of(std::begin(kGivenNumbers), std::end(kGivenNumbers),
                    [&row](const GivenNumber& number) { return number.key == std::string(row.key); });
    groups_->at(*current_).entries.push_back({row, choices_of<T>(row), may_be_empty ? "''" : to_yaml(options_.*member),
                                              python_type_of<T>(), std::is_same_v<T, Eigen::Vector3d>});
  }

  template <typename Part>
  void part(Part Options::*member) {
    visit(Table<Part>(), Collector<Part>(options_.*member, groups_, current_));
  }

 private:
  const Options& options_;
  std::vector<Group>* groups_;
  std::size_t* current_;
};

std::vector<Group> parameter_groups() {
  const Config standard;
  std::vector<Group> groups;
  std::size_t current = 0;
  visit(Table<Config>(), Collector<Config>(standard, &groups, &current));
  return groups;
}

std::string capitalised(std::string text) {
  if (!text.empty()) text.front() = static_cast<char>(std::toupper(static_cast<unsigned char>(text.front())));
  return text;
}

/// "a, b or c"
std::string enumeration(const std::vector<std::string>& names) {
  std::string text;
  for (std::size_t i = 0; i < names.size(); ++i) {
    text += (i == 0 ? "" : i + 1 == names.size() ? " or " : ", ") + names[i];
  }
  return text;
}

/// "[MIN, MAX]", without the unit.
std::string range_of(const Entry& entry) {
  if (!entry.row.limits) return "";
  Limits limits = *entry.row.limits;
  limits.unit = "";
  return (entry.has_components ? "each " : "") + to_string(limits);
}

std::string unit_of(const Entry& entry) { return entry.row.limits ? entry.row.limits->unit : ""; }

/// Text, choices that it does not explain, range and unit.
std::string comment_of(const Entry& p) {
  std::string text = p.row.text;
  const bool explained = std::all_of(p.choices.begin(), p.choices.end(), [&](const std::string& choice) {
    return text.find(choice + ": ") != std::string::npos;
  });
  if (!explained) text += " One of " + enumeration(p.choices) + ".";
  if (!p.row.limits) return text;
  return text + " Allowed: " + range_of(p) + (unit_of(p).empty() ? "" : " " + unit_of(p)) + ".";
}

/// Lines of at most kColumns, each after "# ".
std::string comment_lines(const std::string& text) {
  std::istringstream words(text);
  std::string lines, line = "#";
  for (std::string word; words >> word;) {
    if (line.size() + 1 + word.size() > kColumns) {
      lines += line + "\n";
      line = "#";
    }
    line += " " + word;
  }
  return lines + line + "\n";
}

std::string yaml_lines(const Entry& p) {
  const std::string entry = std::string(p.row.key) + ": " + p.default_value, comment = comment_of(p);
  const std::size_t column = std::max(kCommentColumn, entry.size() + 1);
  if (column + 2 + comment.size() > kColumns) return comment_lines(comment) + entry + "\n";
  return entry + std::string(column - entry.size(), ' ') + "# " + comment + "\n";
}

/// The parameters of a group that may change while running.
std::vector<Entry> running(const Group& group) {
  std::vector<Entry> entries;
  std::copy_if(group.entries.begin(), group.entries.end(), std::back_inserter(entries),
               [](const Entry& p) { return p.row.change == Change::WHILE_RUNNING; });
  return entries;
}

std::string python_default(const Entry& p) {
  if (p.python_type == "bool_t") return capitalised(p.default_value);
  return p.python_type == "str_t" ? '"' + p.default_value + '"' : p.default_value;
}

std::string python_call(const std::string& group, const Entry& p) {
  const std::string key = p.row.key, unit = unit_of(p).empty() ? "" : " [" + unit_of(p) + "]";
  const std::string call = group + ".add(\"" + key + "\", " + p.python_type + ", 0, \"" + p.row.text + unit + "\",";
  std::string rest = python_default(p);
  if (p.row.limits) {
    const auto number = [&p](double limit) {
      return p.python_type == "int_t" ? to_yaml(static_cast<int>(limit)) : to_yaml(limit);
    };
    rest += ", " + number(p.row.limits->min) + ", " + number(p.row.limits->max);
  }
  if (!p.choices.empty()) rest += ", edit_method=" + key + "s";
  rest += ")";
  const bool one_line = call.size() + 1 + rest.size() <= kColumns;
  return call + (one_line ? " " : "\n" + std::string(group.size() + 5, ' ')) + rest + "\n";
}

/// The constants and enumerations that rqt_reconfigure offers. A name stands for the same constant in each of them.
std::string python_enumerations() {
  std::vector<std::string> names;
  std::string enumerations;
  for (const Group& group : parameter_groups()) {
    for (const Entry& p : running(group)) {
      if (p.choices.empty()) continue;
      std::string list;
      for (const std::string& choice : p.choices) {
        list += (list.empty() ? "" : ", ") + choice;
        if (std::find(names.begin(), names.end(), choice) == names.end()) names.push_back(choice);
      }
      enumerations += std::string(p.row.key) + "s = gen.enum([" + list + "], \"" + p.row.text + "\")\n";
    }
  }
  std::string constants;
  for (const std::string& name : names) {
    constants += name + " = gen.const(\"" + name + "\", str_t, \"" + name + "\", \"\")\n";
  }
  return constants + enumerations;
}

std::string markdown_text(std::string text) {
  text = std::regex_replace(text, std::regex(R"(doc/guides/(\w+)\.md)"), "[$1]($1.md)");
  return std::regex_replace(text, std::regex(R"(\|)"), "\\|");
}

std::string markdown_row(const Entry& p) {
  std::string allowed = range_of(p);
  for (std::size_t i = 0; i < p.choices.size(); ++i) allowed += (i == 0 ? "`" : ", `") + p.choices[i] + "`";
  return std::string("| `") + p.row.key + "` | `" + p.default_value + "` | " + unit_of(p) + " | " + allowed + " | " +
         (p.row.change == Change::WHILE_RUNNING ? "yes" : "") + " | " + markdown_text(p.row.text) + " |\n";
}

}  // namespace

std::string to_yaml(bool value) { return value ? "true" : "false"; }

std::string to_yaml(int value) { return std::to_string(value); }

std::string to_yaml(double value) {
  std::string text;
  for (int digits = 6; digits <= 17; ++digits) {
    std::ostringstream s;
    s.precision(digits);
    s << value;
    text = s.str();
    if (std::strtod(text.c_str(), nullptr) == value) break;
  }
  return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}

std::string to_yaml(TimeNs value_ns) { return to_yaml(to_seconds(value_ns)); }

std::string to_yaml(const std::string& value) { return value.empty() ? "''" : value; }

std::string to_yaml(const std::vector<std::string>& value) { return value.empty() ? "''" : value.front(); }

std::string to_yaml(const Eigen::Vector3d& value) {
  return "[" + to_yaml(value.x()) + ", " + to_yaml(value.y()) + ", " + to_yaml(value.z()) + "]";
}

std::string to_yaml(const std::optional<Eigen::Matrix3d>& value) {
  std::string text;
  for (int i = 0; value && i < 9; ++i) text += (i == 0 ? "" : ", ") + to_yaml((*value)(i / 3, i % 3));
  return "[" + text + "]";
}

std::string default_yaml() {
  std::string text = comment_lines(
      "Every parameter of gyro_deblur with its default. One flat set of keys, in the nodelet's private namespace and "
      "for deblur_bag --config. Times are in seconds. The tables of parameters (CONTRIBUTING.md) decide what is here.");
  for (const Group& group : parameter_groups()) {
    text += "\n# --- " + group.name + " ---\n";
    if (!group.text.empty()) text += comment_lines(group.text);
    for (const Entry& p : group.entries) text += yaml_lines(p);
  }
  return text;
}

std::string deblur_cfg() {
  std::string text = R"(#!/usr/bin/env python3
"""What may change while gyro_deblur runs. The tables of parameters (CONTRIBUTING.md) decide what is here."""

from dynamic_reconfigure.parameter_generator_catkin import ParameterGenerator, bool_t, double_t, int_t, str_t

PACKAGE = "gyro_deblur"

gen = ParameterGenerator()

)";
  text += python_enumerations();
  for (const Group& group : parameter_groups()) {
    const std::vector<Entry> parameters = running(group);
    if (parameters.empty()) continue;
    std::string variable = group.name;
    std::replace(variable.begin(), variable.end(), ' ', '_');
    std::transform(variable.begin(), variable.end(), variable.begin(), [](unsigned char c) { return std::tolower(c); });
    text += "\n" + variable + " = gen.add_group(\"" + capitalised(group.name) + "\")\n";
    for (const Entry& p : parameters) text += python_call(variable, p);
  }
  return text + "\nexit(gen.generate(PACKAGE, \"gyro_deblur\", \"Deblur\"))\n";
}

std::string parameter_tables() {
  std::string text;
  for (const Group& group : parameter_groups()) {
    text += (text.empty() ? "" : "\n") + ("**" + capitalised(group.name)) + "**\n\n";
    text += "| key | default | unit | allowed | while running | meaning |\n| --- | --- | --- | --- | --- | --- |\n";
    for (const Entry& p : group.entries) text += markdown_row(p);
  }
  return text;
}

}  // namespace test
}  // namespace gyro_deblur
