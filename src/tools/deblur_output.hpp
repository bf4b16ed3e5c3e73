// Output of deblur_bag: messages, and numbers for a report.
#pragma once

#include <deque>
#include <string>

#include <ros/time.h>
#include <rosbag/bag.h>

#include "ros/processor.hpp"
#include "tools/frame_report.hpp"

namespace gyro_deblur {

/// Writes each frame at the time at which its image was recorded.
class FrameWriter {
 public:
  /// @param name_space  of the topics
  /// @param report      gets one entry a frame, what was done and how long it took, where it is wanted
  FrameWriter(rosbag::Bag& bag, const std::string& name_space, FrameReport& report)
      : bag_(bag), name_space_(name_space), report_(report) {}

  /// The image of a frame that will come out of the processor was recorded at `time`.
  void expect_frame(ros::Time time) { record_times_.push_back(time); }
  /// Precondition: the frame is expected. Throws rosbag::BagException.
  void write(const FrameOutput& frame);

  double processing_ms() const { return processing_ms_; }  ///< of all frames

 private:
  rosbag::Bag& bag_;
  const std::string name_space_;
  FrameReport& report_;
  std::deque<ros::Time> record_times_;  // of the frames that have not come out yet
  double processing_ms_ = 0;
};

}  // namespace gyro_deblur
