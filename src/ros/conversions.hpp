// Between ROS messages and the core's types.
#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud.h>
#include <tf2/buffer_core.h>
#include <tf2_msgs/TFMessage.h>
#include <visualization_msgs/MarkerArray.h>
#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/messages.hpp"
#include "ros/pass_through.hpp"

namespace gyro_deblur {

/// A frame that has to be passed through, with the reason and one line that has the values involved.
class FrameError : public std::runtime_error {
 public:
  FrameError(PassThroughReason reason, const std::string& text) : std::runtime_error(text), reason_(reason) {}
  PassThroughReason reason() const { return reason_; }

 private:
  PassThroughReason reason_;
};

/// Nanoseconds of a stamp; to_ros_time clamps to what ros::Time can hold (0 to 2^32 - 1 s).
TimeNs to_time_ns(const ros::Time& time);
ros::Time to_ros_time(TimeNs time_ns);

/// Seconds with all nine digits: doubles have too few for stamps.
std::string seconds_text(TimeNs time_ns);
std::string vector_text(const Eigen::Vector3d& v);

/// Body rate and stamp of an IMU message; nothing when its covariance says that it has no gyroscope
/// (sensor_msgs/Imu: first element -1).
std::optional<GyroSample> to_gyro_sample(const sensor_msgs::Imu& imu);

/// Calibration of an image with the given size, with the habits of image_geometry: a region of interest of 0x0 is the
/// whole sensor, binning of 0 is 1; the region's offset is subtracted from the principal point, then everything is
/// divided by the binning.
/// @param rectified_input  take P and R instead of K and D
/// Throws OptionError with the values for a camera that is not calibrated, a distortion model that is not supported, or
/// a size other than the image's.
CameraCalibration to_calibration(const sensor_msgs::CameraInfo& info, int image_width_px, int image_height_px,
                                 bool rectified_input);

/// The way back, for a raw image: P repeats K. Without distortion the model is plumb_bob with zeros. The header is left
/// empty.
sensor_msgs::CameraInfo camera_info_message(const CameraCalibration& camera);

/// Readout time of the image's region of interest when the whole sensor takes `full_readout_ns`: rows outside the
/// region are not read. Binning does not change it: binned rows stand for the same stretch of the sensor.
TimeNs region_readout_ns(TimeNs full_readout_ns, const sensor_msgs::CameraInfo& info);

/// Pixels of an image message without a copy (big-endian 16-bit data is swapped into one).
struct ImageView {
  cv::Mat image;  ///< shares the message's memory: it must outlive this, and must not be written to
  PixelLayout layout = PixelLayout::GRAY;
};

/// Throws FrameError: BAD_IMAGE when empty or its buffer does not fit its header, UNSUPPORTED_ENCODING.
ImageView view_image(const sensor_msgs::Image& message);

/// The checks of view_image alone.
void check_image(const sensor_msgs::Image& message);

/// An image message with the header and encoding of `input` and other pixels of the same type.
sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const sensor_msgs::Image& input);

/// A bgr8 message with the header of `input`.
sensor_msgs::ImagePtr to_bgr_image(const cv::Mat& bgr, const std_msgs::Header& header);

/// Pixels of a compressed image (JPEG, PNG, whatever OpenCV reads), with its header. Colours come as bgr8 (bgr16,
/// bgra8), one channel as mono8, mono16, or the Bayer encoding that `format` names before its semicolon. What cannot be
/// decoded gives an image of 0x0, which check_image refuses as BAD_IMAGE: the frame comes out in its turn.
sensor_msgs::ImagePtr decode_image(const sensor_msgs::CompressedImage& compressed);

/// What is known of a camera without camera_info: header and size, K of zeros (not calibrated).
sensor_msgs::CameraInfoPtr uncalibrated_camera_info(const sensor_msgs::Image& input);

BlurFieldPtr to_message(const FrameBlur& field, const std_msgs::Header& header);

/// Message of an image that was passed through unchanged.
BlurFieldPtr pass_through_message(PassThroughReason reason, const std::string& text, const sensor_msgs::Image& input);

KeypointArrayPtr to_message(const PipelineResult& result, const KeypointOptions& options,
                            const std_msgs::Header& header);

/// Corners as VINS-Mono's estimator takes them: one point (x, y, 1) each on the undistorted plane z = 1 of the camera,
/// and the channels id_of_point, u_of_point, v_of_point [px, raw], velocity_x_of_point, velocity_y_of_point [1/s], in
/// this order. Corners that were seen for the first time, which have no velocity yet, are left out, as its own tracker
/// does.
sensor_msgs::PointCloudPtr to_message(const std::vector<Track>& tracks, const std_msgs::Header& header);

/// The blur paths as lines at a depth of 1 m in the camera's frame, in the colours of the overlay; short ones for
/// blocks whose path would cover another's. One marker with a fixed namespace and id, so that each image's replaces the
/// one before.
visualization_msgs::MarkerArrayPtr to_markers(const FrameBlur& field, const Camera& camera,
                                              const std_msgs::Header& header);

/// Takes the markers of the image before away.
visualization_msgs::MarkerArrayPtr no_markers(const std_msgs::Header& header);

/// Adds transforms such that the newest to arrive counts, whatever its stamp: an extrinsic is wanted as it is now, and
/// a clock that was set back must not make tf refuse what comes.
void add_transforms(const tf2_msgs::TFMessage& message, tf2::BufferCore* buffer);

/// Rotation that takes IMU coordinates to camera coordinates, the newest that tf has; nothing when it has none.
std::optional<Eigen::Matrix3d> lookup_R_cam_imu(const tf2::BufferCore& buffer, const std::string& camera_frame,
                                                const std::string& imu_frame);

/// The same with the body's place: takes coordinates of `body_frame` to those of `camera_frame`.
std::optional<Eigen::Isometry3d> lookup_T_cam_body(const tf2::BufferCore& buffer, const std::string& camera_frame,
                                                   const std::string& body_frame);

}  // namespace gyro_deblur
