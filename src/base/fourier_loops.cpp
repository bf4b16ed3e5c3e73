#include "base/fourier_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const FourierLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kFourierLoops, &avx2::kFourierLoops,
#endif
    &baseline::kFourierLoops};

}  // namespace

const FourierLoops& best_fourier_loops() { return best_copy(kSets); }

const FourierLoops* find_fourier_loops(const char* name) { return find_copy(kSets, name); }

}  // namespace gyro_deblur
