#include "inverse/tap_loops.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

const TapLoops* find_tap_loops(const char* name) {
  static const TapLoops* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kTapLoops,
    &avx2::kTapLoops,
#endif
    &baseline::kTapLoops
  };
  return find_copy(kSets, name);
}

}  // namespace gyro_deblur
