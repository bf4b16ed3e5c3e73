// Finds out which instruction set this processor has.
#include "base/instruction_sets.hpp"

#if defined(__aarch64__) && defined(__linux__)
#include <sys/auxv.h>
#endif

namespace gyro_deblur {

bool runs_instruction_set(const char* name) {
#if defined(__x86_64__)
  if (std::strcmp(name, "avx512") == 0) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
           __builtin_cpu_supports("avx512vnni") && __builtin_cpu_supports("avx512vbmi");
  }
  if (std::strcmp(name, "avx2") == 0) return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#elif defined(__aarch64__) && defined(__linux__)
  constexpr unsigned long kHasDotProduct = 1UL << 20;  // HWCAP_ASIMDDP, which old headers lack
  if (std::strcmp(name, "dotprod") == 0) return (getauxval(AT_HWCAP) & kHasDotProduct) != 0;
#endif
  return std::strcmp(name, "baseline") == 0;
}

}  // namespace gyro_deblur
