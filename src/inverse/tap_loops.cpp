#include "inverse/tap_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const TapLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kTapLoops, &avx2::kTapLoops,
#endif
    &baseline::kTapLoops};

}  // namespace

const TapLoops& best_tap_loops() { return best_copy(kSets); }

const TapLoops* find_tap_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
