// Counts what is published and not sent: roscpp drops it in silence.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include <boost/shared_ptr.hpp>
#include <boost/signals2/connection.hpp>

namespace gyro_deblur {

/// Watches outputs of this process. When a subscriber in another process reads more slowly than messages are published,
/// its queue fills up, and roscpp drops the oldest message of the queue for each new one; its own statistics count
/// these as sent (TransportSubscriberLink::enqueueMessage in transport_subscriber_link.cpp of roscpp 1.15 to 1.17).
///
/// A watched output counts the watcher among its subscribers; nothing is serialised for it. Not thread-safe, but
/// count() and watchers() may be called while messages are published.
class UnsentMessages {
 public:
  UnsentMessages();
  /// After the publishers have been shut down: nothing of this may be on its way to their callbacks then.
  ~UnsentMessages();
  UnsentMessages(const UnsentMessages&) = delete;
  UnsentMessages& operator=(const UnsentMessages&) = delete;

  /// @param topic  resolved; does nothing when this process does not advertise it (a transport that is switched off)
  void watch(const std::string& topic);
  /// How many of the topic's subscribers are no subscribers but watchers of this.
  std::size_t watchers(const std::string& topic) const { return taps_.count(topic); }

  /// Messages that were dropped, counted once for each subscriber that did not get them.
  std::size_t count() const { return *count_; }

 private:
  class Tap;

  const std::shared_ptr<std::atomic<std::size_t>> count_;
  const std::shared_ptr<std::atomic<std::uint64_t>> round_;  // of roscpp's sending thread
  boost::signals2::connection on_round_;
  std::map<std::string, boost::shared_ptr<Tap>> taps_;
};

}  // namespace gyro_deblur
