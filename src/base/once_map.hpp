// Things that are made when they are first asked for, by several threads at once.
#pragma once

#include <cstddef>
#include <iterator>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>

namespace gyro_deblur {

/// Values by key, each made once and kept where it is. Thread-safe: who asks for what another thread is making waits
/// for it, and nobody else waits.
template <typename Key, typename Value>
class OnceMap {
 public:
  /// The value of `key`, of make() where there is none yet. After an exception of make() there is none.
  template <typename Make>
  const Value& get(const Key& key, Make&& make) {
    Slot* slot = nullptr;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      std::unique_ptr<Slot>& entry = slots_[key];
      if (!entry) entry = std::make_unique<Slot>();
      slot = entry.get();
    }
    // Not std::call_once, which does not survive an exception everywhere (GCC bug 66146).
    const std::lock_guard<std::mutex> lock(slot->mutex);
    if (!slot->value) slot->value.emplace(make());
    return *slot->value;
  }

  /// Forgets the values of other keys than these. Not while others use the values.
  void keep_only(const std::set<Key>& keys) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (auto slot = slots_.begin(); slot != slots_.end();) {
      slot = keys.count(slot->first) != 0 ? std::next(slot) : slots_.erase(slot);
    }
  }

  std::size_t size() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return slots_.size();
  }

 private:
  struct Slot {
    std::mutex mutex;
    std::optional<Value> value;
  };
  mutable std::mutex mutex_;
  std::map<Key, std::unique_ptr<Slot>> slots_;
};

}  // namespace gyro_deblur
