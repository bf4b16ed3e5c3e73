// Weights as whole numbers.
#pragma once

#include <cstdint>

namespace gyro_deblur {

/// Rounds value + error, |value + error| < 2^31 and halves to even, and sets `error` to what is left of it. Each error
/// waits for the one before: two additions round in less time than conversions to an integer and back.
inline std::int32_t round_with_error(double value, double& error) {
  constexpr double kUnit = 6755399441055744.0;  // 2^52 + 2^51: doubles about it are one apart
  value += error;
  const double rounded = (value + kUnit) - kUnit;
  error = value - rounded;
  return static_cast<std::int32_t>(rounded);
}

/// Two int16 in one int32.
inline std::int32_t pack_int16(std::int32_t low, std::int32_t high) {
  return static_cast<std::int32_t>((static_cast<std::uint32_t>(high) << 16) |
                                   (static_cast<std::uint32_t>(low) & 0xffffu));
}

}  // namespace gyro_deblur
