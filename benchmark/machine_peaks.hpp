// What the processor can do at best: the roofs of a roofline.
#pragma once

#include <string>
#include <vector>

namespace gyro_deblur::benchmark {

/// Multiply-adds per second of one instruction set, all operands in registers.
struct ArithmeticPeak {
  std::string instruction_set;  ///< as in find_for_cpu<BlockSimd>
  double float_gmac_per_s = 0;
  double int16_gmac_per_s = 0;  ///< pairwise products of int16 summed into int32
};

/// Read bandwidth of a working set that fits a level of the memory hierarchy.
struct BandwidthPeak {
  std::string level;
  std::size_t bytes_per_thread = 0;
  double gb_per_s = 0;
};

/// Measured on `threads` threads at once; the best of several tries. Empty on processors other than x86-64 with AVX2.
std::vector<ArithmeticPeak> measure_arithmetic(int threads);
std::vector<BandwidthPeak> measure_bandwidth(int threads);

}  // namespace gyro_deblur::benchmark
