// Converts camera_info to a calibration and back.
#include "ros/calibration_conversion.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <sstream>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <boost/make_shared.hpp>

#include "base/format.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "motion/lens_models.hpp"

namespace gyro_deblur {
namespace {

/// The part of the sensor that the image shows, before binning.
struct Region {
  double x_offset_px = 0, y_offset_px = 0, width_px = 0, height_px = 0;
  double binning_x = 1, binning_y = 1;
};

Region region_of(const sensor_msgs::CameraInfo& info) {
  Region region;
  region.binning_x = std::max<std::uint32_t>(1, info.binning_x);
  region.binning_y = std::max<std::uint32_t>(1, info.binning_y);
  const bool whole = info.roi.width == 0 && info.roi.height == 0;
  region.x_offset_px = info.roi.x_offset;
  region.y_offset_px = info.roi.y_offset;
  region.width_px = whole ? info.width : info.roi.width;
  region.height_px = whole ? info.height : info.roi.height;
  return region;
}

/// Binned sizes are rounded up by some drivers and down by others.
bool is_binned_size(double image_px, double region_px, double binning) {
  return std::abs(image_px - region_px / binning) < 1.0;
}

}  // namespace

bool lacks_size(const sensor_msgs::CameraInfo& info) {
  return info.width == 0 && info.height == 0 && info.roi.width == 0 && info.roi.height == 0;
}

bool is_uncalibrated(const sensor_msgs::CameraInfo& info, bool rectified_input) {
  return (rectified_input ? info.P[0] : info.K[0]) == 0;
}

bool describes_size(const sensor_msgs::CameraInfo& info, double image_width_px, double image_height_px) {
  if (lacks_size(info)) return true;
  const Region region = region_of(info);
  return is_binned_size(image_width_px, region.width_px, region.binning_x) &&
         is_binned_size(image_height_px, region.height_px, region.binning_y);
}

CameraCalibration to_calibration(const sensor_msgs::CameraInfo& info, int image_width_px, int image_height_px,
                                 bool rectified_input) {
  const Region region = region_of(info);
  if (!describes_size(info, image_width_px, image_height_px)) {
    throw OptionError("camera_info describes an image of " +
                      size_text(region.width_px / region.binning_x, region.height_px / region.binning_y) +
                      " (region of interest " + size_text(region.width_px, region.height_px) + ", binning " +
                      size_text(region.binning_x, region.binning_y) + "), but the image is " +
                      size_text(image_width_px, image_height_px));
  }

  // P is 3x4, K is 3x3, both row by row.
  const double* matrix = rectified_input ? info.P.data() : info.K.data();
  const int stride = rectified_input ? 4 : 3;
  const char* name = rectified_input ? "P" : "K";
  if (!(matrix[0] > 0) || !(matrix[stride + 1] > 0)) {
    std::ostringstream text;
    text << "camera_info: focal lengths in " << name << " are (" << matrix[0] << ", " << matrix[stride + 1]
         << ") px, they have to be > 0: the camera is not calibrated. Calibrate it with camera_calibration"
         << (rectified_input ? "" : ", or set calibration_file");
    throw OptionError(text.str());
  }
  // Relative to the focal length; printed calibrations are no more exact.
  constexpr double kLargestSkew = 1e-6;
  if (std::abs(matrix[1]) > kLargestSkew * matrix[0]) {
    throw OptionError(std::string("camera_info: skew ") + name + "[1] = " + std::to_string(matrix[1]) +
                      " is not supported, it has to be 0");
  }

  CameraCalibration calibration;
  calibration.width_px = image_width_px;
  calibration.height_px = image_height_px;
  calibration.fx_px = matrix[0] / region.binning_x;
  calibration.fy_px = matrix[stride + 1] / region.binning_y;
  calibration.cx_px = (matrix[2] - region.x_offset_px) / region.binning_x;
  calibration.cy_px = (matrix[stride + 2] - region.y_offset_px) / region.binning_y;
  if (rectified_input) {
    calibration.R_image_cam = require_rotation(
        "camera_info.R", Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(info.R.data()));
  } else if (!info.D.empty() || !info.distortion_model.empty()) {
    if (info.distortion_model.empty()) {
      throw OptionError("camera_info: distortion_model is empty, but D has " + std::to_string(info.D.size()) +
                        " coefficients");
    }
    try {
      calibration.model = camera_info_model(info.distortion_model).name;
    } catch (const OptionError& error) {
      throw OptionError(std::string("camera_info: ") + error.what());
    }
    calibration.coefficients = info.D;
    if (info.D.empty()) calibration.model = "none";  // a model without coefficients distorts nothing
  }
  calibration.validate();
  return calibration;
}

CameraCalibration to_calibration(const CameraCalibration& sensor, const sensor_msgs::CameraInfo& shown,
                                 int image_width_px, int image_height_px) {
  CameraCalibration pinhole = sensor;
  pinhole.model = "none";
  pinhole.coefficients.clear();
  sensor_msgs::CameraInfo info = camera_info_message(pinhole);
  info.roi = shown.roi;
  info.binning_x = shown.binning_x;
  info.binning_y = shown.binning_y;
  CameraCalibration calibration = to_calibration(info, image_width_px, image_height_px, false);
  calibration.model = sensor.model;  // a region and binning leave distortion as it is
  calibration.coefficients = sensor.coefficients;
  calibration.validate();
  return calibration;
}

bool lacks_lens(const sensor_msgs::CameraInfo& info) {
  const std::vector<std::string> names = lens_model_names();
  return std::find(names.begin(), names.end(), info.distortion_model) != names.end() &&
         !lens_model(info.distortion_model).is_in_camera_info;
}

sensor_msgs::CameraInfo camera_info_message(const CameraCalibration& camera) {
  sensor_msgs::CameraInfo info;
  info.width = static_cast<std::uint32_t>(camera.width_px);
  info.height = static_cast<std::uint32_t>(camera.height_px);
  // A variable: GCC 13 and later warn of a dangling reference if lens_model() takes a temporary.
  const std::string model = camera.model == "none" ? "plumb_bob" : camera.model;
  const LensModelRow& lens = lens_model(model);
  info.distortion_model = lens.name;
  if (lens.is_in_camera_info) {
    info.D = camera.coefficients;
    info.D.resize(lens.coefficient_count, 0.0);  // image_geometry wants all of them
  }
  info.K = {camera.fx_px, 0, camera.cx_px, 0, camera.fy_px, camera.cy_px, 0, 0, 1};
  info.R = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info.P = {camera.fx_px, 0, camera.cx_px, 0, 0, camera.fy_px, camera.cy_px, 0, 0, 0, 1, 0};
  return info;
}

TimeNs region_readout_ns(TimeNs full_readout_ns, const sensor_msgs::CameraInfo& info) {
  const Region region = region_of(info);
  if (info.height == 0) return full_readout_ns;
  return std::llround(static_cast<double>(full_readout_ns) * region.height_px / info.height);
}

CameraCalibration ideal_lens(int width_px, int height_px, double focal_length) {
  CameraCalibration calibration;
  calibration.width_px = width_px;
  calibration.height_px = height_px;
  calibration.fx_px = calibration.fy_px = focal_length * std::max(width_px, height_px);
  calibration.cx_px = 0.5 * (width_px - 1);
  calibration.cy_px = 0.5 * (height_px - 1);
  return calibration;
}

sensor_msgs::CameraInfoPtr uncalibrated_camera_info(const sensor_msgs::Image& input) {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header = input.header;
  info->width = input.width;
  info->height = input.height;
  return info;
}

}  // namespace gyro_deblur
