// Tables of parameters. The table of a struct of options is a function `visit(Table<Options>, visitor)`, which calls
//   visitor(row, &Options::member)   for each member,
//   visitor.part(&Options::member)   for each member that has a table of its own,
//   visitor.group(name, text)        before the members that are documented together.
// Readers, range checks, comparisons and documents are visitors. The order is that of the documents.
#pragma once

#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// The numbers that are allowed, of a vector for each component: [min, max], or (min, max] where `above`.
struct Limits {
  double min, max;
  const char* unit;  ///< may be empty
  bool above;
};

constexpr Limits within(double min, double max, const char* unit = "") { return {min, max, unit, false}; }
constexpr Limits above(double min, double max, const char* unit = "") { return {min, max, unit, true}; }

/// "[MIN, MAX] UNIT", or "(MIN, MAX] UNIT".
std::string to_string(const Limits& limits);

/// The strings that are allowed.
using OneOf = std::vector<const char*>;

enum class Change {
  AT_START,
  WHILE_RUNNING,
  NEVER  ///< a constant: no configuration sets it
};

/// What a table says about a member.
struct Row {
  const char* key;
  std::optional<Limits> limits;  ///< of numbers
  OneOf choices;                 ///< of strings that must be one of these; else empty
  const char* text;              ///< sentences: what it is, and what other values do; of a constant: why
  Change change;

  Row(const char* name, const char* description, Change when = Change::AT_START)
      : key(name), text(description), change(when) {}
  Row(const char* name, const Limits& allowed, const char* description, Change when = Change::AT_START)
      : key(name), limits(allowed), text(description), change(when) {}
  Row(const char* name, OneOf allowed, const char* description, Change when = Change::AT_START)
      : key(name), choices(std::move(allowed)), text(description), change(when) {}
};

template <typename Options>
struct Table {};

/// Names of an enumeration's values, in the order of the documents: names_of(value).
template <typename Enum>
using Names = std::vector<std::pair<const char*, Enum>>;

template <typename T, typename = void>
struct HasNames : std::false_type {};
template <typename T>
struct HasNames<T, std::void_t<decltype(names_of(std::declval<T>()))>> : std::true_type {};

/// The name of a value. Empty for what is none.
template <typename T>
std::string name_of(const T& value) {
  for (const auto& [name, named] : names_of(value)) {
    if (value == named) return name;
  }
  return {};
}

/// All that a member of the type may be, where it has names; else nothing.
template <typename T>
std::vector<std::string> choices_of(const Row& row) {
  std::vector<std::string> choices(row.choices.begin(), row.choices.end());
  if constexpr (HasNames<T>::value) {
    for (const auto& named : names_of(T{})) choices.emplace_back(named.first);
  }
  return choices;
}

/// Throws OptionError that names key, value and what is allowed, when the row does not allow the value.
void require_allowed(const Row& row, double value);
void require_allowed(const Row& row, TimeNs value_ns);
void require_allowed(const Row& row, const std::string& value);
void require_allowed(const Row& row, const Eigen::Vector3d& value);
inline void require_allowed(const Row& row, int value) { require_allowed(row, static_cast<double>(value)); }
inline void require_allowed(const Row&, bool) {}
inline void require_allowed(const Row&, const std::vector<std::string>&) {}
template <typename T>
std::enable_if_t<HasNames<T>::value> require_allowed(const Row&, const T&) {}

/// A visitor that calls on_member(row, pointer) for each member and on_part(pointer) for each part.
template <typename OnMember, typename OnPart>
struct TableVisitor {
  void group(const char*, const char* = "") const {}
  template <typename Member>
  void operator()(const Row& row, Member member) const {
    on_member(row, member);
  }
  template <typename Part>
  void part(Part member) const {
    on_part(member);
  }
  OnMember on_member;
  OnPart on_part;
};
template <typename OnMember, typename OnPart>
TableVisitor(OnMember, OnPart) -> TableVisitor<OnMember, OnPart>;

/// Throws OptionError when a member has a value that its row does not allow, or a part is not valid.
template <typename Options>
void check_parameters(const Options& options) {
  visit(Table<Options>(), TableVisitor{[&](const Row& row, auto member) { require_allowed(row, options.*member); },
                                       [&](auto member) { (options.*member).validate(); }});
}

/// Whether all members that have rows are the same, also those of parts.
template <typename Options>
bool same_parameters(const Options& a, const Options& b) {
  bool same = true;
  visit(Table<Options>(), TableVisitor{[&](const Row&, auto member) { same = same && a.*member == b.*member; },
                                       [&](auto member) { same = same && same_parameters(a.*member, b.*member); }});
  return same;
}

/// Calls function(row, value) for all members of the options and of their parts.
template <typename Options, typename Function>
void for_each_parameter(Options&& options, Function&& function) {
  visit(Table<std::decay_t<Options>>(),
        TableVisitor{[&](const Row& row, auto member) { function(row, options.*member); },
                     [&](auto member) { for_each_parameter(options.*member, function); }});
}

}  // namespace gyro_deblur
