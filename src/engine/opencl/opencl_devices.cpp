// Lists the OpenCL devices and chooses one.
#include "engine/opencl/opencl_devices.hpp"

#include <algorithm>
#include <cctype>
#include <vector>

#include "engine/opencl/opencl_engine.hpp"

namespace gyro_deblur {
namespace {

std::string lower_case(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

struct NamedDevice {
  cl::Device device;
  std::string name;  // "PLATFORM: DEVICE"
  bool is_gpu;
};

/// All devices of all platforms; a platform that fails has none.
std::vector<NamedDevice> all_devices() {
  std::vector<NamedDevice> all;
  std::vector<cl::Platform> platforms;
  try {
    cl::Platform::get(&platforms);
  } catch (const cl::Error&) {
    return all;  // the loader's way to say that there are none
  }
  for (const cl::Platform& platform : platforms) {
    try {
      std::vector<cl::Device> devices;
      platform.getDevices(CL_DEVICE_TYPE_ALL, &devices);
      const std::string prefix = platform.getInfo<CL_PLATFORM_NAME>() + ": ";
      for (const cl::Device& device : devices) {
        const bool is_gpu = (device.getInfo<CL_DEVICE_TYPE>() & CL_DEVICE_TYPE_GPU) != 0;
        all.push_back({device, prefix + device.getInfo<CL_DEVICE_NAME>(), is_gpu});
      }
    } catch (const cl::Error&) {
      continue;
    }
  }
  return all;
}

}  // namespace

cl::Device choose_opencl_device(const std::string& wanted) {
  const std::vector<NamedDevice> all = all_devices();
  if (all.empty()) throw DeviceError("there is no OpenCL device");
  const bool is_index = std::all_of(wanted.begin(), wanted.end(), [](unsigned char c) { return std::isdigit(c); });
  if (wanted.empty()) {
    for (const NamedDevice& candidate : all) {
      if (candidate.is_gpu) return candidate.device;
    }
    return all.front().device;
  }
  std::string names;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (is_index ? wanted == std::to_string(i)
                 : lower_case(all[i].name).find(lower_case(wanted)) != std::string::npos) {
      return all[i].device;
    }
    names += (i == 0 ? "" : ", ") + std::to_string(i) + " = \"" + all[i].name + "\"";
  }
  throw DeviceError("no OpenCL device \"" + wanted + "\"; there is " + names);
}

DeviceError device_error(const cl::Error& error) {
  return DeviceError(std::string(error.what()) + " returned " + std::to_string(error.err()));
}

std::vector<std::string> opencl_devices() {
  std::vector<std::string> names;
  for (const NamedDevice& found : all_devices()) names.push_back(found.name);
  return names;
}

}  // namespace gyro_deblur
