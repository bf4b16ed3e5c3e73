// Compares the rotation rates of images and gyroscope.
#include "features/gyro_unit_watch.hpp"

namespace gyro_deblur {

void GyroUnitWatch::add(TimeNs t_ns, const ResidualRotation& seen) {
  if (!entries_.empty() && t_ns <= entries_.back().t_ns) entries_.clear();
  entries_.push_back({t_ns, seen});
  while (t_ns - entries_.front().t_ns > kWatchedNs) entries_.pop_front();
  // What rotates more slowly is seen with an error of as much.
  constexpr double kLeastRadS = 0.05;
  const double gyro_rad_s = seen.known_rad_s.norm(), seen_rad_s = seen.rate_rad_s.norm();
  if (gyro_rad_s > kLeastRadS && gyro_rad_s < 3 * seen_rad_s && seen_rad_s < 3 * gyro_rad_s) ++agreeing_;
}

void GyroUnitWatch::clear() {
  entries_.clear();
  agreeing_ = 0;
  begin_ns_.reset();
}

bool GyroUnitWatch::is_uncertain(TimeNs t_ns) {
  if (!begin_ns_ || t_ns < *begin_ns_) begin_ns_ = t_ns;
  return !is_confirmed() && t_ns - *begin_ns_ < kWatchedNs;
}

std::optional<GyroUnitFault> GyroUnitWatch::find(bool rates_are_zero) const {
  return rates_are_zero ? find_no_rates() : find_degrees();
}

std::optional<GyroUnitFault> GyroUnitWatch::find_degrees() const {
  // Around 180 / pi, as rates change between images and blurred corners are followed to some per cent. Edges of the
  // image that stand still, on which corners may be found instead, give far more.
  constexpr double kLeastRatio = 40, kLargestRatio = 80;
  constexpr double kLeastSeenRadS = kLeastGyroRadS / kLeastRatio;
  constexpr std::size_t kFewest = 5;
  std::size_t compared = 0, agreeing = 0;
  GyroUnitFault fault;
  for (const Entry& entry : entries_) {
    const double gyro_rad_s = entry.seen.known_rad_s.norm(), seen_rad_s = entry.seen.rate_rad_s.norm();
    if (gyro_rad_s < kLeastGyroRadS) continue;
    ++compared;
    if (seen_rad_s < kLeastSeenRadS || gyro_rad_s < kLeastRatio * seen_rad_s ||
        gyro_rad_s > kLargestRatio * seen_rad_s) {
      continue;
    }
    ++agreeing;
    if (gyro_rad_s > fault.gyro_rad_s) fault = {GyroUnitFault::Kind::DEGREES, gyro_rad_s, seen_rad_s};
  }
  if (agreeing < kFewest || 2 * agreeing < compared) return std::nullopt;
  return fault;
}

std::optional<GyroUnitFault> GyroUnitWatch::find_no_rates() const {
  // A camera that only translates must not look like one that rotates.
  constexpr double kLeastSeenRadS = 0.1;
  constexpr std::size_t kFewest = 8;
  std::size_t rotating = 0;
  double energy = 0, less_rotation = 0, less_translation = 0;
  GyroUnitFault fault;
  fault.kind = GyroUnitFault::Kind::NO_RATES;
  for (const Entry& entry : entries_) {
    const double seen_rad_s = entry.seen.rate_rad_s.norm();
    if (seen_rad_s < kLeastSeenRadS) continue;
    ++rotating;
    energy += entry.seen.energy_px2_s2;
    less_rotation += entry.seen.energy_less_rotation_px2_s2;
    less_translation += entry.seen.energy_less_translation_px2_s2;
    if (seen_rad_s > fault.seen_rad_s) fault.seen_rad_s = seen_rad_s;
  }
  if (rotating < kFewest || 2 * less_rotation > energy || less_rotation > less_translation) return std::nullopt;
  return fault;
}

}  // namespace gyro_deblur
