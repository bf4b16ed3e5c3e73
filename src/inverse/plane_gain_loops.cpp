#include "inverse/plane_gain_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const PlaneGainLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kPlaneGainLoops, &avx2::kPlaneGainLoops,
#endif
    &baseline::kPlaneGainLoops};

}  // namespace

const PlaneGainLoops* find_plane_gain_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
