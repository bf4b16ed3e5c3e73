#include "blur/gradient_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const GradientLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kGradientLoops, &avx2::kGradientLoops,
#endif
    &baseline::kGradientLoops};

}  // namespace

const GradientLoops& best_gradient_loops() { return best_copy(kSets); }

const GradientLoops* find_gradient_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
