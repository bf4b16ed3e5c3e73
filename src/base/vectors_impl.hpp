// Vectors of one instruction set and their operations, for the bodies of SIMD kernels. Such a body is an *_impl.hpp,
// included by one source file per set, each of which is compiled with its own flags and defines GYRO_DEBLUR_ISA (a
// namespace), GYRO_DEBLUR_ISA_NAME and GYRO_DEBLUR_VECTOR_BYTES. Everything in it has internal linkage and nothing
// comes from the standard library's templates: a shared inline function compiled for AVX-512 could otherwise be the
// copy that the linker keeps for every processor.
//
// Bodies call operations and know no architecture. vectors_generic_impl.hpp says what each does; those of an
// architecture give the same bits, except for reciprocal(). What some sets alone have is announced by
// GYRO_DEBLUR_HAS_BYTE_PRODUCTS and GYRO_DEBLUR_HAS_WORD_VECTORS, described in vectors_x86_impl.hpp, and by
// GYRO_DEBLUR_HAS_BYTE_PAIRS, in vectors_neon_impl.hpp: a body has another algorithm without.
#pragma once

#if defined(__SSE2__)
#include "base/vectors_x86_impl.hpp"
#elif defined(__aarch64__)
#include "base/vectors_neon_impl.hpp"
#else
#include "base/vectors_generic_impl.hpp"
namespace gyro_deblur::GYRO_DEBLUR_ISA {
using namespace generic;
}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
#endif
