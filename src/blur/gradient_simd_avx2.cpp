#define GYRO_DEBLUR_ISA avx2
#define GYRO_DEBLUR_ISA_NAME "avx2"
#define GYRO_DEBLUR_VECTOR_BYTES 32
#include "blur/gradient_simd_impl.hpp"
