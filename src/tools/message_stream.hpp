// The messages of one topic of a bag, taken by their stamps.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>

#include <ros/time.h>
#include <rosbag/bag.h>
#include <rosbag/message_instance.h>
#include <rosbag/view.h>

#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Gives out messages in the order of their recording, as soon as somebody needs them, whenever they were recorded:
/// up to a minute from the image. Stamps that are farther apart are not compared.
class MessageStream {
 public:
  struct Message {
    TimeNs recorded_ns = 0;
    std::optional<TimeNs> stamp_ns;  ///< clock of the images; absent: it holds from when it was recorded
    std::function<void()> deliver;
  };
  /// Fills in stamp and delivery of a message; false for one that is left out. May throw MessageError.
  using Read = std::function<bool(const rosbag::MessageInstance&, Message*)>;

  /// @param topic  empty: no messages
  /// @param from   messages that were recorded before are left out
  /// @param step_back_ns  a stamp that goes back by more belongs to another epoch of the clock
  MessageStream(const rosbag::Bag& bag, const std::string& topic, ros::Time from, TimeNs step_back_ns, Read read);
  MessageStream(const MessageStream&) = delete;
  MessageStream& operator=(const MessageStream&) = delete;

  /// The next message, if it was recorded by `now_ns` and its stamp is not after `until_ns`: what is far ahead of an
  /// image is kept back, as stores hold the newest messages only. Null: none is due.
  const Message* due(TimeNs now_ns, TimeNs until_ns);
  /// Delivers the message that due() gave.
  void deliver_due();

  /// Delivers the next message for an image that waits for the stream, whenever it was recorded. False when that cannot
  /// help: the stream is at its end, after `until_ns`, without stamps or of another clock, or its clock was set back
  /// and the image is of the time before.
  bool deliver_ahead(TimeNs image_stamp_ns, TimeNs until_ns);

 private:
  /// The next message; null at the end.
  const Message* front();
  /// Of the next message and two that follow, so that one wrong stamp does not count. Precondition: front() has one.
  TimeRange stamps() const;

  rosbag::View view_;
  rosbag::View::iterator next_;
  const TimeNs step_back_ns_;
  const Read read_;
  std::deque<Message> batch_;
  std::optional<TimeNs> last_stamp_ns_;  // delivered
};

}  // namespace gyro_deblur
