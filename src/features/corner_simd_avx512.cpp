#define GYRO_DEBLUR_ISA avx512
#define GYRO_DEBLUR_ISA_NAME "avx512"
#define GYRO_DEBLUR_VECTOR_BYTES 64
#include "features/corner_simd_impl.hpp"
