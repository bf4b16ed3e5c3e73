#define GYRO_DEBLUR_ISA avx2
#define GYRO_DEBLUR_ISA_NAME "avx2"
#define GYRO_DEBLUR_VECTOR_BYTES 32
#include "inverse/tap_simd_impl.hpp"
