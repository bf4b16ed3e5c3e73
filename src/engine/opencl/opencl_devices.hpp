// OpenCL devices: which there are, and what goes wrong with them.
#pragma once

#include <string>

#include "engine/fallback_engine.hpp"
#include "engine/opencl/opencl_api.hpp"

namespace gyro_deblur {

/// @param wanted  an index into opencl_devices(), a part of a name there in any case, or empty: the first GPU, else the
///                first device
/// Throws DeviceError that lists the devices when there is no such one.
cl::Device choose_opencl_device(const std::string& wanted);

/// The same error as the fallback takes it.
DeviceError device_error(const cl::Error& error);

}  // namespace gyro_deblur
