#include "reference_copy.hpp"

#define ReferenceConvolver ReferenceConvolverAvx2
#include "cpu/reference_convolver.cpp"

namespace gyro_deblur::benchmark {

std::unique_ptr<LineConvolver> make_reference_avx2(int threads) {
  return std::make_unique<ReferenceConvolver>(threads);
}

}  // namespace gyro_deblur::benchmark
