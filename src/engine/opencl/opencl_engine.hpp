// The OpenCL engine.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "engine/engine.hpp"

namespace gyro_deblur {

/// "PLATFORM: DEVICE" of every OpenCL device, in the order of their indices.
std::vector<std::string> opencl_devices();

/// An engine that sums the non-zero taps of each block's rotated kernel in float, one work-group for each tile of a
/// block. It keeps buffers, queue and programs between frames, and needs OpenCL 1.2 and work-groups of 256 work-items
/// with 25 KiB of local memory. Its name() is "opencl (DEVICE)".
/// @param device   an index into opencl_devices(), a part of a name there in any case, or empty: the first GPU, else
///                 the first device
/// @param threads  that prepare the taps at most, >= 0; 0: one for each core, see parallel_for_ranges
/// @param pinned   transfers go through pinned memory even where device and host share memory
/// Throws DeviceError when there is no such device, it cannot build the program, or the library was built without
/// OpenCL. filter() throws DeviceError when the device fails; dst is undefined then.
std::unique_ptr<Engine> make_opencl_engine(const std::string& device, int threads, bool pinned = false);

}  // namespace gyro_deblur
