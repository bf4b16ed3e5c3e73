// How the kernel shares a core among threads.
#pragma once

#include <cstdint>
#include <optional>

namespace gyro_deblur {

/// For a thread that works for some milliseconds a frame and sleeps otherwise: asks the kernel to let the calling
/// thread work on a frame in one time slice, where another process wants the core as well. A slice that ends in the
/// middle of a frame costs at least a tick, 4 ms at 250 Hz; the thread's share of the core remains the same. Linux 6.12
/// and newer; without effect elsewhere, and on threads with a real-time policy. Threads that this one starts are as
/// before.
void ask_for_time_slice_of_a_frame();

/// The kernel's struct sched_attr in its first form, see sched_setattr(2): its header and the C library's exclude each
/// other.
struct SchedulingAttributes {
  std::uint32_t size = sizeof(SchedulingAttributes);
  std::uint32_t policy = 0;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime_ns = 0;  ///< of SCHED_OTHER: the length of a time slice; 0: the kernel knows none
  std::uint64_t deadline_ns = 0, period_ns = 0;
};

/// Attributes of the calling thread; nothing where the kernel does not report them.
std::optional<SchedulingAttributes> scheduling_attributes();

}  // namespace gyro_deblur
