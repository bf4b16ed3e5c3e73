// The table of parameters: key, member, allowed values and text of each. Readers, range checks, comparisons,
// cfg/Deblur.cfg, config/default.yaml and the table of doc/guides/parameters.md come from it. Constants are members
// with the same checks and comparisons that no configuration sets.
#pragma once

#include <algorithm>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <typeindex>
#include <utility>
#include <vector>

#include "config/values.hpp"
#include "gyro_deblur/config.hpp"

namespace gyro_deblur {

/// The numbers that are allowed, of a vector for each component: [min, max], or (min, max] where `above`.
struct Limits {
  double min, max;
  const char* unit;  ///< may be empty
  bool above;
};

/// "[MIN, MAX] UNIT", or "(MIN, MAX] UNIT".
std::string to_string(const Limits& limits);

/// The strings that are allowed.
struct OneOf {
  std::vector<std::string> names;
};

enum class Change { AT_START, WHILE_RUNNING };

/// A row of the table.
class Parameter {
 public:
  std::string key;
  std::optional<Limits> limits;      ///< of numbers
  std::vector<std::string> choices;  ///< of enumerations, and of strings that must be one of these; else empty
  std::string text;                  ///< plain sentences: what it is, and what other values do; of a constant: why
  Change change;

  /// The value in the struct whose member it is, or in a whole configuration.
  template <typename Options>
  Value get(const Options& options) const {
    if constexpr (std::is_same_v<Options, Config>) return get_(part_(options));
    if (!is_member_of<Options>()) throw std::logic_error(key + " is not a member of the options it was asked for");
    return get_(&options);
  }

  /// Throws std::bad_variant_access when the value has not the type of the member.
  void set(Config& config, const Value& value) const { set_(mutable_part_(config), value); }

  /// Throws OptionError that names key, value and what is allowed, when the value is not.
  void check(const Value& value) const;

  Value standard() const { return get(Config()); }

  /// Configurations may leave it empty: then it is not known.
  bool may_be_empty() const { return given_ != nullptr; }
  /// Whether a parameter that may be empty was given. No effect on others.
  void set_given(Config& config, bool given) const {
    if (given_ != nullptr) config.given.*given_ = given;
  }
  /// For the table: the parameter may be empty.
  Parameter may_be_empty(bool GivenNumbers::*given) && {
    given_ = given;
    return std::move(*this);
  }

  template <typename Options>
  bool is_member_of() const {
    return owner_ == typeid(Options);
  }

  /// For the table: without limits, with limits, and with choices. Enumerations bring their own choices.
  template <typename Owner, typename T>
  Parameter(const char* name, T Owner::*member, const char* description, Change when = Change::AT_START);
  template <typename Owner, typename T>
  Parameter(const char* name, T Owner::*member, const Limits& allowed, const char* description,
            Change when = Change::AT_START);
  template <typename Owner>
  Parameter(const char* name, std::string Owner::*member, const OneOf& allowed, const char* description,
            Change when = Change::AT_START);

 private:
  std::type_index owner_;               // the struct whose member it is
  const void* (*part_)(const Config&);  // where a configuration has that struct
  void* (*mutable_part_)(Config&);
  std::function<Value(const void*)> get_;
  std::function<void(void*, const Value&)> set_;
  bool GivenNumbers::*given_ = nullptr;
};

/// What is documented together.
struct ParameterGroup {
  std::string name;
  std::string text;  ///< about all of them; may be empty
  std::vector<Parameter> parameters;
};

/// All parameters in the order of the documents.
const std::vector<ParameterGroup>& parameter_groups();

/// Members that are no parameters, by the keys that error messages name.
const std::vector<Parameter>& constants();

/// The row of a parameter's key, or null.
const Parameter* find_parameter(const std::string& key);
/// The row of a constant's key, or null.
const Parameter* find_constant(const std::string& key);

/// The rows of the members of `Options`, parameters and constants.
template <typename Options>
const std::vector<const Parameter*>& parameters_of() {
  static const std::vector<const Parameter*> kParameters = [] {
    std::vector<const Parameter*> parameters;
    for (const ParameterGroup& group : parameter_groups()) {
      for (const Parameter& parameter : group.parameters) {
        if (parameter.is_member_of<Options>()) parameters.push_back(&parameter);
      }
    }
    for (const Parameter& constant : constants()) {
      if (constant.is_member_of<Options>()) parameters.push_back(&constant);
    }
    return parameters;
  }();
  return kParameters;
}

/// Throws OptionError when a member of `options` has a value that its row does not allow.
template <typename Options>
void check_parameters(const Options& options) {
  for (const Parameter* parameter : parameters_of<Options>()) parameter->check(parameter->get(options));
}

/// Whether all members that have rows are the same.
template <typename Options>
bool same_parameters(const Options& a, const Options& b) {
  const auto& parameters = parameters_of<Options>();
  return std::all_of(parameters.begin(), parameters.end(), [&](const Parameter* p) { return p->get(a) == p->get(b); });
}

}  // namespace gyro_deblur
