// The OpenCL engine.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "engine/block_engine.hpp"

namespace gyro_deblur {

/// "PLATFORM: DEVICE" of every OpenCL device, in the order of their indices.
std::vector<std::string> opencl_devices();

/// Where the time of the latest frame went [ms]. Device and host work at the same time, so that the parts add up to
/// more than the whole.
struct OpenClTimes {
  // Times of the device, by profiling events. Where device and host share memory, upload and download are mapping
  // alone.
  double upload_ms = 0;
  double kernel_ms = 0;
  double download_ms = 0;
  // Times of the host.
  double plan_ms = 0;   ///< making taps and tiles
  double fill_ms = 0;   ///< writing what is uploaded, and starting the device
  double wait_ms = 0;   ///< for the device's results
  double store_ms = 0;  ///< copying them to where blocks are blended
};

/// The kind of device that the kernels are compiled for.
enum class OpenClTuning {
  DEVICE,  ///< by the device's type
  CPU,     ///< explicit vectors, one work-item a work-group, input through the caches, shared memory
  GPU      ///< one column a work-item, input staged in local memory, transfers from and to pinned memory
};

/// Sums the non-zero taps of each block's rotated kernel in float, one work-group for each tile of a block. Buffers,
/// queue and programs are kept between frames. Needs OpenCL 1.2 and, tuned for a GPU, work-groups of 256 work-items
/// with 25 KiB of local memory.
class OpenClEngine : public BlockEngine {
 public:
  using BlockEngine::BlockEngine;

  virtual const OpenClTimes& last_times() const = 0;
};

/// The engine, of which name() is "opencl (DEVICE)".
/// @param device   an index into opencl_devices(), a part of a name there in any case, or empty: the first GPU, else
///                 the first device
/// @param threads  that prepare the taps at most, >= 0; 0: one for each core, see parallel_for_ranges
/// Throws DeviceError when there is no such device, it cannot build the program, or the library was built without
/// OpenCL. filter() throws DeviceError when the device fails; dst is undefined then.
std::unique_ptr<OpenClEngine> make_opencl_engine(const std::string& device, int threads,
                                                 OpenClTuning tuning = OpenClTuning::DEVICE);

}  // namespace gyro_deblur
