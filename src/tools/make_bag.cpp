// A ROS bag from a recorded folder of images and IMU samples.
#include <algorithm>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>

#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/time.hpp"
#include "ros/conversions.hpp"
#include "tools/bag_file.hpp"
#include "tools/bag_messages.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/recording.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

struct Arguments {
  std::string output;
  std::string format;
  std::string input;
  std::string description;
  std::string euroc_camera = "cam0";
  double exposure_s = 0;
  std::string encoding = "as_recorded";
  std::string camera_namespace = "/camera";
  std::string imu_topic = "/imu";
  std::string camera_frame = "camera";
  std::string imu_frame = "imu";
  std::string image = "image_raw";
  CommonArguments common;
};

/// Reads an image file as it is stored, or converted. Returns the pixels and sets the encoding.
cv::Mat read_image(const RecordedFrame& frame, const Recording& recording, const std::string& wanted,
                   std::string& encoding) {
  cv::Mat image = cv::imread(frame.path, cv::IMREAD_UNCHANGED);
  if (image.empty()) {
    throw std::runtime_error(frame.path + ": cannot be read as an image: repair it or take it out of the folder");
  }
  if (image.cols != recording.camera.width_px || image.rows != recording.camera.height_px) {
    throw std::runtime_error(frame.path + ": is " + std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                             " px, the calibration is for " + std::to_string(recording.camera.width_px) + "x" +
                             std::to_string(recording.camera.height_px));
  }
  const bool deep = image.depth() == CV_16U;
  if (image.depth() != CV_8U && !deep) {
    throw std::runtime_error(frame.path +
                             ": has neither 8 nor 16 bits a channel, no other depth is possible: convert it");
  }
  if (wanted == "mono8" || wanted == "bgr8") {
    if (deep) image.convertTo(image, CV_8U, 1.0 / 257.0);
    const bool mono = wanted == "mono8";
    if (image.channels() != (mono ? 1 : 3)) {
      const int code = mono ? (image.channels() == 4 ? cv::COLOR_BGRA2GRAY : cv::COLOR_BGR2GRAY)
                            : (image.channels() == 4 ? cv::COLOR_BGRA2BGR : cv::COLOR_GRAY2BGR);
      cv::cvtColor(image, image, code);
    }
    encoding = wanted;
    return image;
  }
  encoding = encoding_of(image);
  if (encoding.empty()) {
    throw std::runtime_error(frame.path + ": has " + std::to_string(image.channels()) +
                             " channels; 1, 3 or 4 are possible: convert it");
  }
  return image;
}

/// When a camera driver would have delivered the frame, in the IMU clock, so that playback has a sensible order.
TimeNs delivery_time(const RecordedFrame& frame, const Recording& recording) {
  return frame.stamp_ns + frame.exposure_ns + std::max<TimeNs>(recording.readout_ns, 0) + recording.time_offset_ns;
}

/// Topics of the camera.
struct Topics {
  explicit Topics(const Arguments& arguments)
      : image(arguments.camera_namespace + "/" + arguments.image),
        camera_info(parent_namespace(image) + "/camera_info"),
        exposure(arguments.camera_namespace + "/exposure") {}
  std::string image, camera_info, exposure;
};

/// Returns the time of the first sample, or of the first image when that is earlier.
TimeNs write_imu(rosbag::Bag& bag, const Recording& recording, const Arguments& arguments) {
  TimeNs first_ns = delivery_time(recording.frames.front(), recording);
  for (const RecordedImu& sample : recording.imu) {
    first_ns = std::min(first_ns, sample.t_ns);
    const ros::Time stamp = bag_time(sample.t_ns, "IMU sample");
    bag.write(arguments.imu_topic, stamp,
              imu_message(make_header(stamp, arguments.imu_frame), sample.rate_rad_s, sample.acceleration_m_s2));
  }
  return first_ns;
}

/// Returns the encoding of the images.
std::string write_images(rosbag::Bag& bag, const Recording& recording, const Arguments& arguments) {
  const Topics topics(arguments);
  sensor_msgs::CameraInfo info = camera_info_message(recording.camera);
  Progress progress(recording.frames.size(), "images", arguments.common.quiet);
  std::string encoding;
  for (std::size_t i = 0; i < recording.frames.size(); ++i) {
    const RecordedFrame& frame = recording.frames[i];
    const ros::Time delivered = bag_time(delivery_time(frame, recording), frame.path);
    info.header = make_header(bag_time(frame.stamp_ns, frame.path), arguments.camera_frame);
    const cv::Mat image = read_image(frame, recording, arguments.encoding, encoding);
    if (frame.exposure_ns > 0) {
      bag.write(topics.exposure, delivered, exposure_message(info.header, frame.exposure_ns, recording.readout_ns));
    }
    bag.write(topics.camera_info, delivered, info);
    bag.write(topics.image, delivered, to_image(image, info.header, encoding));
    progress.done(i + 1);
  }
  return encoding;
}

