// The inner loops as a table, once per instruction set (see base/vectors_impl.hpp).
#include "engine/cpu/exact_taps_impl.hpp"
#include "engine/cpu/two_scale_impl.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {

extern const BlockSimd kBlockSimd;
const BlockSimd kBlockSimd = {GYRO_DEBLUR_ISA_NAME,
                              kLanes,
                              kHasByteWeights,
                              exact_needs,
                              exact_u8,
                              two_scale_needs<std::uint8_t>,
                              two_scale_needs<std::uint16_t>,
                              two_scale<std::uint8_t>,
                              two_scale<std::uint16_t>};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
