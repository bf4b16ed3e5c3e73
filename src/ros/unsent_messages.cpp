#include "ros/unsent_messages.hpp"

#include <algorithm>
#include <deque>
#include <typeinfo>
#include <utility>

#include <ros/poll_manager.h>
#include <ros/publication.h>
#include <ros/serialized_message.h>
#include <ros/subscriber_link.h>
#include <ros/this_node.h>
#include <ros/topic_manager.h>
#include <boost/make_shared.hpp>
#include <boost/shared_array.hpp>

namespace gyro_deblur {

/// Sees each message that roscpp hands to the queues of a topic's subscribers, and who holds it afterwards. All in
/// roscpp's sending thread.
///
/// A queue of length Q is full, and drops a message for message n, when the one that its subscriber is being sent is
/// older than n - Q: all in between wait. Of messages older than that none waits in a queue any more, so that each
/// holder of one is such a subscriber.
class UnsentMessages::Tap : public ros::SubscriberLink {
 public:
  Tap(const ros::PublicationPtr& publication, std::shared_ptr<std::atomic<std::size_t>> count,
      std::shared_ptr<const std::atomic<std::uint64_t>> round)
      : count_(std::move(count)), round_(std::move(round)) {
    parent_ = publication;
    connection_id_ = 0;
    topic_ = publication->getName();
    destination_caller_id_ = ros::this_node::getName();
  }

  void enqueueMessage(const ros::SerializedMessage& message, bool serialized, bool /*nocopy*/) override {
    const ros::PublicationPtr publication = parent_.lock();
    if (!serialized || !message.buf || !publication) return;
    const std::uint64_t round = *round_;
    const std::size_t queue = publication->getMaxQueue();
    held_.push_back({message.buf, next_, round});
    if (queue > 0) {  // else it has no end
      for (const Held& older : held_) {
        if (older.number + queue < next_) *count_ += holders(older, round);
      }
    }
    ++next_;
    held_.erase(std::remove_if(held_.begin(), held_.end(),
                               [round](const Held& each) { return each.round != round && holders(each, round) == 0; }),
                held_.end());
  }

  void getPublishTypes(bool& serialize, bool& nocopy, const std::type_info& /*type*/) override {
    serialize = nocopy = false;
  }
  void drop() override { held_.clear(); }
  std::string getTransportType() override { return "INTRAPROCESS"; }
  std::string getTransportInfo() override { return "counts what is not sent"; }

  void leave() {
    if (const ros::PublicationPtr publication = parent_.lock()) publication->removeSubscriberLink(shared_from_this());
  }

 private:
  struct Held {
    boost::shared_array<std::uint8_t> buffer;
    std::uint64_t number;
    std::uint64_t round;  // in which it was handed out
  };

  /// Subscribers that have a message in their queues, or are being sent it.
  static std::size_t holders(const Held& each, std::uint64_t round) {
    // This, and the list of all that is handed out in one round (Publication::processPublishQueue).
    const long others = each.round == round ? 2 : 1;
    return static_cast<std::size_t>(std::max(0L, each.buffer.use_count() - others));
  }

  const std::shared_ptr<std::atomic<std::size_t>> count_;
  const std::shared_ptr<const std::atomic<std::uint64_t>> round_;
  std::deque<Held> held_;
  std::uint64_t next_ = 0;
};

UnsentMessages::UnsentMessages()
    : count_(std::make_shared<std::atomic<std::size_t>>(0)), round_(std::make_shared<std::atomic<std::uint64_t>>(0)) {
  // Called after each round in which roscpp hands out what was published.
  on_round_ = ros::PollManager::instance()->addPollThreadListener([round = round_] { ++*round; });
}

UnsentMessages::~UnsentMessages() {
  for (const auto& [topic, tap] : taps_) tap->leave();
  ros::PollManager::instance()->removePollThreadListener(on_round_);
}

void UnsentMessages::watch(const std::string& topic) {
  const ros::PublicationPtr publication = ros::TopicManager::instance()->lookupPublication(topic);
  if (!publication || taps_.count(topic) > 0) return;
  const auto tap = boost::make_shared<Tap>(publication, count_, round_);
  taps_[topic] = tap;
  publication->addSubscriberLink(tap);
}

}  // namespace gyro_deblur