/// Returns the encoding of the images.
std::string write_recording(rosbag::Bag& bag, const Recording& recording, const Arguments& arguments) {
  const TimeNs first_ns = write_imu(bag, recording, arguments);
  const ros::Time begin = bag_time(first_ns, "the recording's start");
  write_extrinsic(bag, begin, recording.R_cam_imu, recording.p_imu_cam_m, arguments.imu_frame, arguments.camera_frame);
  return write_images(bag, recording, arguments);
}

nlohmann::json report_of(const Recording& recording, const Arguments& arguments, const std::string& encoding) {
  const Topics topics(arguments);
  const auto exposures = std::count_if(recording.frames.begin(), recording.frames.end(),
                                       [](const RecordedFrame& frame) { return frame.exposure_ns > 0; });
  const auto imu_range =
      std::minmax_element(recording.imu.begin(), recording.imu.end(),
                          [](const RecordedImu& a, const RecordedImu& b) { return a.t_ns < b.t_ns; });
  return {{"bag", arguments.output},
          {"format", arguments.format},
          {"images", recording.frames.size()},
          {"imu_samples", recording.imu.size()},
          {"exposures", exposures},
          {"encoding", encoding},
          {"width_px", recording.camera.width_px},
          {"height_px", recording.camera.height_px},
          {"first_image_stamp_ns", recording.frames.front().stamp_ns},
          {"last_image_stamp_ns", recording.frames.back().stamp_ns},
          {"first_imu_stamp_ns", imu_range.first->t_ns},
          {"last_imu_stamp_ns", imu_range.second->t_ns},
          {"time_offset_ns", recording.time_offset_ns},
          {"readout_ns", recording.readout_ns},
          {"image_topic", topics.image},
          {"camera_info_topic", topics.camera_info},
          {"exposure_topic", exposures > 0 ? topics.exposure : ""},
          {"imu_topic", arguments.imu_topic}};
}

Recording read_recording(const Arguments& arguments) {
  if (!std::filesystem::is_directory(arguments.input)) throw std::runtime_error(arguments.input + ": no such folder");
  if (arguments.format == "euroc") {
    return read_euroc(arguments.input, arguments.euroc_camera, to_ns(arguments.exposure_s));
  }
  if (arguments.description.empty()) {
    throw std::runtime_error("--format frames needs --description FILE with the calibration and the files' formats");
  }
  return read_frames(arguments.input, arguments.description);
}

void run(const Arguments& arguments) {
  const Recording recording = read_recording(arguments);
  OutputBag output(arguments.output);
  const std::string encoding = write_recording(output.bag(), recording, arguments);
  output.finish();
  const nlohmann::json report = report_of(recording, arguments, encoding);
  std::cout << arguments.output << ": " << report["images"] << " images, " << report["imu_samples"] << " IMU samples, "
            << report["exposures"] << " exposure times\n";
  write_json(arguments.common.json, report);
}

int main_of(int argc, char** argv) {
  CommandLine app{"Makes a ROS bag from a recorded folder of images and IMU samples.", "make_bag"};
  Arguments arguments;
  app.add_option("OUT", arguments.output, "bag to write").required();
  app.add_option("INPUT_DIR", arguments.input, "recorded folder").required();
  app.add_option("--format", arguments.format,
                 "euroc: EuRoC's ASL layout; frames: numbered images and files of their stamps and of IMU samples")
      .required()
      .one_of({"euroc", "frames"});
  app.add_option("--description", arguments.description,
                 "frames: YAML with the calibration and the files' formats: see config/recordings/");
  app.add_option("--camera", arguments.euroc_camera, "euroc: the camera's folder [cam0]");
  app.add_option("--exposure-time", arguments.exposure_s, "euroc: exposure time of every image [s]; none is recorded")
      .range(0.0, 1.0);
  app.add_option("--encoding", arguments.encoding, "pixels in the bag: as_recorded, mono8 or bgr8 [as_recorded]")
      .one_of({"as_recorded", "mono8", "bgr8"});
  app.add_option("--camera-ns,--camera-namespace", arguments.camera_namespace,
                 "images, camera_info and exposure go here [/camera]");
  app.add_option("--image-topic", arguments.image, "of the images, in --camera-ns [image_raw]");
  app.add_option("--imu-topic", arguments.imu_topic, "[/imu]");
  app.add_option("--camera-frame", arguments.camera_frame, "tf frame of the camera (optical) [camera]");
  app.add_option("--imu-frame", arguments.imu_frame, "tf frame of the IMU [imu]");
  add_common_options(app, &arguments.common);
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
