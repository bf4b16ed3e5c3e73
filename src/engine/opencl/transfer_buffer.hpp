// Memory that an OpenCL device and the host use alternately.
#pragma once

#include <cstddef>
#include <utility>

#include "engine/opencl/opencl_api.hpp"

namespace gyro_deblur {

/// Device memory that grows to the largest size asked for. With shared memory the host maps it; otherwise it goes
/// through pinned memory that stays mapped.
class TransferBuffer {
 public:
  TransferBuffer(cl::Context context, cl::CommandQueue queue, bool shared_memory)
      : context_(std::move(context)), queue_(std::move(queue)), shared_memory_(shared_memory) {}
  ~TransferBuffer() { release(); }
  TransferBuffer(const TransferBuffer&) = delete;
  TransferBuffer& operator=(const TransferBuffer&) = delete;

  const cl::Buffer& device() const { return device_; }

  void reserve(std::size_t bytes) {
    if (bytes <= capacity_) return;
    release();
    device_ = cl::Buffer(context_, CL_MEM_READ_WRITE | (shared_memory_ ? CL_MEM_ALLOC_HOST_PTR : 0), bytes);
    if (!shared_memory_) {
      pinned_ = cl::Buffer(context_, CL_MEM_READ_WRITE | CL_MEM_ALLOC_HOST_PTR, bytes);
      host_ = queue_.enqueueMapBuffer(pinned_, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0, bytes);
    }
    capacity_ = bytes;
  }

  /// Has `fill(void*)` write `bytes` and takes them to the device.
  template <typename Fill>
  void upload(std::size_t bytes, const Fill& fill) {
    reserve(bytes);
    if (shared_memory_) {
      void* host = queue_.enqueueMapBuffer(device_, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION, 0, bytes);
      fill(host);
      queue_.enqueueUnmapMemObject(device_, host);
    } else {
      fill(host_);
      queue_.enqueueWriteBuffer(device_, CL_FALSE, 0, bytes, host_);
    }
  }

  /// Waits for the device and has `read(void*)` take `bytes`.
  template <typename Read>
  void download(std::size_t bytes, const Read& read) {
    if (shared_memory_) {
      void* host = queue_.enqueueMapBuffer(device_, CL_TRUE, CL_MAP_READ, 0, bytes);
      read(host);
      queue_.enqueueUnmapMemObject(device_, host);
    } else {
      queue_.enqueueReadBuffer(device_, CL_TRUE, 0, bytes, host_);
      read(host_);
    }
  }

 private:
  void release() noexcept {
    // Through the C interface: nothing can be done about an error here.
    if (host_ != nullptr) clEnqueueUnmapMemObject(queue_(), pinned_(), host_, 0, nullptr, nullptr);
    host_ = nullptr;
    pinned_ = device_ = cl::Buffer();
    capacity_ = 0;
  }

  cl::Context context_;
  cl::CommandQueue queue_;
  bool shared_memory_;
  cl::Buffer device_, pinned_;
  void* host_ = nullptr;  // of pinned_
  std::size_t capacity_ = 0;
};

}  // namespace gyro_deblur
