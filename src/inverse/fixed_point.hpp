// Weights as whole numbers.
#pragma once

#include <cstdint>

namespace gyro_deblur {

/// std::lround, which is a call.
inline std::int32_t round_to_int(double x) { return static_cast<std::int32_t>(x < 0 ? x - 0.5 : x + 0.5); }

/// Two int16 in one int32.
inline std::int32_t pack_int16(std::int32_t low, std::int32_t high) {
  return static_cast<std::int32_t>((static_cast<std::uint32_t>(high) << 16) |
                                   (static_cast<std::uint32_t>(low) & 0xffffu));
}

}  // namespace gyro_deblur
