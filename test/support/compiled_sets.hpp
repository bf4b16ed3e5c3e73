// Which instruction sets the SIMD kernels are compiled for here.
#pragma once

namespace gyro_deblur::test {

/// All of them, narrowest first.
#if defined(__x86_64__)
constexpr const char* kInstructionSets[] = {"baseline", "avx2", "avx512"};
#elif defined(__aarch64__) && defined(__linux__)
constexpr const char* kInstructionSets[] = {"baseline", "dotprod"};
#else
constexpr const char* kInstructionSets[] = {"baseline"};
#endif

}  // namespace gyro_deblur::test
