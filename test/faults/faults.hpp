// Faults between a recording and the processor.
#pragma once

#include <cstdint>
#include <vector>

#include "recording.hpp"

namespace gyro_deblur::test {

/// What may happen to single messages.
enum class Fault { DROP, DELAY, DUPLICATE, REORDER, CORRUPT, TIME_JUMP };
constexpr Fault kFaults[] = {Fault::DROP,    Fault::DELAY,   Fault::DUPLICATE,
                             Fault::REORDER, Fault::CORRUPT, Fault::TIME_JUMP};

const char* to_string(Fault fault);

/// Does `fault` to each message of a stream with probability `rate` (in [0, 1]); the same for the same seed.
/// DELAY: by up to a second. REORDER: behind the next two of its stream. CORRUPT: values that are not finite,
/// saturated, out of range or contradict each other. TIME_JUMP: the stamp is off by 1 to 100 s, either way.
std::vector<Delivery> inject(const std::vector<Delivery>& deliveries, Stream stream, Fault fault, double rate,
                             std::uint64_t seed);

/// Without the messages of `stream` that arrive in [from_ns, to_ns).
std::vector<Delivery> silence(const std::vector<Delivery>& deliveries, Stream stream, TimeNs from_ns, TimeNs to_ns);

/// Of `stream`, only every `period`th message (>= 1), from the first on.
std::vector<Delivery> thin_out(const std::vector<Delivery>& deliveries, Stream stream, std::size_t period);

/// Every `period`th message (>= 1) of `stream`, from the `first` on, has the stamp 0.
std::vector<Delivery> unset_stamps(const std::vector<Delivery>& deliveries, Stream stream, std::size_t period,
                                   std::size_t first = 0);

/// Messages of `stream` arrive in batches: each when the newest of its `batch_ns` (> 0) has come.
std::vector<Delivery> in_batches(const std::vector<Delivery>& deliveries, Stream stream, TimeNs batch_ns);

/// The clock of the whole machine is set by `step_ns` at `from_ns`: stamps and the node's clock.
std::vector<Delivery> step_clock(const std::vector<Delivery>& deliveries, TimeNs from_ns, TimeNs step_ns);

/// A gyroscope that can measure up to `range_rad_s` (> 0) on each axis, and says that where there is more.
std::vector<Delivery> clip_gyro(const std::vector<Delivery>& deliveries, double range_rad_s);

/// Every `period`th image (>= 2) shows the picture of the one before, under its own stamp.
std::vector<Delivery> repeat_pictures(const std::vector<Delivery>& deliveries, std::size_t period);

/// Images that arrive in [from_ns, to_ns) show the picture of the one before them: the camera's buffer is not written.
std::vector<Delivery> freeze(const std::vector<Delivery>& deliveries, TimeNs from_ns, TimeNs to_ns);
/// Rates of the gyroscope are multiplied: by 180 / pi they are in degrees/s, by 0 those of an accelerometer's topic.
std::vector<Delivery> scale_rates(const std::vector<Delivery>& deliveries, double factor);

/// The clock that stamps `stream` differs from all others by `by_ns`.
std::vector<Delivery> shift_clock(const std::vector<Delivery>& deliveries, Stream stream, TimeNs by_ns);

/// The first `count` exposure messages have `exposure_ns`.
std::vector<Delivery> set_exposures(const std::vector<Delivery>& deliveries, TimeNs exposure_ns, std::size_t count);

/// `action` every `period_ns`.
std::vector<Delivery> with_action(const std::vector<Delivery>& deliveries, TimeNs period_ns, const Action& action);

/// Images change their encoding every `period` frames: grey of 8 and 16 bits, four colour orders, a Bayer mosaic, YUV,
/// and one that cannot be deblurred.
std::vector<Delivery> change_encodings(const std::vector<Delivery>& deliveries, std::size_t period);

/// Images, and their camera_info, are cut to another size every `period` frames.
std::vector<Delivery> change_sizes(const std::vector<Delivery>& deliveries, std::size_t period);

}  // namespace gyro_deblur::test
