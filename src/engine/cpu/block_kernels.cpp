#include "engine/cpu/block_kernels.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const BlockKernels* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kKernels, &avx2::kKernels,
#endif
    &baseline::kKernels};

}  // namespace

const BlockKernels& best_block_kernels() { return best_copy(kSets); }

const BlockKernels* find_block_kernels(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
