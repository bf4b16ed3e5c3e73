// Reports inputs that images need and that have never arrived.
#pragma once

#include <optional>
#include <string>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Kind of the report that the rotation between IMU and camera is missing.
constexpr char kNoExtrinsic[] = "no extrinsic";

/// Images are deblurred by optical flow alone where the IMU is absent or silent, or the camera is not calibrated.
inline bool goes_without_imu(const Config& config) {
  return config.pipeline.optical_flow && config.pipeline.flow_without_gyro != "never";
}

/// What happens to images of a camera that is not calibrated, where goes_without_imu().
inline std::string without_calibration_text(const Config& config) {
  const bool learns = config.self_calibration == SelfCalibrationMode::AUTO;
  return std::string("images are deblurred by optical flow alone, which is less accurate") +
         (learns ? " until the camera has rotated for some seconds and its focal length is estimated," : ",") +
         " and without feature_tracks and blur_markers";
}

/// Reports each missing input once, and resolves the report when the input has come. By a clock that does not stop with
/// a simulated one. Its owner serialises access.
class MissingInputs {
 public:
  /// What has come since the start.
  struct Seen {
    bool camera_info = false;
    bool imu = false;       ///< a sample that can be used
    bool exposure = false;  ///< a time, from a message, a setting or the images
    /// Why the foremost frame waits for the rotation between IMU and camera; empty: it does not.
    std::string extrinsic;
  };

  /// @param problems  has to outlive this
  explicit MissingInputs(InputProblems* problems) : problems_(*problems) {}

  /// An image has come.
  void add_image(TimeNs steady_ns) {
    if (!first_image_ns_) first_image_ns_ = steady_ns;
  }
  /// To be called as time passes.
  void check(const Config& config, const Seen& seen, TimeNs steady_ns);
  /// Nothing more will come.
  void finish(const Config& config, const Seen& seen);
  /// As after the start.
  void clear() { first_image_ns_.reset(); }

 private:
  void report(const Config& config, const Seen& seen, const std::string& when);

  InputProblems& problems_;
  std::optional<TimeNs> first_image_ns_;
};

}  // namespace gyro_deblur
