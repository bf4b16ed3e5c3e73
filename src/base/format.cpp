// Writes numbers in text.
#include "base/format.hpp"

#include <cinttypes>
#include <cstdarg>
#include <cstdio>

namespace gyro_deblur {

std::string format(const char* pattern, ...) {
  va_list arguments, again;
  va_start(arguments, pattern);
  va_copy(again, arguments);
  std::string text(static_cast<std::size_t>(std::vsnprintf(nullptr, 0, pattern, arguments)), '\0');
  std::vsnprintf(text.data(), text.size() + 1, pattern, again);
  va_end(again);
  va_end(arguments);
  return text;
}

std::string seconds_text(TimeNs time_ns) {
  constexpr std::uint64_t kNsPerSecond = 1'000'000'000;
  const std::uint64_t magnitude =
      time_ns < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(time_ns) : static_cast<std::uint64_t>(time_ns);
  return format("%s%" PRIu64 ".%09" PRIu64, time_ns < 0 ? "-" : "", magnitude / kNsPerSecond, magnitude % kNsPerSecond);
}

std::string vector_text(const Eigen::Vector3d& v) { return format("[%.6f, %.6f, %.6f]", v.x(), v.y(), v.z()); }

std::string size_text(double width, double height) { return format("%gx%g", width, height); }

}  // namespace gyro_deblur
