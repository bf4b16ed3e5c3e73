// Images and gyroscope samples of a bag for the estimation of timing.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "calibrate/image_rate.hpp"
#include "calibrate/timing_calibration.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/exposure.hpp"
#include "ros/image_conversion.hpp"
#include "tools/bag_file.hpp"
#include "tools/image_topics.hpp"

namespace gyro_deblur {

struct NamedFootage {
  NamedImages images;
  std::string camera_info, imu, exposure;
};

struct FootageTopics {
  ImageTopic image;
  std::string imu;
  std::string camera_info, exposure;  ///< empty: none
};

struct FootageOptions {
  double start_s = 0;           ///< of the images, since the bag's first message
  std::optional<double> end_s;  ///< absent: the bag's end
  int points = 100;             ///< of each image that are tracked in those after it
  bool quiet = false;           ///< no progress
};

struct Footage {
  CameraCalibration camera;
  double readout_part = 1;  ///< of the sensor's readout that the image's region of interest takes
  std::vector<TrackWindow> windows;
  std::vector<ImageRate> rates;  ///< from picture to picture, coarser than the windows
  std::vector<GyroSample> samples;
  std::optional<Eigen::Matrix3d> R_cam_imu;       ///< of tf
  std::size_t frames = 0;                         ///< that show a new picture
  std::map<TimeNs, TimeNs> message_exposures_ns;  ///< by the images' stamps; > 0
  TimeRange images;                               ///< first to last stamp
  TimeNs image_delay_ns = 0;                      ///< median time from a stamp to the recording of its message
  TimeNs imu_delay_ns = 0;
  std::optional<TimeNs> message_readout_ns;  ///< of exposure messages
  FramePeriod period;
};

/// @param named  topics that the user named; empty ones are looked for
/// Throws std::runtime_error that lists the bag's topics.
FootageTopics choose_topics(const InputBag& input, const NamedFootage& named, const Config& config);

/// An image that shows a new picture.
struct FootagePicture {
  TimeNs stamp_ns = 0, recorded_ns = 0;
  std::string frame_id;
  ImageView pixels;
};

/// In the order of the bag, with a bar. @param what  is done, for the bar
/// Throws std::runtime_error for messages that cannot be read, FrameError for an image that cannot be used.
void for_each_picture(const InputBag& input, const FootageTopics& topics, const FootageOptions& options,
                      const std::string& what, const std::function<void(const FootagePicture&)>& use);

/// From the stamp of a frame to the middle of the exposure of the row that it refers to; 0 for an exposure of 0, which
/// is not known.
TimeNs middle_after_stamp_ns(StampPhase phase, TimeNs exposure_ns);

/// Throws std::runtime_error for messages that cannot be read and bags without images, OptionError for a camera that is
/// not calibrated, FrameError for an image that cannot be used.
Footage read_footage(const InputBag& input, const FootageTopics& topics, const FootageOptions& options,
                     const Config& config);

}  // namespace gyro_deblur
