// The messages of a bag on their way into a processor.
#pragma once

#include <cstddef>
#include <string>

#include <ros/time.h>
#include <rosbag/bag.h>
#include <rosbag/message_instance.h>
#include <tf2/buffer_core.h>

#include "gyro_deblur/config.hpp"
#include "ros/exposure_adapter.hpp"
#include "ros/processor.hpp"
#include "tools/deblur_topics.hpp"

namespace gyro_deblur {

/// The part of a bag whose images are deblurred, [begin_ns, end_ns) of recording time. Everything else is read from
/// lead_ns earlier, and until the last image has left, so that slices together give what the whole bag gives.
struct Slice {
  TimeNs begin_ns, end_ns, lead_ns;
  bool holds(TimeNs t_ns) const { return t_ns >= begin_ns && t_ns < end_ns; }
  ros::Time read_from() const;
};

/// How long before an image came there may be messages that it needs: its gyroscope samples, and messages that overtook
/// it.
TimeNs lead_ns(const Config& config);

/// A processor whose clock, transforms and messages are those of a bag. All members that read throw MessageError.
class DeblurFeed {
 public:
  DeblurFeed(const DeblurTopics& topics, const Config& config, const FrameRequest& request, Log log);
  DeblurFeed(const DeblurFeed&) = delete;
  DeblurFeed& operator=(const DeblurFeed&) = delete;

  /// Latched transforms of the whole bag: a node would have them from the start.
  void take_static_transforms(const rosbag::Bag& bag) { take_transforms(bag, "/tf_static", ros::TIME_MAX); }
  /// What was said before the slice and still holds: transforms, camera_info, and a setting of the driver.
  void catch_up(const rosbag::Bag& bag, ros::Time until);

  /// When the next message was recorded.
  void set_clock(TimeNs now_ns) { now_ns_ = now_ns; }
  /// The next message.
  /// @param with_images  false: leave images out
  /// @return true when a frame came in, which will come out of the processor
  bool take(const rosbag::MessageInstance& instance, bool with_images);

  Processor& processor() { return processor_; }

 private:
  Processor::Environment environment(const FrameRequest& request);
  void take_transforms(const rosbag::Bag& bag, const std::string& topic, ros::Time until);
  bool take_image(const rosbag::MessageInstance& instance);
  void take_exposure(const rosbag::MessageInstance& instance);

  const DeblurTopics topics_;
  const bool driver_messages_;
  const Log log_;
  tf2::BufferCore tf_buffer_;
  TimeNs now_ns_ = 0;
  ExposureAdapter adapter_;
  Processor processor_;
};

}  // namespace gyro_deblur
