// The OpenCL engine for those who need not know whether it was built.
#pragma once

#include <memory>
#include <string>

#include "engine/engine.hpp"

namespace gyro_deblur {

/// @param device, threads  see OpenClEngine
/// Throws DeviceError when there is no such device, it cannot be used, or the library was built without OpenCL.
std::unique_ptr<Engine> make_opencl_engine(const std::string& device, int threads);

}  // namespace gyro_deblur
