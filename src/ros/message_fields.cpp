// Finds a field in a serialised message by the message's definition.
#include "ros/message_fields.hpp"

#include <cstring>
#include <sstream>
#include <stdexcept>

namespace gyro_deblur {
namespace {

/// The serialisation is little-endian, as are all machines that ROS 1 supports.
template <typename T>
T load(const std::uint8_t* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof(T));
  return value;
}

template <typename T>
FieldValue number(const std::uint8_t* bytes) {
  return static_cast<double>(load<T>(bytes));
}

/// @tparam Seconds  unsigned for a time, signed for a duration
template <typename Seconds>
FieldValue time(const std::uint8_t* bytes) {
  constexpr TimeNs kNsPerSecond = 1'000'000'000;
  constexpr std::size_t kSecondPart = 4;
  return FieldTime{load<Seconds>(bytes) * kNsPerSecond + load<Seconds>(bytes + kSecondPart)};
}

/// A built-in type of fixed size.
struct Builtin {
  std::size_t size;
  FieldValue (*read)(const std::uint8_t* bytes);
};

/// Null for other types.
const Builtin* find_builtin(const std::string& type) {
  static const std::map<std::string, Builtin> kTypes{
      {"bool", {1, number<std::uint8_t>}},    {"byte", {1, number<std::int8_t>}},
      {"char", {1, number<std::uint8_t>}},    {"int8", {1, number<std::int8_t>}},
      {"uint8", {1, number<std::uint8_t>}},   {"int16", {2, number<std::int16_t>}},
      {"uint16", {2, number<std::uint16_t>}}, {"int32", {4, number<std::int32_t>}},
      {"uint32", {4, number<std::uint32_t>}}, {"int64", {8, number<std::int64_t>}},
      {"uint64", {8, number<std::uint64_t>}}, {"float32", {4, number<float>}},
      {"float64", {8, number<double>}},       {"time", {8, time<std::uint32_t>}},
      {"duration", {8, time<std::int32_t>}}};
  const auto found = kTypes.find(type);
  return found == kTypes.end() ? nullptr : &found->second;
}

bool is_builtin(const std::string& type) { return type == "string" || find_builtin(type) != nullptr; }

}  // namespace

MessageLayout::MessageLayout(const std::string& type, const std::string& definition) : type_(type) {
  std::istringstream lines(definition);
  std::string current = type;
  types_[current];
  for (std::string line; std::getline(lines, line);) {
    line = line.substr(0, line.find('#'));
    if (line.rfind("====", 0) == 0) continue;
    std::istringstream words(line);
    std::string field_type, name;
    if (!(words >> field_type >> name)) continue;
    if (field_type == "MSG:") {
      current = name;
      types_[current];
      continue;
    }
    // Constants are no fields: "uint8 A=1", "string NAME = text".
    std::string rest;
    std::getline(words, rest);
    if (name.find('=') != std::string::npos || rest.find('=') != std::string::npos) continue;
    Field field;
    field.name = name;
    const std::size_t bracket = field_type.find('[');
    field.type = field_type.substr(0, bracket);
    if (bracket != std::string::npos) {
      field.is_array = true;
      const std::string count = field_type.substr(bracket + 1, field_type.find(']') - bracket - 1);
      constexpr std::size_t kMostDigits = 9;
      if (count.size() > kMostDigits || count.find_first_not_of("0123456789") != std::string::npos) {
        throw std::runtime_error("the definition of " + type + " has an array \"" + field_type + " " + name +
                                 "\" whose length is not a number");
      }
      if (!count.empty()) field.count = static_cast<std::size_t>(std::stoul(count));
    }
    types_[current].push_back(field);
  }
  // Names without a package are of the same one, and Header is that of std_msgs.
  for (auto& [name, fields] : types_) {
    for (Field& field : fields) {
      if (is_builtin(field.type)) continue;
      if (field.type == "Header") field.type = "std_msgs/Header";
      if (field.type.find('/') == std::string::npos) field.type = name.substr(0, name.find('/')) + "/" + field.type;
      if (types_.count(field.type) == 0) {
        throw std::runtime_error("the definition of " + type + " lacks that of " + field.type);
      }
    }
  }
  std::map<std::string, std::size_t> counts;
  count_fields(type, &counts);
}

