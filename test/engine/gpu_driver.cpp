// An OpenCL driver that announces a GPU, of which it can do nothing: for tests on computers without one.
#include <cstring>
#include <string>

#include <CL/cl.h>
#include <CL/cl_icd.h>

// The loader calls through the table that every object begins with.
struct _cl_platform_id {
  const cl_icd_dispatch* dispatch;
};
struct _cl_device_id {
  const cl_icd_dispatch* dispatch;
};

namespace {

_cl_platform_id& platform();
_cl_device_id& device();

template <typename T>
cl_int answer(const T* values, size_t bytes, size_t capacity, void* to, size_t* needed) {
  if (needed != nullptr) *needed = bytes;
  if (to == nullptr) return CL_SUCCESS;
  if (capacity < bytes) return CL_INVALID_VALUE;
  std::memcpy(to, values, bytes);
  return CL_SUCCESS;
}

cl_int answer(const std::string& text, size_t capacity, void* to, size_t* needed) {
  return answer(text.c_str(), text.size() + 1, capacity, to, needed);
}

cl_int CL_API_CALL get_platforms(cl_uint capacity, cl_platform_id* platforms, cl_uint* count) {
  if (count != nullptr) *count = 1;
  if (platforms != nullptr && capacity > 0) *platforms = &platform();
  return CL_SUCCESS;
}

cl_int CL_API_CALL get_platform_info(cl_platform_id, cl_platform_info what, size_t capacity, void* to, size_t* needed) {
  switch (what) {
    case CL_PLATFORM_EXTENSIONS:
      return answer("cl_khr_icd", capacity, to, needed);
    case CL_PLATFORM_ICD_SUFFIX_KHR:
      return answer("TEST", capacity, to, needed);
    case CL_PLATFORM_VERSION:
      return answer("OpenCL 1.2", capacity, to, needed);
    default:
      return answer("test", capacity, to, needed);
  }
}

cl_int CL_API_CALL get_devices(cl_platform_id, cl_device_type, cl_uint capacity, cl_device_id* devices,
                               cl_uint* count) {
  if (count != nullptr) *count = 1;
  if (devices != nullptr && capacity > 0) *devices = &device();
  return CL_SUCCESS;
}

cl_int CL_API_CALL get_device_info(cl_device_id, cl_device_info what, size_t capacity, void* to, size_t* needed) {
  if (what == CL_DEVICE_NAME) return answer("a GPU", capacity, to, needed);
  if (what == CL_DEVICE_PLATFORM) {
    const cl_platform_id its_platform = &platform();
    return answer(&its_platform, sizeof(its_platform), capacity, to, needed);
  }
  if (what != CL_DEVICE_TYPE) return CL_INVALID_VALUE;
  const cl_device_type type = CL_DEVICE_TYPE_GPU;
  return answer(&type, sizeof(type), capacity, to, needed);
}

cl_int CL_API_CALL count_reference(cl_device_id) { return CL_SUCCESS; }

cl_context CL_API_CALL create_context(const cl_context_properties*, cl_uint, const cl_device_id*,
                                      void(CL_CALLBACK*)(const char*, const void*, size_t, void*), void*,
                                      cl_int* error) {
  if (error != nullptr) *error = CL_DEVICE_NOT_AVAILABLE;
  return nullptr;
}

const cl_icd_dispatch& table() {
  static const cl_icd_dispatch kTable = [] {
    cl_icd_dispatch functions{};
    functions.clGetPlatformIDs = get_platforms;
    functions.clGetPlatformInfo = get_platform_info;
    functions.clGetDeviceIDs = get_devices;
    functions.clGetDeviceInfo = get_device_info;
    functions.clRetainDevice = functions.clReleaseDevice = count_reference;
    functions.clCreateContext = create_context;
    return functions;
  }();
  return kTable;
}

_cl_platform_id& platform() {
  static _cl_platform_id the_platform{&table()};
  return the_platform;
}

_cl_device_id& device() {
  static _cl_device_id the_device{&table()};
  return the_device;
}

}  // namespace

extern "C" {

cl_int CL_API_CALL clGetPlatformInfo(cl_platform_id id, cl_platform_info what, size_t capacity, void* to,
                                     size_t* needed) {
  return get_platform_info(id, what, capacity, to, needed);
}

void* CL_API_CALL clGetExtensionFunctionAddress(const char* name) {
  if (std::strcmp(name, "clIcdGetPlatformIDsKHR") == 0) return reinterpret_cast<void*>(get_platforms);
  if (std::strcmp(name, "clGetPlatformInfo") == 0) return reinterpret_cast<void*>(get_platform_info);
  return nullptr;
}

}  // extern "C"
