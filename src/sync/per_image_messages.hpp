// Messages that come with every image, under its stamp: camera_info, exposures. They may be lost, late, or absent.
#pragma once

#include <cstddef>
#include <deque>
#include <iterator>
#include <map>
#include <optional>
#include <utility>

#include "gyro_deblur/time.hpp"
#include "sync/time_jump.hpp"

namespace gyro_deblur {

/// Whether images wait for the messages of a stream that has one for each image. A stream that has been silent for some
/// images in a row is no longer waited for, until it resumes. Not thread-safe.
class StreamLiveness {
 public:
  /// So many images in a row without a message end the waiting, so many with one resume it. A stream with one message
  /// in three images is still worth its latency. One with fewer never has two in a row.
  static constexpr std::size_t kMissesEndWaiting = 3, kHitsBringItBack = 2;

  /// An image has arrived. @param there  its message had arrived before
  void expect(TimeNs stamp_ns, TimeNs now_ns, bool there) { undecided_.push_back({stamp_ns, now_ns, there}); }

  void came(TimeNs stamp_ns) {
    for (Image& image : undecided_) image.there = image.there || image.stamp_ns == stamp_ns;
  }

  /// Decides over images, oldest first: one has missed its message when that is `lost(stamp_ns)`, or when it has waited
  /// for `timeout_ns`.
  /// @return whether it is waited for from now on, where that has changed
  template <typename Lost>
  std::optional<bool> update(TimeNs now_ns, TimeNs timeout_ns, Lost lost) {
    const bool before = awaited_;
    for (; !undecided_.empty(); undecided_.pop_front()) {
      Image& image = undecided_.front();
      // A clock that starts, or is set back: waiting starts anew.
      if (image.arrival_ns == 0 || image.arrival_ns > now_ns) image.arrival_ns = now_ns;
      if (!image.there && now_ns - image.arrival_ns < timeout_ns && !lost(image.stamp_ns)) break;
      hits_ = image.there ? hits_ + 1 : 0;
      misses_ = image.there ? 0 : misses_ + 1;
      if (misses_ >= kMissesEndWaiting) awaited_ = false;
      if (hits_ >= kHitsBringItBack) awaited_ = is_per_image_ = true;
    }
    return awaited_ == before ? std::nullopt : std::optional<bool>(awaited_);
  }

  bool awaited() const { return awaited_; }
  /// Two images in a row have had their messages: the stream has one for each image.
  bool is_per_image() const { return is_per_image_; }
  void clear() { *this = {}; }

 private:
  struct Image {
    TimeNs stamp_ns, arrival_ns;
    bool there;
  };
  std::deque<Image> undecided_;  // in order of arrival
  std::size_t hits_ = 0, misses_ = 0;
  bool awaited_ = true, is_per_image_ = false;
};

/// The newest messages of such a stream, and substitutes of lost ones. Not thread-safe.
/// @tparam Same  says whether two messages differ in nothing but the stamp
template <typename T, typename Same>
class PerImageMessages {
 public:
  /// A message that is out of order comes behind the next two (a driver with a few threads); behind more than these it
  /// is taken as lost.
  static constexpr std::size_t kOvertaking = 3;

  void add(TimeNs stamp_ns, T value, std::size_t capacity) {
    // A stream that begins is waited for at once.
    if (!seen_stamped_) liveness_.clear();
    seen_ = seen_stamped_ = true;
    take_newest(value);
    entries_.push_back({stamp_ns, epochs_.next(stamp_ns), std::move(value)});
    while (entries_.size() > capacity) entries_.pop_front();
    liveness_.came(stamp_ns);
  }
  /// A message whose stamp has not been set.
  void add_unstamped(T value) {
    seen_ = true;
    take_newest(std::move(value));
  }

  /// An image has arrived that needs a message.
  void expect(TimeNs stamp_ns, TimeNs now_ns) {
    if (has_no_stamps()) return;
    liveness_.expect(stamp_ns, now_ns, find(stamp_ns) != nullptr);
  }
  /// To be called as time passes, see StreamLiveness::update.
  std::optional<bool> update(TimeNs now_ns, TimeNs timeout_ns) {
    return liveness_.update(now_ns, timeout_ns, [this](TimeNs stamp_ns) { return later(stamp_ns) >= kOvertaking; });
  }
  /// False: too many images in a row had no message, or messages have no stamps.
  bool awaited() const { return liveness_.awaited() && !has_no_stamps(); }
  bool seen() const { return seen_; }

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

