// Replaces the OpenCL engine where it was not built.
#include "engine/fallback_engine.hpp"
#include "engine/opencl/opencl_engine.hpp"

namespace gyro_deblur {

std::unique_ptr<Engine> make_opencl_engine(const std::string&, int, bool) {
  throw DeviceError("gyro_deblur was built without OpenCL");
}

}  // namespace gyro_deblur
