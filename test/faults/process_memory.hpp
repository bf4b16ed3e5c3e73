// How much memory this process has.
#pragma once

#include <unistd.h>

#include <fstream>

// Sanitizers keep what has been freed, to see who still uses it.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define GYRO_DEBLUR_FREED_IS_KEPT 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define GYRO_DEBLUR_FREED_IS_KEPT 1
#endif
#endif

namespace gyro_deblur::test {

/// Resident memory [MiB], as Linux counts it; 0 elsewhere, and where it says nothing, under sanitizers.
inline double process_memory_mib() {
#ifdef GYRO_DEBLUR_FREED_IS_KEPT
  return 0;
#endif
  std::ifstream file("/proc/self/statm");
  double total_pages = 0, resident_pages = 0;
  file >> total_pages >> resident_pages;
  return resident_pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1024 * 1024);
}

}  // namespace gyro_deblur::test
