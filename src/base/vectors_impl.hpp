// Vectors of one instruction set, for the bodies of SIMD kernels. Such a body is an *_impl.hpp,
// included by one source file per set, each of which is compiled with its own flags and defines GYRO_DEBLUR_ISA (a
// namespace), GYRO_DEBLUR_ISA_NAME and GYRO_DEBLUR_VECTOR_BYTES. Everything in it has internal linkage and nothing
// comes from the standard library's templates: a shared inline function compiled for AVX-512 could otherwise be the
// copy that the linker keeps for every processor.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__SSE2__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace gyro_deblur {
namespace GYRO_DEBLUR_ISA {
namespace {

constexpr int kLanes = GYRO_DEBLUR_VECTOR_BYTES / 4;

typedef float Vector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));
typedef std::int32_t IntVector __attribute__((vector_size(GYRO_DEBLUR_VECTOR_BYTES)));

inline Vector load(const float* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline IntVector load(const std::int32_t* from) {
  IntVector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
inline void store(float* to, Vector v) { std::memcpy(to, &v, sizeof v); }

}  // namespace
}  // namespace GYRO_DEBLUR_ISA
}  // namespace gyro_deblur
