// Whether images rotate as fast as the gyroscope says: its rates may be in another unit, or none at all.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>

#include "features/residual_rotation.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// What is wrong with the rates as such.
struct GyroUnitFault {
  enum class Kind {
    DEGREES,  ///< they are in degrees/s
    NO_RATES  ///< they are 0 while the images rotate
  };
  Kind kind = Kind::DEGREES;
  double gyro_rad_s = 0;  ///< largest rate of the gyroscope, as if it were in rad/s
  double seen_rad_s = 0;  ///< rate of the images at that time
};

/// Watches the rotations of one camera's images over the last seconds. Not thread-safe.
class GyroUnitWatch {
 public:
  /// Images are compared where the gyroscope measures at least this [rad/s].
  static constexpr double kLeastGyroRadS = 0.8;

  /// @param t_ns  increasing; begins anew where it is not
  /// @param seen  of an image: `rate_rad_s` by which it rotates as a whole, `known_rad_s` by which the gyroscope says
  void add(TimeNs t_ns, const ResidualRotation& seen);
  void clear();

  /// @param rates_are_zero  all rates of the last second are exactly 0, as no gyroscope's are
  std::optional<GyroUnitFault> find(bool rates_are_zero) const;

  /// Some images have rotated about as fast as the gyroscope said.
  bool is_confirmed() const { return agreeing_ >= kConfirming; }

  /// Not confirmed yet, nor have 5 s passed since the first image, in which a fault would have shown.
  /// @param t_ns  stamp of an image
  bool is_uncertain(TimeNs t_ns);

 private:
  static constexpr std::size_t kConfirming = 3;
  static constexpr TimeNs kWatchedNs = 5'000'000'000;
  struct Entry {
    TimeNs t_ns;
    ResidualRotation seen;
  };
  std::optional<GyroUnitFault> find_degrees() const;
  std::optional<GyroUnitFault> find_no_rates() const;

  std::deque<Entry> entries_;  // of the last seconds
  std::size_t agreeing_ = 0;
  std::optional<TimeNs> begin_ns_;  // stamp of the first image while it is not confirmed
};

}  // namespace gyro_deblur
