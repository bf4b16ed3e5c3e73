// How much memory this process has.
#pragma once

#include <unistd.h>

#include <fstream>

namespace gyro_deblur::test {

/// Resident memory [MiB], as Linux counts it; 0 elsewhere.
inline double process_memory_mib() {
  std::ifstream file("/proc/self/statm");
  double total_pages = 0, resident_pages = 0;
  file >> total_pages >> resident_pages;
  return resident_pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1024 * 1024);
}

}  // namespace gyro_deblur::test
