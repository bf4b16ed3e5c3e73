// Rotation, time offset and gyroscope bias, learned while the camera is in use.
#pragma once

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "calibrate/gyro_integral.hpp"
#include "calibrate/image_turn.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

struct SelfCalibrationOptions {
  TimeNs expected_offset_ns = 0;   ///< the offset is looked for around this; |.| <= 4e9 s
  TimeNs search_ns = 500'000'000;  ///< (0, 5 s]: to either side

  void validate() const;  ///< throws OptionError
};

/// A value that images and gyroscope tell.
template <typename Value>
struct Learned {
  Value value{};
  double stddev = 0;    ///< of the value; of a vector or rotation about the axis of which least is known
  bool known = false;   ///< sure enough to be used
  std::string missing{};  ///< where it is not known: why not, and what would help
};

/// What has been learned so far.
struct LearnedCalibration {
  Learned<Eigen::Matrix3d> R_cam_imu{Eigen::Matrix3d::Identity()};  ///< stddev [rad]
  /// t_imu = t_cam + time_offset [s]. Contains what the images' exposures were given wrongly: half of an exposure time
  /// and of a readout time that were taken to be 0.
  Learned<double> time_offset_s;
  Learned<Eigen::Vector3d> bias_rad_s{Eigen::Vector3d::Zero()};  ///< IMU axes
  double seconds = 0;                                            ///< of motion behind rotation and offset
};

/// Learns from the rates of images and gyroscope of the last half minute: the offset by correlation, the rotation in
/// closed form (Wahba's problem), then both with the bias by robust least squares; the bias of a camera that stands
/// still also from that alone. A value is known when two standard deviations are below 10 ms, 5 degrees, or 0.02 rad/s:
/// what that costs is a few percent of the matches. A known value stays known until later motion tells it otherwise.
/// Bounded memory, some milliseconds for an update() each second. Not thread-safe.
class SelfCalibration {
 public:
  /// Throws OptionError.
  explicit SelfCalibration(const SelfCalibrationOptions& options = {});

  /// @param sample  IMU axes and clock, in the order of time
  void add_sample(const GyroSample& sample);
  /// @param turn  in the order of time; begins anew where time goes back
  void add_turn(const ImageTurn& turn);

  /// A second of images has come since the last update.
  bool is_due() const;
  /// Learns from what has come.
  void update();

  const LearnedCalibration& learned() const { return learned_; }
  /// Forgets everything.
  void clear();

 private:
  std::vector<ImageTurn> usable_turns() const;
  /// Why no turn is usable.
  std::string missing_data() const;
  void learn_alignment();
  void learn_resting_bias();
  void refuse(const std::string& missing);

  SelfCalibrationOptions options_;
  GyroIntegral gyro_;
  std::deque<ImageTurn> turns_;           // of the last half minute
  std::optional<TimeNs> still_since_ns_;  // camera clock
  std::optional<TimeNs> updated_ns_;      // camera clock
  LearnedCalibration learned_;
  bool bias_of_rest_ = false;  // and not of motion
};

/// What is used now, for a check against what has been learned. What is absent is not checked.
struct UsedCalibration {
  std::optional<Eigen::Matrix3d> R_cam_imu;
  std::optional<TimeNs> time_offset_ns;
  std::optional<Eigen::Vector3d> bias_rad_s;
};

/// Sentences, each with both values, on what contradicts known values by far more than their uncertainty and more than
/// optical flow forgives: 10 degrees, 20 ms, 0.05 rad/s. `name` begins them, e.g. "configured".
std::vector<std::string> contradictions(const UsedCalibration& used, const LearnedCalibration& learned,
                                        const std::string& name);

}  // namespace gyro_deblur
