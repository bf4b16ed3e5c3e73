// A camera's motion that is asked for the same rotations again and again.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Remembers rotations: all points of a global shutter's image share theirs. Refers to the motion, of
/// which it knows rotations alone: velocity_gain() gives nothing. Not thread-safe.
class RememberedMotion : public CameraMotion {
 public:
  explicit RememberedMotion(const CameraMotion& motion) : motion_(motion) {}

  bool covers(const TimeRange& range) const override { return motion_.covers(range); }
  Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const override {
    Entry& entry = entries_[index_of(from_ns, to_ns)];
    if (!entry.is_set || entry.from_ns != from_ns || entry.to_ns != to_ns) {
      entry = {true, from_ns, to_ns, motion_.rotation(from_ns, to_ns)};
    }
    return entry.rotation;
  }

 private:
  static constexpr int kIndexBits = 6;
  struct Entry {
    bool is_set = false;
    TimeNs from_ns = 0, to_ns = 0;
    Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  };
  /// Multiplicative hash, D. Knuth, The Art of Computer Programming 6.4.
  static std::size_t index_of(TimeNs from_ns, TimeNs to_ns) {
    constexpr std::uint64_t kFactor = 0x9E3779B97F4A7C15u;
    const std::uint64_t key = static_cast<std::uint64_t>(from_ns) + kFactor * static_cast<std::uint64_t>(to_ns);
    return static_cast<std::size_t>((kFactor * key) >> (64 - kIndexBits));
  }

  const CameraMotion& motion_;
  mutable std::array<Entry, std::size_t{1} << kIndexBits> entries_;
};

}  // namespace gyro_deblur
