// Between camera_info and the core's calibration.
#pragma once

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Calibration of an image with the given size, with the habits of image_geometry: a region of interest of 0x0 is the
/// whole sensor, binning of 0 is 1; the region's offset is subtracted from the principal point, then everything is
/// divided by the binning.
/// @param rectified_input  take P and R instead of K and D
/// Throws OptionError with the values for a camera that is not calibrated, a distortion model that is not supported, or
/// a size other than the image's.
CameraCalibration to_calibration(const sensor_msgs::CameraInfo& info, int image_width_px, int image_height_px,
                                 bool rectified_input);

/// Calibration of an image that shows the part of a sensor that `shown` says: its region of interest and binning,
/// nothing else of it. Throws OptionError with the values for another size than the image's.
/// @param sensor  of the whole sensor, e.g. from a file; keeps its lens model
CameraCalibration to_calibration(const CameraCalibration& sensor, const sensor_msgs::CameraInfo& shown,
                                 int image_width_px, int image_height_px);

/// True when width and height are 0, and there is no region of interest: the size is not filled in.
bool lacks_size(const sensor_msgs::CameraInfo& info);

/// True when camera_info says that the camera is not calibrated: K[0] = 0, by sensor_msgs/CameraInfo.msg; P[0] where
/// images are rectified.
bool is_uncalibrated(const sensor_msgs::CameraInfo& info, bool rectified_input);

/// True when camera_info names a lens model whose coefficients it cannot have, as camera_info_message() makes it.
bool lacks_lens(const sensor_msgs::CameraInfo& info);

/// True when camera_info is about images of this size, its region of interest and binning considered, or lacks_size().
bool describes_size(const sensor_msgs::CameraInfo& info, double image_width_px, double image_height_px);

/// The way back, for a raw image: P repeats K. Without distortion the model is plumb_bob with zeros. A model whose
/// coefficients sensor_msgs does not define leaves its name, and D empty. The header is left empty.
sensor_msgs::CameraInfo camera_info_message(const CameraCalibration& camera);

/// Readout time of the image's region of interest when the whole sensor takes `full_readout_ns`: rows outside the
/// region are not read. Binning does not change it: binned rows stand for the same stretch of the sensor.
TimeNs region_readout_ns(TimeNs full_readout_ns, const sensor_msgs::CameraInfo& info);

/// A camera without distortion that looks along the middle of the image.
/// @param focal_length  in the image's larger side, > 0
CameraCalibration ideal_lens(int width_px, int height_px, double focal_length);

/// What is known of a camera without camera_info: header and size, K of zeros (not calibrated).
sensor_msgs::CameraInfoPtr uncalibrated_camera_info(const sensor_msgs::Image& input);

}  // namespace gyro_deblur
