// Cameras of one process whose images are matched with each other: both of a pair are deblurred, or neither.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {

/// Why a camera with Config::drop_poor would drop an image, for each of the two things that may become of it.
struct DropReasons {
  bool may_be_dropped = true;     ///< false: neither it nor its stereo partners are dropped
  std::string if_deblurred;       ///< why it is dropped if it is deblurred; empty: it is published
  std::string if_passed_through;  ///< the same if it is passed through
};

/// Cameras that share an IMU deblur all images of an instant or none. Each camera reports that an image has arrived,
/// that processing has begun, and whether it can be deblurred. An image that can waits for the reports on its stereo
/// partners, the others' images with the same stamp. If one of them is passed through, has blurred blocks of which none
/// may be deblurred, or is not reported in time, all are passed through. A decision is final. No call waits: an image
/// that has to is asked about again when its camera is woken, and when its timeout has passed.
///
/// Cameras with drop_poor also report whether their image would be poor. If one would be, all cameras of the rig with
/// drop_poor drop their image of that instant, and for this also those wait that have nothing to deblur. If one of the
/// images is published in any case, none is dropped.
///
/// A sharp image agrees with every decision. No camera waits for an image that was skipped (a later one has arrived),
/// nor for a camera that has sent none yet.
class StereoRig {
 public:
  /// Stamps of a pair: VINS-Fusion pairs images up to so far apart, exact matching has them within.
  static constexpr TimeNs kTolerance = 3'000'000;

  /// The one of this process for cameras with this IMU, which is made when nobody has one.
  /// @param imu_topic  resolved name
  static std::shared_ptr<StereoRig> get(const std::string& imu_topic);

 private:
  friend class StereoCamera;
  using Id = const void*;

  /// How often another camera has been in time. After three misses in a row, or more than a third in the long run, no
  /// camera waits for it until it is in time again.
  class Punctuality {
   public:
    void miss();
    void hit();
    void came_late();  ///< a miss counted that was a hit
    bool is_unreliable() const { return score_ >= kUnreliable; }

   private:
    static constexpr int kMiss = 2, kUnreliable = 3 * kMiss, kMost = kUnreliable + kMiss;
    int score_ = 0;
  };

  enum class Phase { RECEIVED, PROCESSING, REPORTED };
  struct Place {
    TimeNs stamp_ns = 0;
    Phase phase = Phase::RECEIVED;
    std::optional<DropReasons> drop_reasons;  ///< once reported, of a camera that drops poor images
  };

  /// Images of one instant.
  struct Pair {
    std::uint64_t number = 0;  ///< grows with the order in which the first images of pairs come
    TimeNs stamp_ns = 0;       ///< of the first
    std::map<Id, Place> places;
    bool agreed = false;            ///< what follows stays
    bool none_dropped = false;      ///< one of its images is published in any case, so that no other one is dropped
    std::string pass_through_text;  ///< why none is deblurred; empty: those that can be are
    std::string drop_text;          ///< why those are dropped whose cameras drop poor images; once agreed
  };

  /// What a camera reports of an image before it waits for what the others report of theirs.
  struct ImageReport {
    bool deblurs = true;            ///< there are blocks that may be deblurred
    std::string pass_through_text;  ///< why its stereo partners have to be passed through; empty: they need not
    std::optional<DropReasons> drop_reasons;  ///< of a camera that drops poor images
  };

  /// The camera that an image has to wait for.
  struct Blocking {
    Id id = nullptr;
    bool has_come = false;
    bool worth_waiting = false;
  };

  /// An image that waits for its stereo partners.
  struct Wait {
    std::shared_ptr<Pair> pair;
    std::chrono::steady_clock::time_point deadline;
    Blocking blocking;  ///< when it was asked about last
  };

  struct Member {
    std::string name;
    TimeNs timeout_ns = 0;
    std::function<void()> wake;
    std::uint64_t newest = 0;  ///< number of the pair that its last image belongs to; 0: none has come
    Punctuality sending;       ///< its image has arrived when a stereo partner is ready
    Punctuality deciding;      ///< and is decided on in time
    std::optional<Wait> wait;
  };

