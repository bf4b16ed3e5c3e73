#include "inverse/tap_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const TapSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kTapSimd, &avx2::kTapSimd,
#endif
    &baseline::kTapSimd};

}  // namespace

const TapSimd& best_tap_simd() { return select_for_cpu(kSets); }

const TapSimd* find_tap_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
