// How much an engine computes and reads: the other axis of a roofline.
#pragma once

#include <string>
#include <vector>

#include "engine/engine.hpp"
#include "pipeline/deconvolution.hpp"

namespace gyro_deblur::benchmark {

/// Of one CV_8UC1 image, the margins of blocks included and their blending left out. Loads that reach the load ports,
/// whatever level they come from; stores are left out.
struct Work {
  double float_macs = 0;  ///< multiply-adds, and additions and multiplications that stand alone
  double int16_macs = 0;
  double load_bytes = 0;
};

/// Work of the float engine.
Work work_of_float(const FilterGrid& grid);

/// Work of the cpu engine. Follows the loops of src/engine/cpu/*_impl.hpp with vectors of `lanes` floats.
Work work_of_cpu(const FilterGrid& grid, int lanes);

}  // namespace gyro_deblur::benchmark
