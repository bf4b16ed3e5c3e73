#include "float_copy.hpp"

#define FloatEngine FloatEngineAvx2
#include "engine/float/float_engine.cpp"

namespace gyro_deblur::benchmark {

std::unique_ptr<Engine> make_float_avx2(int threads) { return std::make_unique<FloatEngine>(threads); }

}  // namespace gyro_deblur::benchmark
