// The newest messages of a kind by their stamp.
#pragma once

#include <cstddef>
#include <deque>
#include <iterator>
#include <map>
#include <utility>

#include "gyro_deblur/time.hpp"
#include "ros/time_jump.hpp"

namespace gyro_deblur {

/// Keeps what is to be found by an image's stamp, whatever order it comes in. Not thread-safe.
template <typename T>
class StampedStore {
 public:
  void add(TimeNs stamp_ns, T value, std::size_t capacity) {
    entries_.push_back({stamp_ns, epochs_.next(stamp_ns), std::move(value)});
    while (entries_.size() > capacity) entries_.pop_front();
  }

  /// The newest to come with this stamp; null when there is none.
  const T* find(TimeNs stamp_ns) const {
    for (auto entry = entries_.rbegin(); entry != entries_.rend(); ++entry) {
      if (entry->stamp_ns == stamp_ns) return &entry->value;
    }
    return nullptr;
  }

  /// The one with the newest stamp in [oldest_ns, stamp_ns); null when there is none.
  const T* find_before(TimeNs stamp_ns, TimeNs oldest_ns) const {
    const Entry* best = nullptr;
    for (const Entry& entry : entries_) {
      if (entry.stamp_ns < oldest_ns || entry.stamp_ns >= stamp_ns) continue;
      if (best == nullptr || entry.stamp_ns > best->stamp_ns) best = &entry;
    }
    return best == nullptr ? nullptr : &best->value;
  }

  /// What came for other stamps; null where there is none.
  struct Around {
    const T* before = nullptr;       ///< the nearest before the stamp
    const T* before_that = nullptr;  ///< and the next
    const T* after = nullptr;        ///< the nearest after it
    const T* after_that = nullptr;   ///< and the next
    std::size_t later = 0;           ///< how many stamps there are after it
  };
  /// @param back_ns, ahead_ns  how far off [ns] others may be; >= 0
  Around around(TimeNs stamp_ns, TimeNs back_ns, TimeNs ahead_ns) const {
    std::map<TimeNs, const T*> by_stamp;
    for (const Entry& entry : entries_) {
      const TimeNs step_ns = entry.stamp_ns - stamp_ns;
      if (step_ns != 0 && step_ns >= -back_ns && step_ns <= ahead_ns) by_stamp[entry.stamp_ns] = &entry.value;
    }
    const auto following = by_stamp.lower_bound(stamp_ns);
    Around around;
    around.later = static_cast<std::size_t>(std::distance(following, by_stamp.end()));
    if (around.later > 0) around.after = following->second;
    if (around.later > 1) around.after_that = std::next(following)->second;
    if (following == by_stamp.begin()) return around;
    const auto preceding = std::prev(following);
    around.before = preceding->second;
    if (preceding != by_stamp.begin()) around.before_that = std::prev(preceding)->second;
    return around;
  }

  void clear() { drop_before(epochs_.begin()); }

  /// Drops what came before time was reset, see EpochCounter::reset.
  void clear_old_epoch() { drop_before(epochs_.reset()); }

 private:
  struct Entry {
    TimeNs stamp_ns;
    int epoch;
    T value;
  };
  void drop_before(int epoch) {
    while (!entries_.empty() && entries_.front().epoch < epoch) entries_.pop_front();
  }
  std::deque<Entry> entries_;
  EpochCounter epochs_;
};

}  // namespace gyro_deblur
