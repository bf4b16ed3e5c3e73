#define GYRO_DEBLUR_ISA baseline
#define GYRO_DEBLUR_ISA_NAME "baseline"
#define GYRO_DEBLUR_VECTOR_BYTES 16
#include "inverse/wiener_gain_2d_simd_impl.hpp"
