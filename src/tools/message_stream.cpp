// Reads the messages of a topic by their stamps.
#include "tools/message_stream.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <utility>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

constexpr std::size_t kCompared = 3;  // messages, of which one may have a wrong stamp
/// Stamps that are farther apart are of different clocks. No store holds more.
constexpr TimeNs kOtherClockNs = 60'000'000'000;

bool is_held_back(TimeNs stamp_ns, TimeNs until_ns) {
  return stamp_ns > until_ns && stamp_ns - until_ns <= kOtherClockNs;
}

}  // namespace

MessageStream::MessageStream(const rosbag::Bag& bag, const std::string& topic, ros::Time from, TimeNs step_back_ns,
                             Read read)
    : step_back_ns_(step_back_ns), read_(std::move(read)) {
  if (!topic.empty()) view_.addQuery(bag, rosbag::TopicQuery(topic), from);
  next_ = view_.begin();
}

const MessageStream::Message* MessageStream::front() {
  // A compressed chunk of a bag is unpacked anew when something else was read in between.
  constexpr std::size_t kBatch = 100;
  if (batch_.size() < kCompared) {
    for (; batch_.size() < kBatch && next_ != view_.end(); ++next_) {
      Message message;
      message.recorded_ns = to_time_ns(next_->getTime());
      if (read_(*next_, &message)) batch_.push_back(std::move(message));
    }
  }
  return batch_.empty() ? nullptr : &batch_.front();
}

TimeRange MessageStream::stamps() const {
  const TimeNs first_ns = *batch_.front().stamp_ns;
  TimeRange range{first_ns, first_ns};
  for (std::size_t i = 1; i < std::min(kCompared, batch_.size()); ++i) {
    const TimeNs stamp_ns = batch_[i].stamp_ns.value_or(first_ns);
    range = {std::min(range.begin_ns, stamp_ns), std::max(range.end_ns, stamp_ns)};
  }
  return range;
}

const MessageStream::Message* MessageStream::due(TimeNs now_ns, TimeNs until_ns) {
  const Message* message = front();
  if (message == nullptr || message->recorded_ns > now_ns) return nullptr;
  return message->stamp_ns && is_held_back(stamps().begin_ns, until_ns) ? nullptr : message;
}

void MessageStream::deliver_due() {
  const Message message = std::move(batch_.front());
  batch_.pop_front();
  if (message.stamp_ns) last_stamp_ns_ = message.stamp_ns;
  message.deliver();
}

bool MessageStream::deliver_ahead(TimeNs image_stamp_ns, TimeNs until_ns) {
  const Message* message = front();
  if (message == nullptr || !message->stamp_ns || is_held_back(stamps().begin_ns, until_ns)) return false;
  const TimeNs stamp_ns = stamps().end_ns;
  if (stamp_ns < image_stamp_ns - kOtherClockNs) return false;
  const bool set_back = last_stamp_ns_ && stamp_ns < *last_stamp_ns_ - step_back_ns_;
  if (set_back && std::abs(*last_stamp_ns_ - image_stamp_ns) < std::abs(stamp_ns - image_stamp_ns)) return false;
  deliver_due();
  return true;
}

}  // namespace gyro_deblur
