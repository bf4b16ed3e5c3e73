#define GYRO_DEBLUR_ISA baseline
#define GYRO_DEBLUR_ISA_NAME "baseline"
#define GYRO_DEBLUR_VECTOR_BYTES 16
#include "base/fourier_simd_impl.hpp"
