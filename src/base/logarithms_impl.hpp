// Natural logarithms and powers of e of vectors, for the bodies of SIMD kernels (see base/vectors_impl.hpp).
#pragma once

#include "base/vectors_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

/// To 1e-5, of normal x > 0: between powers of two by a polynomial through Chebyshev's points.
inline Vector log_of(Vector x) {
  IntVector bits = load_as<IntVector>(&x);
  const IntVector exponent = (bits >> 23) - 127;
  bits = (bits & 0x7fffff) | 0x3f800000;
  const Vector m = load_as<Vector>(&bits);
  constexpr float kLog2 = 0.69314718f;
  return kLog2 * __builtin_convertvector(exponent, Vector) - 1.93675974f +
         m * (3.5140873f + m * (-2.44002976f + m * (1.11609003f + m * (-0.28382685f + m * 0.030449f))));
}

/// To a share of 1e-5, of x from -80 to 80: in the same way.
inline Vector exp_of(Vector x) {
  constexpr float kLog2e = 1.442695041f;
  const Vector power = kLog2e * x + 127.0f;
  const IntVector whole = __builtin_convertvector(power, IntVector), bits = whole << 23;
  const Vector rest = power - __builtin_convertvector(whole, Vector);
  return load_as<Vector>(&bits) *
         (1.0000036f + rest * (0.69296955f + rest * (0.24162132f + rest * (0.05171774f + rest * 0.01368398f))));
}

}  // namespace
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
