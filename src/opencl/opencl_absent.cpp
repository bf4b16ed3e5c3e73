// Stands in for the OpenCL engine where it was not built.
#include "core/fallback_convolver.hpp"
#include "opencl/opencl_factory.hpp"

namespace gyro_deblur {

bool opencl_gpu_present() { return false; }

std::unique_ptr<LineConvolver> make_opencl_convolver(const std::string&, int) {
  throw DeviceError("gyro_deblur was built without OpenCL");
}

}  // namespace gyro_deblur
