// Asks Linux for longer time slices.
#include "base/time_slice.hpp"

#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

namespace gyro_deblur {

std::optional<SchedulingAttributes> scheduling_attributes() {
  SchedulingAttributes attributes;
  if (syscall(SYS_sched_getattr, 0, &attributes, sizeof(attributes), 0) != 0) return std::nullopt;
  return attributes;
}

void ask_for_time_slice_of_a_frame() {
  // See "EEVDF Scheduler" in the kernel's documentation, and doc/reports/contention.md.
  constexpr std::uint64_t kTimeSliceNs = 3'000'000;
  constexpr std::uint64_t kResetOnFork = 1;  // SCHED_FLAG_RESET_ON_FORK
  std::optional<SchedulingAttributes> attributes = scheduling_attributes();
  if (!attributes || (attributes->policy != SCHED_OTHER && attributes->policy != SCHED_BATCH)) return;
  attributes->runtime_ns = kTimeSliceNs;
  // Libraries of others start threads from this one and keep them for the whole process. From those with a negative
  // nice value the flag would take that too.
  if (attributes->nice >= 0) attributes->flags |= kResetOnFork;
  // Where it is refused, all is as it was.
  (void)syscall(SYS_sched_setattr, 0, &*attributes, 0);
}

}  // namespace gyro_deblur
