// Finds the camera_info and the calibration of a frame.
#pragma once

#include <string>

#include <sensor_msgs/CameraInfo.h>

#include "gyro_deblur/time.hpp"
#include "ros/frame_queue.hpp"
#include "ros/input_buffers.hpp"
#include "ros/readiness.hpp"
#include "sync/calibration_in_use.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Finds them for the frames of one camera. Keeps references to its arguments.
class CalibrationSearch {
 public:
  CalibrationSearch(const InputBuffers& inputs, const CalibrationInUse& calibration, InputProblems* problems)
      : inputs_(inputs), calibration_(calibration), problems_(*problems) {}

  /// The frame's camera_info and calibration, from the topic or the calibration file.
  Readiness find(PendingFrame* frame) const;
  /// The frame's own camera_info, or a copy of its neighbours' where that is lost; null when there is none, or none of
  /// its neighbours' describes an image of this size.
  sensor_msgs::CameraInfoConstPtr best_info(const PendingFrame& frame) const;

 private:
  using CameraInfos = InputBuffers::CameraInfos;

  /// The camera_info of another image, or of all, that stands for the one of this stamp; null when there is none.
  /// @param give_up  the last one will do: none that is newer is waited for
  const sensor_msgs::CameraInfoConstPtr* find_other(TimeNs stamp_ns, bool give_up) const;
  /// The same with this image's stamp, where it describes an image of its size; else null.
  sensor_msgs::CameraInfoConstPtr substitute(const PendingFrame& frame, bool give_up) const;
  /// Why there is no camera_info for the frame. Precondition: there is none.
  std::string missing_info_text(const PendingFrame& frame) const;
  /// Whether optical flow alone moves images of this camera_info, because nothing describes the camera. A single
  /// message of zeros in a stream of others is a fault.
  bool goes_uncalibrated(const sensor_msgs::CameraInfo& info) const;

  const InputBuffers& inputs_;
  const CalibrationInUse& calibration_;
  InputProblems& problems_;
};

}  // namespace gyro_deblur
