#include "engine/cpu/block_kernels.hpp"

#include <cstring>
#include <initializer_list>

namespace gyro_deblur {
namespace {

#if defined(__x86_64__)
bool runs_avx2() { return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"); }
bool runs_avx512() {
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vnni") &&
         __builtin_cpu_supports("avx512vbmi");
}
#endif

}  // namespace

const BlockKernels& best_block_kernels() {
  for (const char* name : {"avx512", "avx2"}) {
    if (const BlockKernels* kernels = find_block_kernels(name)) return *kernels;
  }
  return baseline::kKernels;
}

const BlockKernels* find_block_kernels(const char* name) {
#if defined(__x86_64__)
  if (std::strcmp(name, "avx512") == 0) return runs_avx512() ? &avx512::kKernels : nullptr;
  if (std::strcmp(name, "avx2") == 0) return runs_avx2() ? &avx2::kKernels : nullptr;
#endif
  return std::strcmp(name, "baseline") == 0 ? &baseline::kKernels : nullptr;
}

}  // namespace gyro_deblur
