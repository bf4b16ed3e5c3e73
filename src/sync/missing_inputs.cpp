// Reports inputs that have never arrived.
#include "sync/missing_inputs.hpp"

namespace gyro_deblur {
namespace {

/// After the first image. Topics connect and drivers start within it; the report comes within a second.
constexpr TimeNs kTimeoutNs = 600'000'000;

}  // namespace

void MissingInputs::check(const Config& config, const Seen& seen, TimeNs steady_ns) {
  if (!first_image_ns_ || steady_ns - *first_image_ns_ < kTimeoutNs) return;
  report(config, seen, "0.6 s after the first image");
}

void MissingInputs::finish(const Config& config, const Seen& seen) {
  if (first_image_ns_) report(config, seen, "to the last image");
}

void MissingInputs::report(const Config& config, const Seen& seen, const std::string& when) {
  const bool file_has_camera = config.calibration && config.calibration->camera && !config.rectified_input;
  problems_.update(
      "no exposure time",
      seen.exposure || config.shutter.exposure_ns > 0
          ? ""
          : "exposure_time is not set, and no exposure message has come " + when +
                ": images are passed through unchanged until it is estimated from their blur, which needs motion. Set "
                "exposure_time [s], or connect the exposure topic and set exposure_source to its content");
  const bool by_flow = goes_without_imu(config);
  const bool described = seen.camera_info || file_has_camera;
  problems_.update("no camera_info",
                   described ? ""
                             : "no camera_info has come " + when + ", and no calibration file has the camera" +
                                   (config.rectified_input ? " (rectified_input needs camera_info)" : "") + ": " +
                                   (by_flow ? without_calibration_text(config) + ". Publish" : "publish") +
                                   " camera_info in the namespace of the images" +
                                   (config.rectified_input ? "" : ", or set calibration_file"));
  problems_.update(
      "no imu",
      seen.imu || (by_flow && config.pipeline.flow_without_gyro == "always")
          ? ""
          : "no IMU message with angular rates has come " + when + ": " +
                (by_flow && described ? "images are deblurred by optical flow alone, which is less accurate. Connect"
                                      : "connect") +
                " imu to the gyroscope's topic");
  // The code that finds the rotation resolves the report.
  if (!seen.extrinsic.empty()) problems_.update(kNoExtrinsic, seen.extrinsic);
}

}  // namespace gyro_deblur
