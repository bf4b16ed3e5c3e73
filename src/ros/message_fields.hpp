// Single fields of serialised messages whose package is not installed, by the definition that comes with them.
// (ros_type_introspection can do this as well, but Debian 12 does not have it.)
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// A time or duration is in nanoseconds.
struct FieldTime {
  TimeNs ns = 0;
};
/// What a field of a built-in type holds; integers as double are exact up to 2^53.
using FieldValue = std::variant<double, std::string, FieldTime>;

/// The layout of one message type, from its full definition (with those of the types it contains, as connection headers
/// and bags have it; wiki.ros.org/msg, wiki.ros.org/ROS/Connection%20Header).
class MessageLayout {
 public:
  /// @param type        e.g. "image_exposure_msgs/ExposureSequence"
  /// @param definition  the text of the connection header
  /// Throws std::runtime_error that names the type which is not understood.
  MessageLayout(const std::string& type, const std::string& definition);

  /// The value of one field; nothing when the message has no such field (an array may be too short).
  /// @param path  names separated by dots, elements of arrays in brackets: "exposures[0].shutterms"
  /// Throws std::runtime_error when the bytes end before the message does.
  std::optional<FieldValue> find(const std::string& path, const std::uint8_t* bytes, std::size_t size) const;

  /// Paths of the fields of built-in types; elements of arrays as "[0]".
  std::vector<std::string> paths() const;

 private:
  struct Field {
    std::string type;  // without brackets; a key of types_ where it is not built in
    std::string name;
    bool is_array = false;
    std::size_t count = 0;  // of an array of fixed size; 0: any
  };
  class Walk;
  /// Fields of a type and of what it contains. Throws when it contains itself, or more than anybody would send: what
  /// walks through it could not come to an end.
  std::size_t count_fields(const std::string& type, std::map<std::string, std::size_t>* counts) const;
  void list(const std::string& type, const std::string& prefix, std::vector<std::string>* result) const;

  std::string type_;
  std::map<std::string, std::vector<Field>> types_;
};

}  // namespace gyro_deblur
