#include "engine/cpu/block_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const BlockSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kKernels, &avx2::kKernels,
#endif
    &baseline::kKernels};

}  // namespace

const BlockSimd& best_block_simd() { return select_for_cpu(kSets); }

const BlockSimd* find_block_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
