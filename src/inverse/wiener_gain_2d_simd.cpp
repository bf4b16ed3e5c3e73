#include "inverse/wiener_gain_2d_simd.hpp"

#include "base/instruction_sets.hpp"

namespace gyro_deblur {
namespace {

/// Widest first.
const WienerGain2dSimd* const kSets[] = {
#if defined(__x86_64__)
    &avx512::kWienerGain2dSimd, &avx2::kWienerGain2dSimd,
#endif
    &baseline::kWienerGain2dSimd};

}  // namespace

const WienerGain2dSimd* find_wiener_gain_2d_simd(const char* name) { return find_for_cpu(kSets, name); }

}  // namespace gyro_deblur
