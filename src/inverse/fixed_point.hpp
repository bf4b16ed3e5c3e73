// Weights as whole numbers.
#pragma once

#include <cmath>
#include <cstdint>

namespace gyro_deblur {

/// std::lround, which is a call; and without a branch, as weights change their sign too often to be foreseen.
inline std::int32_t round_to_int(double x) { return static_cast<std::int32_t>(x + std::copysign(0.5, x)); }

/// Two int16 in one int32.
inline std::int32_t pack_int16(std::int32_t low, std::int32_t high) {
  return static_cast<std::int32_t>((static_cast<std::uint32_t>(high) << 16) |
                                   (static_cast<std::uint32_t>(low) & 0xffffu));
}

}  // namespace gyro_deblur