std::size_t MessageLayout::count_fields(const std::string& type, std::map<std::string, std::size_t>* counts) const {
  const auto fields = types_.find(type);
  if (fields == types_.end()) return 1;
  constexpr std::size_t kUnderWay = 0;
  const auto [known, is_new] = counts->emplace(type, kUnderWay);
  if (!is_new) {
    if (known->second == kUnderWay) {
      throw std::runtime_error("in the definition of " + type_ + ", " + type + " contains itself");
    }
    return known->second;
  }
  std::size_t count = 1;
  for (const Field& field : fields->second) count += count_fields(field.type, counts);
  constexpr std::size_t kMostFields = 10000;
  if (count > kMostFields) {
    throw std::runtime_error("the definition of " + type_ + " has more than " + std::to_string(kMostFields) +
                             " fields");
  }
  return (*counts)[type] = count;
}

/// Goes through the bytes of a message until the field that is wanted.
class MessageLayout::Walk {
 public:
  Walk(const MessageLayout& layout, const std::string& wanted, const std::uint8_t* bytes, std::size_t size)
      : layout_(layout), wanted_(wanted), next_(bytes), left_(size) {}

  /// The field, if this message has it.
  std::optional<FieldValue> message(const std::string& type, const std::string& prefix) {
    for (const Field& field : layout_.types_.at(type)) {
      const std::string path = prefix + field.name;
      if (!field.is_array) {
        if (std::optional<FieldValue> value = element(field.type, path)) return value;
        continue;
      }
      const std::size_t count = field.count > 0 ? field.count : load<std::uint32_t>(take(sizeof(std::uint32_t)));
      const Builtin* const builtin = find_builtin(field.type);
      if (builtin != nullptr && wanted_.rfind(path + "[", 0) != 0) {  // pixels, most likely
        if (count > left_ / builtin->size) fail();
        take(count * builtin->size);
        continue;
      }
      for (std::size_t i = 0; i < count; ++i) {
        const std::size_t left_before = left_;
        if (auto value = element(field.type, path + "[" + std::to_string(i) + "]")) return value;
        if (left_ == left_before) break;  // messages without fields, as are all that follow
      }
    }
    return std::nullopt;
  }

 private:
  [[noreturn]] void fail() const {
    throw std::runtime_error("a message of type " + layout_.type_ + " ends before its definition does");
  }
  const std::uint8_t* take(std::size_t count) {
    if (count > left_) fail();
    const std::uint8_t* bytes = next_;
    next_ += count;
    left_ -= count;
    return bytes;
  }
  std::optional<FieldValue> element(const std::string& type, const std::string& path) {
    if (!is_builtin(type)) return message(type, path + ".");
    if (type == "string") {
      const std::size_t length = load<std::uint32_t>(take(sizeof(std::uint32_t)));
      const auto* text = reinterpret_cast<const char*>(take(length));
      return path == wanted_ ? std::optional<FieldValue>(std::string(text, length)) : std::nullopt;
    }
    const Builtin& builtin = *find_builtin(type);
    const std::uint8_t* bytes = take(builtin.size);
    return path == wanted_ ? std::optional<FieldValue>(builtin.read(bytes)) : std::nullopt;
  }

  const MessageLayout& layout_;
  const std::string& wanted_;
  const std::uint8_t* next_;
  std::size_t left_;
};

std::optional<FieldValue> MessageLayout::find(const std::string& path, const std::uint8_t* bytes,
                                              std::size_t size) const {
  return Walk(*this, path, bytes, size).message(type_, "");
}

void MessageLayout::list(const std::string& type, const std::string& prefix, std::vector<std::string>* result) const {
  for (const Field& field : types_.at(type)) {
    const std::string path = prefix + field.name + (field.is_array ? "[0]" : "");
    if (is_builtin(field.type)) {
      result->push_back(path);
    } else {
      list(field.type, path + ".", result);
    }
  }
}

std::vector<std::string> MessageLayout::paths() const {
  std::vector<std::string> result;
  list(type_, "", &result);
  return result;
}

}  // namespace gyro_deblur
