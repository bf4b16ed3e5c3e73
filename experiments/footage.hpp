// What a simulated camera sees on a recorded flight through a room, rendered once and lit as often as needed.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"
#include "room_flight.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::experiments {

/// Light of the scene and noise of the sensor.
struct Light {
  const char* name;
  double contrast;  ///< (0, 1]: factor on grey levels
  double noise;     ///< standard deviation [grey levels]
};
constexpr Light kDaylight{"", 1, 2}, kLowLight{"low light", 0.35, 4};

/// An image as the sensor gives it in such light, CV_8UC1.
/// @param wide  CV_16UC1 without noise, 257 a grey level
cv::Mat lit(const cv::Mat& wide, const Light& light, std::uint64_t seed);

enum class CameraPath { FLIGHT, ROTATING, RESTING };  ///< as recorded; at the first position; in the first pose
enum class Walls {
  PAPERED,   ///< with photographs, see load_pairs()
  PLAIN,     ///< all but two are of one grey
  CHECKERED  ///< squares of 0.2 m
};

struct FootageCase {
  test::RecordedFlight flight;
  TimeNs exposure_ns = 30'000'000;
  TimeNs readout_ns = 0;
  double speed = 1;
  CameraPath path = CameraPath::FLIGHT;
  Walls walls = Walls::PAPERED;
  std::size_t first_photograph = 0;       ///< on the walls: other ones make another room
  std::vector<TimeNs> exposures_ns = {};  ///< one for each frame, in place of exposure_ns; empty: that for all

  /// For tables: "30 ms, readout 20 ms, x1.7".
  std::string conditions() const;
};

/// Frames of 752x480 at 20 Hz with a focal length of 460 px, and a gyroscope of 200 Hz with noise of 0.003 rad/s.
class Footage {
 public:
  /// @param data  folder that holds trajectories/, and photographs where it has some, see load_pairs()
  /// Throws OptionError when the trajectory cannot be read, std::runtime_error when a photograph cannot.
  Footage(const FootageCase& footage_case, const std::string& data, double seconds);

  const sim::Simulator& truth() const { return simulator_; }
  const Camera& camera() const { return simulator_.camera(); }
  RowExposure exposure(int i) const { return simulator_.exposure(i); }
  int frames() const { return static_cast<int>(frames_.size()); }

  /// Frame i, CV_8UC1, blurred.
  cv::Mat image(int i, const Light& light) const { return image(i, light, static_cast<std::uint64_t>(i) + 1); }
  /// @param seed  of its noise
  cv::Mat image(int i, const Light& light, std::uint64_t seed) const { return lit(frames_[i], light, seed); }
  /// The same without blur: every row at the middle of its exposure.
  cv::Mat sharp(int i, const Light& light);
  /// The same with all rows at the middle of the middle row's exposure, unlit: CV_16UC1, 257 a grey level.
  cv::Mat at_one_instant(int i) { return simulator_.global_shutter(simulator_.reference_time(i)); }

  /// What the IMU reads, 7 cm from the camera, its first and last sample aside.
  /// @param seed  of its noise
  std::vector<sim::ImuSample> imu(std::uint64_t seed) const;
  /// The camera in IMU coordinates [m].
  static Eigen::Vector3d p_imu_cam_m();
  /// The gyroscope, all of it, and its accelerometer.
  /// @param bias_rad_s          of the sensor, on each axis, that nobody knows of
  /// @param with_accelerometer  false: it has none
  RotationTrack rotation(double bias_rad_s = 0, bool with_accelerometer = true) const;
  /// Displacement of a pixel within frame i's exposure by the camera's true motion, were the scene there at this depth
  /// along the optical axis [px].
  Eigen::Vector2d displacement_at_depth(int i, const Eigen::Vector2d& pixel_px, double depth_m) const;
  /// Median over the centres of blocks, along the optical axis at the middle of frame i.
  double median_depth_m(int i, const BlockGrid& grid) const;

 private:
  sim::Simulator simulator_;
  std::vector<cv::Mat> frames_;  // CV_16UC1 without noise, 257 a grey level
};

}  // namespace gyro_deblur::experiments
