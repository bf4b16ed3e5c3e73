// What a camera with a gyroscope delivers to the nodelet, message by message, in memory.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <boost/make_shared.hpp>
#include <boost/shared_ptr.hpp>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/messages.hpp"
#include "ros/processor.hpp"

namespace gyro_deblur::test {

/// Something that happens to the processor in addition to messages, e.g. a change of its parameters.
using Action = std::function<void(Processor&)>;
using ActionConstPtr = boost::shared_ptr<const Action>;

/// One message on its way into the processor.
struct Delivery {
  TimeNs at_ns = 0;     ///< when it arrives, by a clock that nothing disturbs
  TimeNs clock_ns = 0;  ///< what the node's clock shows then
  /// Every kind of message that the nodelet takes. Shared between runs: to be copied before it is changed.
  std::variant<sensor_msgs::ImuConstPtr, sensor_msgs::ImageConstPtr, sensor_msgs::CameraInfoConstPtr, ExposureConstPtr,
               ActionConstPtr>
      message;
  std::size_t frame = 0;  ///< of the recording; for images
};

/// Throws OptionError also for a key that is not known: what is measured would be something else than what was asked
/// for.
Config load_known_config(const std::string& path);

/// The stream that a delivery belongs to; CLOCK for actions.
Stream stream_of(const Delivery& delivery);

/// Gives the message to the processor, or does the action.
void deliver(const Delivery& delivery, Processor* processor);

/// The message, as a copy that may be changed.
template <typename Message>
boost::shared_ptr<Message> copy_of(const boost::shared_ptr<const Message>& message) {
  return boost::make_shared<Message>(*message);
}

/// A simulated camera, kept in memory.
class Recording {
 public:
  /// @param scene_path  of the simulator
  /// @param seconds     how much of it; > 0, at most the scene's length
  Recording(const std::string& scene_path, double seconds);

  /// In order of arrival: exposure, camera_info and image when the frame's exposure has ended, IMU samples when they
  /// were taken.
  const std::vector<Delivery>& deliveries() const { return deliveries_; }
  std::size_t frames() const { return center_extents_px_.size(); }
  TimeNs begin_ns() const { return deliveries_.front().at_ns; }
  TimeNs end_ns() const { return deliveries_.back().at_ns; }
  TimeNs frame_period_ns() const { return frame_period_ns_; }

  /// A piece that can be repeated every `length_ns` without a seam in its stamps.
  std::vector<Delivery> repeatable(TimeNs* length_ns) const;

  /// True blur [px] at the centre of a frame's image.
  double center_extent_px(std::size_t frame) const { return center_extents_px_[frame]; }

 private:
  std::vector<Delivery> deliveries_;
  std::vector<double> center_extents_px_;
  TimeNs frame_period_ns_ = 0;
};

}  // namespace gyro_deblur::test
