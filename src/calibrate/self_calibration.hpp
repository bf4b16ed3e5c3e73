// Rotation, time offset, readout time, gyroscope bias and focal length, learned while the camera is in use.
#pragma once

#include <cmath>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "calibrate/gyro_integral.hpp"
#include "calibrate/image_rate.hpp"
#include "calibrate/rate_alignment.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// A value estimated from images and gyroscope.
template <typename Value>
struct Learned {
  Value value{};
  double stddev = 0;      ///< of the value; of a vector or rotation about the axis of which least is known
  double seconds = 0;     ///< of motion, or rest, behind it
  bool known = false;     ///< sure enough to be used
  std::string missing{};  ///< where it is not known: why not, and what would help
};

/// How far two values are apart: of rotations the angle [rad], of vectors the length.
double difference(double a, double b);
double difference(const Eigen::Vector3d& a, const Eigen::Vector3d& b);
double difference(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b);

/// Part of the readout time from the row that stamps refer to, to the middle one.
inline double readout_to_middle(StampRow row) {
  return row == StampRow::FIRST ? 0.5 : row == StampRow::LAST ? -0.5 : 0;
}

/// Largest standard deviations of a value that is used: half of the error that costs one to three percent of the
/// matches.
struct UsefulStddev {
  static constexpr double kOffsetS = 0.005, kRotationRad = 2.5 * M_PI / 180, kBiasRadS = 0.01, kReadoutS = 0.0035;
  static constexpr double kFocalShare = 0.05;  ///< of the focal length
};

/// What has been learned so far.
struct LearnedCalibration {
  Learned<Eigen::Matrix3d> R_cam_imu{Eigen::Matrix3d::Identity()};  ///< stddev [rad]
  /// t_imu = t_cam + time_offset [s]. Contains half of an exposure or readout time that is not known and taken for 0.
  Learned<double> time_offset_s;
  Learned<double> readout_s;  ///< from the first row to the last, whatever the images' exposures say of it
  Learned<Eigen::Vector3d> bias_rad_s{Eigen::Vector3d::Zero()};  ///< IMU axes
  Learned<double> focal_length;  ///< of a lens that is not known, in the image's larger side
  int focal_image_px = 0;        ///< that side; the focal length of images of another size is another one
};

/// Learns from the rates of images and gyroscope of the last half minute: the offset by correlation, the rotation in
/// closed form (Wahba's problem), then both with bias and readout by robust least squares; the bias of a camera that
/// stands still also from that alone. A value is known when two standard deviations are below 10 ms (readout: 7 ms), 5
/// degrees, 0.02 rad/s, or a tenth of the focal length: what that costs is a few percent of the matches. A known value
/// stays known until later motion contradicts it. Bounded memory, some milliseconds for an update() each second. Not
/// thread-safe.
class SelfCalibration {
 public:
  /// @param expected_offset_ns  the offset is looked for around this; |.| <= 4e9 s
  /// @param search_ns           [0.02 s, 5 s]: to either side
  /// Throws OptionError.
  explicit SelfCalibration(TimeNs expected_offset_ns = 0, TimeNs search_ns = 500'000'000);

  /// @param sample  IMU axes and clock, in the order of time
  void add_sample(const GyroSample& sample);
  /// @param rate  in the order of time; begins anew where time goes back, the lens becomes known, or images get
  ///              another size
  void add_rate(const ImageRate& rate);

  /// A second of images has come since the last update.
  bool is_due() const;
  /// Learns from what has come.
  void update();

  const LearnedCalibration& learned() const { return learned_; }
  /// Forgets images and samples, but not the estimates: time has been reset.
  void restart();

 private:
  std::vector<ImageRate> usable_rates() const;
  /// Why no rate is usable.
  std::string missing_data() const;
  void learn_alignment();
  void learn_focal_length(const RateAlignment& found, double rotating_s);
  void learn_readout(const RateAlignment& found, double rotating_s);
  void learn_rotation_and_bias(const RateAlignment& found, double rotating_s);
  void learn_resting_bias();
  void refuse(const std::string& missing);

  TimeNs expected_offset_ns_, search_ns_;
  GyroIntegral gyro_;
  std::deque<ImageRate> rates_;           // of the last half minute
  std::optional<TimeNs> still_since_ns_;  // camera clock
  std::optional<TimeNs> updated_ns_;      // camera clock
  LearnedCalibration learned_;
  bool bias_of_rest_ = false;  // and not of motion
};

/// A value in use, and where it is from: "parameter", "tf", the name of a file.
template <typename Value>
struct Used {
  Value value;
  std::string source;
};

/// Values in use, to be checked against the learned ones. Absent values are not checked.
struct UsedCalibration {
  std::optional<Used<Eigen::Matrix3d>> R_cam_imu;
  std::optional<Used<TimeNs>> time_offset_ns;  ///< for the exposures that the images were given
  std::optional<Used<TimeNs>> readout_ns;
  std::optional<Used<Eigen::Vector3d>> bias_rad_s;
};

/// A value in use that images contradict.
struct Contradiction {
  std::string key;   ///< R_cam_imu, time_offset, readout_time or gyro_bias
  std::string text;  ///< both values, and what to do
};

/// Values in use that the images contradict, by the limits of
/// doc/guides/calibration.md#self-calibration-while-running.
std::vector<Contradiction> contradictions(const UsedCalibration& used, const LearnedCalibration& learned);

}  // namespace gyro_deblur
