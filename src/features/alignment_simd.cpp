#include "features/alignment_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const AlignmentSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kAlignmentSimd, &avx2::kAlignmentSimd,
#endif
    &baseline::kAlignmentSimd};

}  // namespace

const AlignmentSimd& best_alignment_simd() { return select_for_cpu(kSets); }

const AlignmentSimd* find_alignment_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
