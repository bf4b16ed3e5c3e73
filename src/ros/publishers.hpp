// The nodelet's publishers.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include <image_transport/image_transport.h>
#include <ros/node_handle.h>

#include "ros/processing.hpp"

namespace gyro_deblur {

/// A publisher for each output, see for_each_output(). advertise() and shutdown() are not thread-safe.
class Publishers {
 public:
  /// @param queue_size  of every output: messages that a subscriber may lag behind
  /// @param on_change   called when somebody subscribes or unsubscribes, also before this returns
  void advertise(ros::NodeHandle& nh, image_transport::ImageTransport& transport, std::uint32_t queue_size,
                 const std::function<void()>& on_change);
  bool has_listener() const;
  /// What somebody listens to.
  FrameRequest request() const;
  void publish(const FrameOutput& output) const;
  void shutdown();

 private:
  struct Row {
    bool FrameRequest::*request;
    std::function<std::uint32_t()> listeners;
    std::function<void(const FrameOutput&)> publish;
    std::function<void()> shutdown;
  };
  std::vector<Row> rows_;
};

}  // namespace gyro_deblur
