// What images show: some cameras send one picture several times, under a new stamp each time.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <sensor_msgs/Image.h>
#include <Eigen/Core>

#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/options.hpp"
#include "gyro_deblur/time.hpp"
#include "pipeline/exposure_choice.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {

/// What is known of how pixels look into the world.
enum class Lens {
  CALIBRATED,    ///< by camera_info or a file
  FOCAL_LENGTH,  ///< estimated from images and gyroscope: good for blur, and for no ray that is published
  UNKNOWN,       ///< optical flow alone moves the image
};

/// When a picture was exposed, and how the camera moved meanwhile; copies, so that it needs no lock.
struct PictureMotion {
  std::optional<RowExposure> exposure;  ///< by the plan, until it is known from the images
  ExposurePlan plan;
  bool readout_by_message = false;  ///< the exposure's readout time is of a message, and not the configuration's
  GyroOptions gyro;                 ///< with the bias in use
  Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
  bool R_by_tf = false;
  /// Over the exposure, and the time since the picture before it, across which corners are tracked.
  std::vector<GyroSample> samples;
  std::size_t own_begin = 0, own_end = 0;  ///< indices of those that the picture itself needs
  Lens lens = Lens::CALIBRATED;            ///< see PendingFrame::lens
  /// It is absent or silent, or cannot be used; see PipelineOptions::flow_without_gyro.
  bool without_gyro = false;
  std::string coverage_text;  ///< which of its own are missing, should some be, or why it cannot be used
  /// Why the picture passes through where flow shows no certain motion either.
  PassThroughReason lacks = PassThroughReason::NO_GYRO;
};

struct MadePicture;

/// One picture, shared by the images that show it: it was exposed once, by the stamp of the first of them.
struct Picture {
  TimeNs stamp_ns = 0;                  ///< of the first image that shows it, camera clock
  std::optional<PictureMotion> motion;  ///< once one of the images has had what belongs to it
  /// The pipeline's result for it; used by the thread that calls Processor::advance() alone.
  std::shared_ptr<const MadePicture> made;
};

/// Whether two images have the same size, encoding and pixels, byte by byte: the noise of a sensor makes every new
/// picture differ, also of a scene at rest. Ends at the first difference. Padding of rows is not compared.
/// Precondition: both pass check_image().
bool show_same_pixels(const sensor_msgs::Image& a, const sensor_msgs::Image& b);

/// Distinguishes images that show a new picture from those that repeat the one before. Not thread-safe.
class PictureTracker {
 public:
  struct Shown {
    std::shared_ptr<Picture> picture;  ///< not null
    bool is_new = true;
  };
  /// Keeps the image while it is the newest new picture. An image with an older stamp than the picture is a new one:
  /// time was reset.
  Shown add(const sensor_msgs::ImageConstPtr& image, TimeNs stamp_ns);

  /// The next image shows a new picture.
  void forget() { *this = {}; }

 private:
  sensor_msgs::ImageConstPtr image_;  // the first one that shows the picture
  std::shared_ptr<Picture> picture_;
};

}  // namespace gyro_deblur
