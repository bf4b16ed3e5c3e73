// What a parameter's value is, and how it gets out of a member and into it.
#pragma once

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include <Eigen/Core>

#include "gyro_deblur/config.hpp"

namespace gyro_deblur {

/// An enumerator by its name.
struct Choice {
  std::string name;
  bool operator==(const Choice& other) const { return name == other.name; }
};

/// By the type of the member. Times are in seconds wherever they are written as text.
using Value = std::variant<bool, int, double, TimeNs, std::string, Choice, std::vector<std::string>, Eigen::Vector3d,
                           std::optional<Eigen::Matrix3d>>;

template <typename Enum>
using Names = std::vector<std::pair<std::string, Enum>>;

inline const Names<StampRow>& names_of(StampRow) {
  static const Names<StampRow> kNames{
      {"first", StampRow::FIRST}, {"middle", StampRow::MIDDLE}, {"last", StampRow::LAST}};
  return kNames;
}

inline const Names<StampPhase>& names_of(StampPhase) {
  static const Names<StampPhase> kNames{
      {"start", StampPhase::START}, {"middle", StampPhase::MIDDLE}, {"end", StampPhase::END}};
  return kNames;
}

inline const Names<RectifyTo>& names_of(RectifyTo) {
  static const Names<RectifyTo> kNames{{"middle_row", RectifyTo::MIDDLE_ROW},
                                       {"first_row", RectifyTo::FIRST_ROW},
                                       {"last_row", RectifyTo::LAST_ROW},
                                       {"stamp", RectifyTo::STAMP}};
  return kNames;
}

inline const Names<ImageBorder>& names_of(ImageBorder) {
  static const Names<ImageBorder> kNames{{"black", ImageBorder::BLACK}, {"replicate", ImageBorder::REPLICATE}};
  return kNames;
}

inline const Names<Regularization>& names_of(Regularization) {
  static const Names<Regularization> kNames{
      {"adaptive", Regularization::ADAPTIVE}, {"fixed", Regularization::FIXED}, {"paper", Regularization::PAPER}};
  return kNames;
}

inline const Names<ValidationRule>& names_of(ValidationRule) {
  static const Names<ValidationRule> kNames{{"likelihood", ValidationRule::LIKELIHOOD},
                                            {"gradient", ValidationRule::GRADIENT},
                                            {"none", ValidationRule::NONE}};
  return kNames;
}

inline const Names<OnCalibrationConflict>& names_of(OnCalibrationConflict) {
  static const Names<OnCalibrationConflict> kNames{{"error", OnCalibrationConflict::ERROR},
                                                   {"configured", OnCalibrationConflict::CONFIGURED}};
  return kNames;
}

inline const Names<SelfCalibrationMode>& names_of(SelfCalibrationMode) {
  static const Names<SelfCalibrationMode> kNames{{"auto", SelfCalibrationMode::AUTO},
                                                 {"never", SelfCalibrationMode::NEVER}};
  return kNames;
}

inline const Names<OnExposureConflict>& names_of(OnExposureConflict) {
  static const Names<OnExposureConflict> kNames{{"images", OnExposureConflict::IMAGES},
                                                {"configured", OnExposureConflict::CONFIGURED}};
  return kNames;
}

/// Kind and unit together; the unit is part of the name, so that nobody has to guess it.
using ExposureMessage = std::pair<ExposureSource::Kind, ExposureUnit>;

inline const Names<ExposureMessage>& names_of(const ExposureSource&) {
  using Kind = ExposureSource::Kind;
  static const Names<ExposureMessage> kNames{
      {"auto", {Kind::AUTO, ExposureUnit::SECONDS}},
      {"message", {Kind::MESSAGE, ExposureUnit::SECONDS}},
      {"field_us", {Kind::FIELD, ExposureUnit::MICROSECONDS}},
      {"field_10us", {Kind::FIELD, ExposureUnit::TEN_MICROSECONDS}},
      {"field_100us", {Kind::FIELD, ExposureUnit::HUNDRED_MICROSECONDS}},
      {"field_ms", {Kind::FIELD, ExposureUnit::MILLISECONDS}},
      {"field_s", {Kind::FIELD, ExposureUnit::SECONDS}},
      {"realsense_metadata_us", {Kind::REALSENSE_METADATA, ExposureUnit::MICROSECONDS}},
      {"realsense_metadata_100us", {Kind::REALSENSE_METADATA, ExposureUnit::HUNDRED_MICROSECONDS}},
      {"dynamic_reconfigure_us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MICROSECONDS}},
      {"dynamic_reconfigure_10us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::TEN_MICROSECONDS}},
      {"dynamic_reconfigure_100us", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::HUNDRED_MICROSECONDS}},
      {"dynamic_reconfigure_ms", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MILLISECONDS}},
      {"dynamic_reconfigure_s", {Kind::DYNAMIC_RECONFIGURE, ExposureUnit::SECONDS}}};
  return kNames;
}

/// Whether members of the type have names for their values.
template <typename T>
constexpr bool kHasNames = std::is_enum_v<T> || std::is_same_v<T, ExposureSource>;

/// What of a member has a name: the enumerator itself, of an exposure's source all but the field.
template <typename Enum>
const Enum& named_part(const Enum& member) {
  return member;
}
inline ExposureMessage named_part(const ExposureSource& member) { return {member.kind, member.unit}; }

template <typename Enum>
void assign_named(Enum name, Enum& member) {
  member = name;
}
inline void assign_named(const ExposureMessage& name, ExposureSource& member) {
  std::tie(member.kind, member.unit) = name;
}

template <typename T>
Value to_value(const T& member) {
  if constexpr (kHasNames<T>) {
    for (const auto& [name, named] : names_of(member)) {
      if (named == named_part(member)) return Choice{name};
    }
    return Choice{};  // not an enumerator
  } else {
    return Value(std::in_place_type<T>, member);  // nothing is converted
  }
}

/// Throws std::bad_variant_access when the value is of another type, std::out_of_range when nothing has that name.
template <typename T>
void assign(const Value& value, T& member) {
  if constexpr (kHasNames<T>) {
    const auto& names = names_of(member);
    const std::string& wanted = std::get<Choice>(value).name;
    const auto found = std::find_if(names.begin(), names.end(), [&](const auto& n) { return n.first == wanted; });
    if (found == names.end()) throw std::out_of_range(wanted + " is not the name of a value");
    assign_named(found->second, member);
  } else {
    member = std::get<T>(value);
  }
}

}  // namespace gyro_deblur
