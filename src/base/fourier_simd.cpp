#include "base/fourier_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const FourierSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kFourierSimd, &avx2::kFourierSimd,
#endif
    &baseline::kFourierSimd};

}  // namespace

const FourierSimd& best_fourier_simd() { return select_for_cpu(kSets); }

const FourierSimd* find_fourier_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
