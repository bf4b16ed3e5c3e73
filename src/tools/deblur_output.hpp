// What becomes of the frames of a bag: messages, and numbers for a report.
#pragma once

#include <deque>
#include <utility>

#include <ros/time.h>
#include <rosbag/bag.h>
#include <nlohmann/json.hpp>

#include "ros/processor.hpp"
#include "tools/deblur_topics.hpp"

namespace gyro_deblur {

/// Writes each frame at the time at which its image was recorded.
class FrameWriter {
 public:
  FrameWriter(rosbag::Bag& bag, const OutputTopics& topics) : bag_(bag), topics_(topics) {}

  /// The image of a frame that will come out of the processor was recorded at `time`.
  void expect_frame(ros::Time time) { record_times_.push_back(time); }
  /// Precondition: the frame is expected. Throws rosbag::BagException.
  void write(const FrameOutput& frame);

  /// One entry a frame: what was done, and how long it took.
  nlohmann::json take_report() { return std::move(frames_); }
  double processing_ms() const { return processing_ms_; }  ///< of all frames

 private:
  rosbag::Bag& bag_;
  const OutputTopics topics_;
  std::deque<ros::Time> record_times_;  // of the frames that have not come out yet
  nlohmann::json frames_ = nlohmann::json::array();
  double processing_ms_ = 0;
};

}  // namespace gyro_deblur
