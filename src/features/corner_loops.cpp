#include "features/corner_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const CornerLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kCornerLoops, &avx2::kCornerLoops,
#endif
    &baseline::kCornerLoops};

}  // namespace

const CornerLoops& best_corner_loops() { return best_copy(kSets); }

const CornerLoops* find_corner_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
