// Finds the camera_info and the calibration of a frame.
#include <optional>

#include <boost/make_shared.hpp>

#include "base/format.hpp"
#include "ros/calibration_conversion.hpp"
#include "ros/frame_synchronizer.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

/// The calibration by the camera_info that was found. Throws OptionError when it cannot be used, or contradicts the
/// file.
void set_calibration(const Config& config, PendingFrame* frame) {
  const int width_px = static_cast<int>(frame->image->width), height_px = static_cast<int>(frame->image->height);
  if (!config.calibration || !config.calibration->camera) {
    frame->calibration = to_calibration(*frame->info, width_px, height_px, config.rectified_input);
    return;
  }
  // The file describes the whole sensor; camera_info says which part of it the image shows.
  const auto by_file = [&] { return to_calibration(*config.calibration->camera, *frame->info, width_px, height_px); };
  const bool file_holds = config.on_calibration_conflict == OnCalibrationConflict::CONFIGURED ||
                          is_uncalibrated(*frame->info, config.rectified_input) || lacks_lens(*frame->info);
  if (!frame->described_by_topic || (file_holds && !config.rectified_input)) {
    frame->calibration = by_file();
    return;
  }
  frame->calibration = to_calibration(*frame->info, width_px, height_px, config.rectified_input);
  // P and R of a rectified image have no counterpart in the file.
  if (!config.rectified_input) {
    require_agreement(*frame->calibration, "camera_info", by_file(), config.calibration->origin);
  }
}

constexpr char kNoCalibration[] = "no calibration";
/// Of a lens of which nothing is known, in the image's larger side: 71 degrees from side to side.
constexpr double kFirstFocalLength = 0.7;

std::string zero_camera_info_text(const Config& config) {
  return std::string("camera_info says that the camera is not calibrated (") + (config.rectified_input ? "P" : "K") +
         "[0] = 0): " + without_calibration_text(config) + ". Calibrate it with camera_calibration" +
         (config.rectified_input ? "" : ", or set calibration_file");
}

}  // namespace

const sensor_msgs::CameraInfoConstPtr* FrameSynchronizer::find_other(TimeNs stamp_ns, bool give_up) const {
  const CameraInfos& infos = this->infos();
  if (is_unset(stamp_ns)) return infos.find_newest();
  const sensor_msgs::CameraInfoConstPtr* other = infos.find_if_neighbours_agree(stamp_ns);
  if (other == nullptr && give_up) other = infos.find_last_unchanged(stamp_ns);
  if (other == nullptr && give_up) other = infos.find_standing(stamp_ns);
  return other;
}

sensor_msgs::CameraInfoConstPtr FrameSynchronizer::substitute(const PendingFrame& frame, bool give_up) const {
  const sensor_msgs::CameraInfoConstPtr* other = find_other(frame.stamp_ns, give_up);
  if (other == nullptr || !describes_size(**other, frame.image->width, frame.image->height)) return nullptr;
  auto info = boost::make_shared<sensor_msgs::CameraInfo>(**other);
  info->header.stamp = frame.image->header.stamp;
  return info;
}

std::string FrameSynchronizer::missing_info_text(const PendingFrame& frame) const {
  const std::string text = "no camera_info with the image's stamp " + seconds_text(frame.stamp_ns) + " s";
  const CameraInfos& infos = this->infos();
  if (!infos.seen()) return text + ", nor any other";
  if (const sensor_msgs::CameraInfoConstPtr* other = find_other(frame.stamp_ns, true)) {
    return text + ", and that of adjacent images is for another size than " +
           size_text(frame.image->width, frame.image->height) + " px: its size is " +
           size_text((*other)->width, (*other)->height) + ", its region of interest " +
           size_text((*other)->roi.width, (*other)->roi.height);
  }
  switch (infos.near(frame.stamp_ns)) {
    case 0:
      return text + ", and none within 1 s of it";
    case 1:
      return text + ", and a single one within 1 s of it, which may be of another region";
    default:
      return text + ", and those within 1 s of it differ from each other";
  }
}

sensor_msgs::CameraInfoConstPtr FrameSynchronizer::best_info(const PendingFrame& frame) const {
  if (frame.info) return frame.info;
  if (const sensor_msgs::CameraInfoConstPtr* own = infos().find(frame.stamp_ns)) return *own;
  return substitute(frame, true);
}

bool FrameSynchronizer::goes_uncalibrated(const sensor_msgs::CameraInfo& info) const {
  const Config& config = this->config();
  const bool by_file = config.calibration && config.calibration->camera && !config.rectified_input;
  return goes_without_imu(config) && !by_file && !has_been_calibrated() &&
         is_uncalibrated(info, config.rectified_input);
}

Readiness FrameSynchronizer::find_calibration(PendingFrame* frame) const {
  const Config& config = this->config();
  const std::optional<CameraCalibration> file =
      config.calibration ? config.calibration->camera : std::optional<CameraCalibration>();
  const CameraInfos& infos = this->infos();
  const bool overtaken = infos.later(frame->stamp_ns) >= CameraInfos::kOvertaking;
  const bool give_up = frame->timed_out || !infos.awaited() || overtaken;
  // Only camera_info says which part of the sensor an image of another size shows.
  const bool file_fits = file && file->width_px == static_cast<int>(frame->image->width) &&
                         file->height_px == static_cast<int>(frame->image->height);
  if (const sensor_msgs::CameraInfoConstPtr* info = infos.find(frame->stamp_ns)) {
    frame->info = *info;
    frame->described_by_topic = true;
  } else if (frame->calibration) {
    return Readiness::READY;  // the file's or none, from before anybody sent camera_info
  } else if (const sensor_msgs::CameraInfoConstPtr other = substitute(*frame, give_up)) {
    frame->info = other;
    frame->described_by_topic = true;
  } else if (file && !config.rectified_input && ((!infos.seen() && file_fits) || give_up)) {
    auto described = boost::make_shared<sensor_msgs::CameraInfo>(camera_info_message(*file));
    described->header = frame->image->header;
    frame->info = described;
  } else if (give_up && !infos.seen() && goes_without_imu(config)) {
    frame->info = uncalibrated_camera_info(*frame->image);
  } else if (give_up) {
    return pass_through(frame, PassThroughReason::NO_CALIBRATION, missing_info_text(*frame));
  } else {
    return wait_for(Awaited::CAMERA_INFO, frame);
  }
  const bool uncalibrated = goes_uncalibrated(*frame->info);
  const int width_px = static_cast<int>(frame->image->width), height_px = static_cast<int>(frame->image->height);
  const std::optional<double> focal_length = calibration_.focal_length(width_px, height_px);
  // That there is no camera_info is reported among the missing inputs.
  problems_.update(kNoCalibration, uncalibrated && infos.seen() ? zero_camera_info_text(config) : "");
  frame->lens = !uncalibrated ? Lens::CALIBRATED : focal_length ? Lens::FOCAL_LENGTH : Lens::UNKNOWN;
  if (uncalibrated) {
    frame->calibration = ideal_lens(width_px, height_px, focal_length.value_or(kFirstFocalLength));
    return Readiness::READY;
  }
  try {
    set_calibration(config, frame);
  } catch (const OptionError& error) {
    frame->calibration.reset();
    return pass_through(frame, PassThroughReason::NO_CALIBRATION, error.what());
  }
  return Readiness::READY;
}

}  // namespace gyro_deblur
