#include "parameter_documents.hpp"

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <regex>
#include <sstream>
#include <vector>

#include "config/parameters.hpp"

namespace gyro_deblur {
namespace test {
namespace {

constexpr std::size_t kColumns = 120;
constexpr std::size_t kCommentColumn = 28;

/// The fewest digits that give the same number again, with a point: 64.0, 0.01, 1e-05.
std::string decimal(double value) {
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

// A default in YAML.
std::string yaml(bool value) { return value ? "true" : "false"; }
std::string yaml(int value) { return std::to_string(value); }
std::string yaml(double value) { return decimal(value); }
std::string yaml(TimeNs value_ns) { return decimal(to_seconds(value_ns)); }
std::string yaml(const std::string& value) { return value.empty() ? "''" : value; }
std::string yaml(const Choice& value) { return value.name; }
std::string yaml(const std::vector<std::string>& value) { return value.empty() ? "''" : value.front(); }
std::string yaml(const Eigen::Vector3d& value) {
  return "[" + decimal(value.x()) + ", " + decimal(value.y()) + ", " + decimal(value.z()) + "]";
}
std::string yaml(const std::optional<Eigen::Matrix3d>& value) { return value ? "?" : "[]"; }

std::string default_of(const Parameter& parameter) {
  if (parameter.may_be_empty()) return "''";
  return std::visit([](const auto& value) { return yaml(value); }, parameter.standard());
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
std::string range_of(const Parameter& parameter) {
  if (!parameter.limits) return "";
  Limits limits = *parameter.limits;
  limits.unit = "";
  const bool each = std::holds_alternative<Eigen::Vector3d>(parameter.standard());
  return (each ? "each " : "") + to_string(limits);
}

/// Text, choices that it does not explain, range and unit.
std::string comment_of(const Parameter& p) {
  std::string text = p.text;
  const bool explained = std::all_of(p.choices.begin(), p.choices.end(), [&](const std::string& choice) {
    return text.find(choice + ": ") != std::string::npos;
  });
  if (!explained) text += " One of " + enumeration(p.choices) + ".";
  if (p.limits) text += " Allowed: " + range_of(p);
  if (p.limits && *p.limits->unit != '\0') text += std::string(" ") + p.limits->unit;
  return text + (p.limits ? "." : "");
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

std::string yaml_lines(const Parameter& p) {
  const std::string entry = p.key + ": " + default_of(p), comment = comment_of(p);
  const std::size_t column = std::max(kCommentColumn, entry.size() + 1);
  if (column + 2 + comment.size() > kColumns) return comment_lines(comment) + entry + "\n";
  return entry + std::string(column - entry.size(), ' ') + "# " + comment + "\n";
}

/// The parameters of a group that may change while running.
std::vector<const Parameter*> running(const ParameterGroup& group) {
  std::vector<const Parameter*> parameters;
  for (const Parameter& p : group.parameters) {
    if (p.change == Change::WHILE_RUNNING) parameters.push_back(&p);
  }
  return parameters;
}

struct PythonType {
  const char* name;
  std::string default_value;
};

PythonType python_type(const Parameter& p) {
  const Value value = p.standard();
  if (std::holds_alternative<bool>(value)) return {"bool_t", std::get<bool>(value) ? "True" : "False"};
  if (std::holds_alternative<int>(value)) return {"int_t", default_of(p)};
  if (std::holds_alternative<double>(value)) return {"double_t", default_of(p)};
  return {"str_t", '"' + default_of(p) + '"'};
}

std::string python_call(const std::string& group, const Parameter& p) {
  const PythonType type = python_type(p);
  std::string unit;
  if (p.limits && *p.limits->unit != '\0') unit = std::string(" [") + p.limits->unit + "]";
  std::string call = group + ".add(\"" + p.key + "\", " + type.name + ", 0, \"" + std::string(p.text) + unit + "\",";
  std::string rest = type.default_value;
  if (p.limits && std::string(type.name) == "int_t") {
    rest += ", " + yaml(static_cast<int>(p.limits->min)) + ", " + yaml(static_cast<int>(p.limits->max));
  } else if (p.limits) {
    rest += ", " + decimal(p.limits->min) + ", " + decimal(p.limits->max);
  }
  if (!p.choices.empty()) rest += ", edit_method=" + p.key + "s";
  rest += ")";
  const bool one_line = call.size() + 1 + rest.size() <= kColumns;
  return call + (one_line ? " " : "\n" + std::string(group.size() + 5, ' ')) + rest + "\n";
}

/// The constants and enumerations that rqt_reconfigure offers. A name stands for the same constant in each of them.
std::string python_enumerations() {
  std::vector<std::string> names;
  std::string enumerations;
  for (const ParameterGroup& group : parameter_groups()) {
    for (const Parameter* p : running(group)) {
      if (p->choices.empty()) continue;
      std::string list;
      for (const std::string& choice : p->choices) {
        list += (list.empty() ? "" : ", ") + choice;
        if (std::find(names.begin(), names.end(), choice) == names.end()) names.push_back(choice);
      }
      enumerations += p->key + "s = gen.enum([" + list + "], \"" + p->text + "\")\n";
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

std::string markdown_row(const Parameter& p) {
  std::string allowed = range_of(p);
  for (std::size_t i = 0; i < p.choices.size(); ++i) allowed += (i == 0 ? "`" : ", `") + p.choices[i] + "`";
  return "| `" + p.key + "` | `" + default_of(p) + "` | " + (p.limits ? p.limits->unit : "") + " | " + allowed + " | " +
         (p.change == Change::WHILE_RUNNING ? "yes" : "") + " | " + markdown_text(p.text) + " |\n";
}

}  // namespace

std::string default_yaml() {
  std::string text = comment_lines(
      "Every parameter of gyro_deblur with its default. One flat set of keys, in the nodelet's private namespace and "
      "for "
      "deblur_bag --config. Times are in seconds. The table in src/config/parameters.cpp decides what is here.");
  for (const ParameterGroup& group : parameter_groups()) {
    text += "\n# --- " + group.name + " ---\n";
    if (!group.text.empty()) text += comment_lines(group.text);
    for (const Parameter& p : group.parameters) text += yaml_lines(p);
  }
  return text;
}

std::string deblur_cfg() {
  std::string text = R"(#!/usr/bin/env python3
"""What may change while gyro_deblur runs. The table in src/config/parameters.cpp decides what is here."""

from dynamic_reconfigure.parameter_generator_catkin import ParameterGenerator, bool_t, double_t, int_t, str_t

PACKAGE = "gyro_deblur"

gen = ParameterGenerator()

)";
  text += python_enumerations();
  for (const ParameterGroup& group : parameter_groups()) {
    const std::vector<const Parameter*> parameters = running(group);
    if (parameters.empty()) continue;
    std::string variable = group.name;
    std::replace(variable.begin(), variable.end(), ' ', '_');
    std::transform(variable.begin(), variable.end(), variable.begin(), [](unsigned char c) { return std::tolower(c); });
    text += "\n" + variable + " = gen.add_group(\"" + capitalised(group.name) + "\")\n";
    for (const Parameter* p : parameters) text += python_call(variable, *p);
  }
  return text + "\nexit(gen.generate(PACKAGE, \"gyro_deblur\", \"Deblur\"))\n";
}

std::string parameter_tables() {
  std::string text;
  for (const ParameterGroup& group : parameter_groups()) {
    text += (text.empty() ? "" : "\n") + ("**" + capitalised(group.name)) + "**\n\n";
    text += "| key | default | unit | allowed | while running | meaning |\n| --- | --- | --- | --- | --- | --- |\n";
    for (const Parameter& p : group.parameters) text += markdown_row(p);
  }
  return text;
}

}  // namespace test
}  // namespace gyro_deblur
