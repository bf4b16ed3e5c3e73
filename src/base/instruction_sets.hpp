// SIMD kernels: loops that are compiled once per instruction set; which variant runs here.
//
// The kernels of one task are a struct of function pointers, whose first member is `const char* name`. X_simd.hpp
// declares it, with GYRO_DEBLUR_SIMD_KERNELS behind it. X_simd_impl.hpp has the functions, and
// gyro_deblur_compile_for_instruction_sets() of cmake/layers.cmake compiles it for every instruction set.
#pragma once

#include <cstring>

namespace gyro_deblur {

/// Whether this processor runs what is compiled for "baseline" (SSE2, or NEON on 64-bit ARM), "avx2", "avx512" or
/// "dotprod" (ARMv8.2 with SDOT, Linux); false for any other name.
bool runs_instruction_set(const char* name);

/// kWidestFirst: the variants of `Kernels`. The last one is "baseline", which every processor runs.
template <typename Kernels>
struct SimdVariants;

// No functions: headers of kernels are compiled for AVX-512, too, and the linker may keep that copy of an inline one.
#define GYRO_DEBLUR_SIMD_VARIANT(Kernels, set) \
  namespace set {                              \
  extern const Kernels k##Kernels;             \
  }
#if defined(__x86_64__)
#define GYRO_DEBLUR_WIDER_VARIANTS(Kernels) \
  GYRO_DEBLUR_SIMD_VARIANT(Kernels, avx2)   \
  GYRO_DEBLUR_SIMD_VARIANT(Kernels, avx512)
#define GYRO_DEBLUR_WIDEST_FIRST(Kernels) &avx512::k##Kernels, &avx2::k##Kernels, &baseline::k##Kernels
#elif defined(__aarch64__) && defined(__linux__)
#define GYRO_DEBLUR_WIDER_VARIANTS(Kernels) GYRO_DEBLUR_SIMD_VARIANT(Kernels, dotprod)
#define GYRO_DEBLUR_WIDEST_FIRST(Kernels) &dotprod::k##Kernels, &baseline::k##Kernels
#else
#define GYRO_DEBLUR_WIDER_VARIANTS(Kernels)
#define GYRO_DEBLUR_WIDEST_FIRST(Kernels) &baseline::k##Kernels
#endif
#define GYRO_DEBLUR_SIMD_KERNELS(Kernels)                                                 \
  GYRO_DEBLUR_SIMD_VARIANT(Kernels, baseline)                                             \
  GYRO_DEBLUR_WIDER_VARIANTS(Kernels)                                                     \
  template <>                                                                             \
  struct SimdVariants<Kernels> {                                                          \
    static constexpr const Kernels* kWidestFirst[] = {GYRO_DEBLUR_WIDEST_FIRST(Kernels)}; \
  };

/// The variant for the widest instruction set that this processor runs.
template <typename Kernels>
const Kernels& select_for_cpu() {
  const Kernels* selected = nullptr;
  for (const Kernels* variant : SimdVariants<Kernels>::kWidestFirst) {
    selected = variant;
    if (runs_instruction_set(variant->name)) break;
  }
  return *selected;
}

/// The variant of this name; null when this build does not have it, or this processor does not run it.
template <typename Kernels>
const Kernels* find_for_cpu(const char* name) {
  for (const Kernels* variant : SimdVariants<Kernels>::kWidestFirst) {
    if (std::strcmp(variant->name, name) == 0) return runs_instruction_set(name) ? variant : nullptr;
  }
  return nullptr;
}

}  // namespace gyro_deblur
