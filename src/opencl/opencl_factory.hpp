// The OpenCL engine for those who need not know whether it was built.
#pragma once

#include <memory>
#include <string>

#include "gyro_deblur/deconvolution.hpp"

namespace gyro_deblur {

/// False also when the library was built without OpenCL.
bool opencl_gpu_present();

/// @param device, threads  see OpenClConvolver
/// Throws DeviceError when there is no such device, it cannot be used, or the library was built without OpenCL.
std::unique_ptr<LineConvolver> make_opencl_convolver(const std::string& device, int threads);

}  // namespace gyro_deblur