  /// Number of messages with later stamps.
  std::size_t later(TimeNs stamp_ns) const { return around(stamp_ns, 0, kReachNs).later; }

  /// The substitute of a message: once a later one has arrived, the one with the stamp is lost or out of order. If its
  /// neighbours agree, it equals them. Null: not known, or they differ.
  const T* find_if_neighbours_agree(TimeNs stamp_ns) const {
    const Around near = around(stamp_ns, kReachNs, kReachNs);
    const T* other = near.before != nullptr ? near.before : near.after_that;
    return near.after != nullptr && other != nullptr && Same()(*near.after, *other) ? near.after : nullptr;
  }
  /// The last message before the stamp, if it equals the one before it and none is later; else null.
  const T* find_last_unchanged(TimeNs stamp_ns) const {
    const Around last = around(stamp_ns, stamp_ns, kReachNs);
    if (last.after != nullptr || last.before == nullptr || last.before_that == nullptr) return nullptr;
    return Same()(*last.before, *last.before_that) ? last.before : nullptr;
  }

  /// Messages that do not belong to single images (latched, rare, or without a stamp) hold until the next one: the
  /// newest. Null for a stream with one for each image, or where so many are later than the stamp that its own is lost.
  const T* find_standing(TimeNs stamp_ns) const {
    return newest_ && !liveness_.is_per_image() && later(stamp_ns) < kOvertaking ? &*newest_ : nullptr;
  }
  /// For an image without a stamp: the newest message, if it equals the one before it or holds for all. Else null.
  const T* find_newest() const {
    return newest_ && (newest_is_as_before_ || !liveness_.is_per_image()) ? &*newest_ : nullptr;
  }
  /// Number of messages within kReachNs of the stamp.
  std::size_t near(TimeNs stamp_ns) const {
    const Around all = around(stamp_ns, kReachNs, kReachNs);
    return all.later + (all.before != nullptr) + (all.before_that != nullptr);
  }

  /// As after the start. A latched message is not sent again, so that it stays.
  void reset() {
    std::optional<T> standing;
    if (!liveness_.is_per_image()) standing.swap(newest_);
    const bool had_stamps = standing && seen_stamped_;
    *this = {};
    newest_ = std::move(standing);
    seen_ = newest_.has_value();
    seen_stamped_ = had_stamps;
  }
  /// Time was reset, see EpochCounter::reset: what belongs to an image is decided by the new epoch alone.
  void clear(ShownBy shown_by) {
    const int epoch = epochs_.reset(shown_by);
    while (!entries_.empty() && entries_.front().epoch < epoch) entries_.pop_front();
    if (liveness_.is_per_image()) newest_.reset();
    liveness_.clear();
  }

 private:
  struct Entry {
    TimeNs stamp_ns;
    int epoch;
    T value;
  };
  /// What came for other stamps; null where there is none.
  struct Around {
    const T *before = nullptr, *before_that = nullptr;  ///< the nearest before the stamp, and the next
    const T *after = nullptr, *after_that = nullptr;    ///< the nearest after it, and the next
    std::size_t later = 0;                              ///< how many stamps there are after it
  };
  /// Messages farther apart are not compared: a stamp may be wrong, or be of another epoch.
  static constexpr TimeNs kReachNs = 1'000'000'000;

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
  bool has_no_stamps() const { return seen_ && !seen_stamped_; }
  void take_newest(T value) {
    newest_is_as_before_ = newest_ && Same()(*newest_, value);
    newest_ = std::move(value);
  }

  std::deque<Entry> entries_;  // in order of arrival
  EpochCounter epochs_;
  StreamLiveness liveness_;
  std::optional<T> newest_;           // to come
  bool newest_is_as_before_ = false;  // it equals the one before
  bool seen_ = false, seen_stamped_ = false;
};

}  // namespace gyro_deblur
