#include "features/corner_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const CornerSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kCornerSimd, &avx2::kCornerSimd,
#endif
    &baseline::kCornerSimd};

}  // namespace

const CornerSimd& best_corner_simd() { return select_for_cpu(kSets); }

const CornerSimd* find_corner_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
