// Loses 100 blocks in a parallel loop, on purpose: scripts/extended_tests.sh wants to hear of them.
#include <cstddef>
#include <cstdlib>

#include "base/parallel.hpp"

int main() {
  constexpr int kBlocks = 100, kThreads = 4;
  constexpr std::size_t kBytes = 64;
  // Kept from the compiler, which would see that nobody needs them.
  static void* volatile newest = nullptr;
  const gyro_deblur::EagerHelpers on_all_threads;
  gyro_deblur::parallel_for(kBlocks, kThreads, 1, [](int) { newest = std::malloc(kBytes); });
  newest = nullptr;
  return 0;
}
