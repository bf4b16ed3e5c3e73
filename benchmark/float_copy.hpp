// The float engine compiled for one instruction set, so that it can be compared with the cpu engine held to
// the same set on a processor that has more.
#pragma once

#include <memory>

#include "engine/engine.hpp"

namespace gyro_deblur::benchmark {

std::unique_ptr<Engine> make_float_avx2(int threads);
std::unique_ptr<Engine> make_float_avx512(int threads);

}  // namespace gyro_deblur::benchmark
