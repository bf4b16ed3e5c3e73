// Loops that are compiled once per instruction set (cmake/layers.cmake, base/vectors_impl.hpp): which copy runs here.
#pragma once

#include <cstring>

namespace gyro_deblur {

/// Whether this processor runs what is compiled for "baseline", "avx2" or "avx512"; false for any other name.
bool runs_instruction_set(const char* name);

/// Of a table of copies, widest first, each with the `name` of its instruction set, the first that this processor runs.
/// The last one is "baseline", which all run.
template <typename Copy, int kCount>
const Copy& select_for_cpu(const Copy* const (&copies)[kCount]) {
  for (const Copy* copy : copies) {
    if (runs_instruction_set(copy->name)) return *copy;
  }
  return *copies[kCount - 1];
}

/// Of a table of copies, each with the `name` of its instruction set, the one of that name; null when it is not there
/// or this processor does not run it.
template <typename Copy, int kCount>
const Copy* find_for_cpu(const Copy* const (&copies)[kCount], const char* name) {
  for (const Copy* copy : copies) {
    if (std::strcmp(copy->name, name) == 0) return runs_instruction_set(name) ? copy : nullptr;
  }
  return nullptr;
}

}  // namespace gyro_deblur
