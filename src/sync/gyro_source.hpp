// The samples of one IMU, taken in once for all cameras that use it.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/gyro_check.hpp"
#include "sync/input_problems.hpp"
#include "sync/timestamp_filter.hpp"

namespace gyro_deblur {

/// What became of the samples of an IMU since its source was made.
struct ImuStatistics {
  std::size_t imu_accepted = 0;  ///< less those that were given back: the next one showed that their stamp was ahead
  std::size_t imu_not_finite = 0;
  std::size_t imu_duplicate = 0;
  std::size_t imu_out_of_order = 0;  ///< came after a newer one
  std::size_t imu_stray = 0;         ///< stamp far from those around it, or ahead of them
  std::size_t imu_without_gyroscope = 0;
  std::size_t imu_saturated = 0;  ///< of those accepted
};

/// Keeps the samples of one IMU as the sensor gave them: bias, time offset and rotation are
/// those of each camera, and applied by it. Samples that cannot be used are dropped, counted and logged; for stamps
/// TimestampFilter decides with imu_stamps. When the IMU's clock was set back, everything from before is forgotten.
/// Thread-safe.
class GyroSource {
 public:
  struct Options {
    TimeNs capacity_ns;   ///< how much is kept; > 0
    TimeNs time_jump_ns;  ///< see imu_stamps
    GyroOptions gyro;     ///< max_gap_ns: see imu_stamps; range_rad_s: what counts as saturated
  };
  static Options options_of(const Config& config);

  GyroSource(const Options& options, Log log);

  void set_options(const Options& options);
  /// Keeps at least this much from now on.
  void require_capacity(TimeNs capacity_ns);

  /// False when it is not used, or not yet, for want of a rate or of a stamp that fits.
  /// @param sample  nothing: the IMU says that it has no angular rates
  bool add(const std::optional<GyroSample>& sample, const std::string& frame_id);

  ImuStatistics statistics() const;
  /// What the samples have shown to be wrong, by kind.
  std::map<std::string, InputProblem> problems() const { return problems_.all(); }
  /// Rates that no gyroscope measures have come in the last seconds.
  bool unit_is_wrong() const;
  /// All rates of the last second or more are exactly 0, as no gyroscope's are.
  bool rates_are_zero() const;
  /// Frame of the newest message.
  std::string frame_id() const;

 private:
  friend class GyroReader;

  /// True when the newest sample in store is this one.
  bool take(const GyroSample& sample);
  void refuse(const TimestampFilterResult<GyroSample>::Refused& refused);
  void resize(TimeNs capacity_ns);

  InputProblems problems_;  // locks itself

  mutable std::mutex mutex_;  // everything below
  Options options_;
  GyroCheck check_{&problems_};
  GyroBuffer buffer_;
  TimestampFilter<GyroSample> stamps_;
  std::string frame_id_;
  ImuStatistics statistics_;
  int epoch_ = 0;  // grows when the clock was set back
  TimeNs restarted_from_ns_ = 0, restarted_at_ns_ = 0;
};

/// What one camera sees of a source: what has come since the camera last forgot. Its owner serialises access; the
/// source goes on by itself, so that samples may come, or vanish by a restart, between two calls.
class GyroReader {
 public:
  /// Sees what the source has already. Precondition: not null.
  explicit GyroReader(std::shared_ptr<GyroSource> source);

  struct News {
    std::size_t samples = 0;          ///< that were accepted
    std::optional<TimeNs> newest_ns;  ///< IMU clock
    bool restarted = false;           ///< the IMU's clock was set back, once or more
    TimeNs from_ns = 0, to_ns = 0;    ///< when it was so last
  };
  /// What has happened since the last call.
  News update();

  /// From now on nothing is seen of what had come at the last update().
  void forget() { forgotten_ = seen_; }

  bool empty() const { return available().empty(); }
  /// As GyroBuffer's, of what is seen.
  TimeRange available() const;
  std::vector<GyroSample> window(const TimeRange& requested) const;

 private:
  struct Position {
    int epoch = 0;
    std::size_t accepted = 0;
    std::optional<TimeNs> newest_ns;  // nothing: before the first sample of the epoch
  };
  /// Oldest time that is seen. The source is locked.
  TimeNs horizon_ns() const;

  std::shared_ptr<GyroSource> source_;
  Position seen_;       // at the last update
  Position forgotten_;  // everything up to here
};

}  // namespace gyro_deblur
