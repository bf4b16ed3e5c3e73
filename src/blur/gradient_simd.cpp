#include "blur/gradient_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const GradientSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kGradientSimd, &avx2::kGradientSimd,
#endif
    &baseline::kGradientSimd};

}  // namespace

const GradientSimd& best_gradient_simd() { return select_for_cpu(kSets); }

const GradientSimd* find_gradient_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
