#include "features/alignment_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const AlignmentLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kAlignmentLoops, &avx2::kAlignmentLoops,
#endif
    &baseline::kAlignmentLoops};

}  // namespace

const AlignmentLoops& best_alignment_loops() { return best_copy(kSets); }

const AlignmentLoops* find_alignment_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