  /// Changes what is known of the image's pair, if it has one, and wakes cameras whose images wait.
  template <typename Change>
  void change(Id id, TimeNs stamp_ns, Change change);
  void join(Id id, const std::string& name, TimeNs timeout_ns, const std::function<void()>& wake);
  void leave(Id id);
  void announce(Id id, TimeNs stamp_ns);
  void begin(Id id, TimeNs stamp_ns);
  void pass_through(Id id, TimeNs stamp_ns, const std::string& why);
  std::optional<FrameAction> decide(Id id, TimeNs stamp_ns, const ImageReport& report);
  std::optional<std::chrono::steady_clock::time_point> deadline(Id id);

  // These need mutex_.
  void wake_waiting(Id except = nullptr) const;
  std::shared_ptr<Pair> find(Id id, TimeNs stamp_ns) const;
  void add_report(const std::shared_ptr<Pair>& pair, Id id, const ImageReport& report);
  void pass_stereo_partners_through(const std::shared_ptr<Pair>& pair, Id id, const std::string& why);
  Blocking blocking(const Pair& pair, Id id) const;
  /// Once an image is decided on: which of the others had been in time.
  void record_punctuality(const Pair& pair, Id id);
  std::string give_up(const std::shared_ptr<Pair>& pair, Id id, const Blocking& blocking, bool waited, bool deblurs);
  /// All cameras have reported.
  void agree(Pair* pair) const;
  /// What is decided on an image that is reported; nothing while it waits.
  /// @param waited  it has been asked about before
  std::optional<FrameAction> decide_reported(Id id, Wait* wait, const ImageReport& report, bool waited);

  std::mutex mutex_;  // everything below
  std::map<Id, Member> members_;
  std::deque<std::shared_ptr<Pair>> pairs_;  // by number
  std::uint64_t pairs_made_ = 0;
};

/// A camera's place in a rig; any thread. It takes part while its timeout is above 0.
class StereoCamera {
 public:
  /// @param name  in the messages of stereo partners
  StereoCamera(std::shared_ptr<StereoRig> rig, std::string name);
  ~StereoCamera();
  StereoCamera(const StereoCamera&) = delete;
  StereoCamera& operator=(const StereoCamera&) = delete;

  /// What to call when decide() may have an answer for an image that waits. Before set_timeout().
  /// @param wake  called with a lock held: it must not call back, nor wait for another lock under which the rig is
  /// called
  void set_wake(std::function<void()> wake) { wake_ = std::move(wake); }
  /// How long an image of it waits at most for its stereo partners. 0, as at first: it neither waits nor is waited for;
  /// partners that wait already go on.
  void set_timeout(TimeNs timeout_ns);

  /// An image has arrived; before any other report on it.
  void announce(TimeNs stamp_ns) { rig_->announce(this, stamp_ns); }
  /// Work on it begins.
  void begin(TimeNs stamp_ns) { rig_->begin(this, stamp_ns); }
  /// It passes through, whatever was reported before, unless the decision has been made.
  void pass_through(TimeNs stamp_ns, PassThroughReason reason);
  /// May the image be deblurred, and is it published? If it has blocks to deblur, it may have to wait for its stereo
  /// partners, at most for the timeout from the first call on. Then the call is repeated.
  /// @param field  validated
  /// @param drop_reasons  of a camera with drop_poor, which waits even if there is nothing to deblur
  /// @return reasons against both, with the stereo partner's name; empty: none; nothing: it waits
  std::optional<FrameAction> decide(TimeNs stamp_ns, const FrameBlur& field,
                                    const std::optional<DropReasons>& drop_reasons = {});
  /// When to ask again about the image that waits, if nothing wakes the camera before.
  std::optional<std::chrono::steady_clock::time_point> deadline() const { return rig_->deadline(this); }

 private:
  const std::shared_ptr<StereoRig> rig_;
  const std::string name_;
  std::function<void()> wake_;
};

}  // namespace gyro_deblur
