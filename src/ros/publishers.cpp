// Publishes what a frame has become.
#include "ros/publishers.hpp"

#include <algorithm>
#include <string>
#include <type_traits>
#include <utility>

#include <image_transport/camera_common.h>

namespace gyro_deblur {

void Publishers::advertise(ros::NodeHandle& nh, image_transport::ImageTransport& transport, std::uint32_t queue_size,
                           const std::function<void()>& on_change) {
  const auto on_status = [on_change](const auto&) { on_change(); };
  const image_transport::SubscriberStatusCallback on_image_status = on_status;
  const ros::SubscriberStatusCallback on_topic_status = on_status;
  const auto add = [this](auto publisher, bool FrameRequest::*request, auto message) {
    rows_.push_back({request, [publisher] { return publisher.getNumSubscribers(); },
                     [publisher, message](const FrameOutput& output) {
                       if (output.*message) publisher.publish(output.*message);
                     },
                     [publisher]() mutable { publisher.shutdown(); }});
  };
  std::string image_topic;  // of the row before
  for_each_output([&](const char* name, bool FrameRequest::*request, auto message) {
    using Pointer = std::decay_t<decltype(std::declval<FrameOutput>().*message)>;
    using Message = std::remove_const_t<typename Pointer::element_type>;
    if constexpr (std::is_same_v<Message, sensor_msgs::Image>) {
      const image_transport::Publisher publisher =
          transport.advertise(name, queue_size, on_image_status, on_image_status);
      image_topic = publisher.getTopic();
      add(publisher, request, message);
    } else {
      // The sibling of its image, wherever that has been remapped to.
      const std::string topic =
          std::is_same_v<Message, sensor_msgs::CameraInfo> ? image_transport::getCameraInfoTopic(image_topic) : name;
      add(nh.advertise<Message>(topic, queue_size, on_topic_status, on_topic_status), request, message);
    }
  });
}

bool Publishers::has_listener() const {
  return std::any_of(rows_.begin(), rows_.end(), [](const Row& row) { return row.listeners() > 0; });
}

FrameRequest Publishers::request() const {
  FrameRequest request;
  for (const Row& row : rows_) {
    if (row.request) request.*row.request = false;
  }
  for (const Row& row : rows_) {
    if (row.request && row.listeners() > 0) request.*row.request = true;
  }
  return request;
}

void Publishers::publish(const FrameOutput& output) const {
  for (const Row& row : rows_) row.publish(output);
}

void Publishers::shutdown() {
  for (const Row& row : rows_) row.shutdown();
}

}  // namespace gyro_deblur
