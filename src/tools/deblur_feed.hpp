// The messages of a bag on their way into a processor.
#pragma once

#include <deque>
#include <functional>
#include <string>

#include <ros/time.h>
#include <rosbag/bag.h>
#include <rosbag/message_instance.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>

#include "gyro_deblur/config.hpp"
#include "ros/exposure_adapter.hpp"
#include "ros/processor.hpp"
#include "ros/tf_conversion.hpp"
#include "tools/deblur_topics.hpp"
#include "tools/message_stream.hpp"

namespace gyro_deblur {

/// How long before an image the messages that it needs may come: its gyroscope samples, and others that overtook it.
TimeNs lead_ns(const Config& config);

/// A processor whose clock, transforms and messages are those of a bag. An image is released when the stamps of what it
/// waits for have passed, whenever that was recorded, or when the bag has no more of it. All members that read
/// throw MessageError.
class DeblurFeed {
 public:
  /// @param from  when the first messages that are read were recorded
  DeblurFeed(const rosbag::Bag& bag, const DeblurTopics& topics, const Config& config, const FrameRequest& request,
             ros::Time from, Log log);
  DeblurFeed(const DeblurFeed&) = delete;
  DeblurFeed& operator=(const DeblurFeed&) = delete;

  /// Messages before `from` that still hold: transforms, camera_info, mask, and a setting of the driver.
  void catch_up();

  /// Called with the time at which the image of a frame that will come out was recorded.
  using Expect = std::function<void(ros::Time)>;
  /// The next image. Those before it go through the processor, but for the last few, whose stamps are still compared
  /// with what follows.
  void add(const rosbag::MessageInstance& instance, const Expect& expect, const Processor::Sink& sink);
  /// Processes the frames that still wait: there are no more images.
  void finish(const Expect& expect, const Processor::Sink& sink);

  const Processor& processor() const { return processor_; }

 private:
  Processor::Environment environment(const FrameRequest& request);
  void take_transforms(Transforms::Topic topic, ros::Time until);
  /// As in the nodelet: a message without an exposure time costs its frame, not the run.
  MessageStream::Read driver_reader();
  MessageStream::Read transform_reader();
  /// The foremost image goes in, with what belongs to it, and out again.
  void pass_front(const Expect& expect, const Processor::Sink& sink);
  /// Up to which stamps messages are read for the foremost image.
  TimeNs until_ns() const;
  /// What was recorded by now, with stamps up to `until_ns`.
  void deliver_due(TimeNs until_ns);

  /// One of the two is there.
  struct BagImage {
    sensor_msgs::ImageConstPtr raw;
    sensor_msgs::CompressedImageConstPtr compressed;
    ros::Time recorded;
    TimeNs stamp_ns() const;
  };

  const rosbag::Bag& bag_;
  const DeblurTopics topics_;
  const ros::Time from_;
  const Log log_;
  Transforms tf_;
  TimeNs now_ns_ = 0;
  ExposureAdapter adapter_;
  Processor processor_;
  MessageStream imu_, camera_info_, exposure_, transforms_, mask_;
  std::deque<BagImage> images_;
};

}  // namespace gyro_deblur
