// Frames that the node has not published yet, in the order of their arrival.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/time.hpp"
#include "ros/picture.hpp"
#include "sync/pass_through.hpp"
#include "sync/time_jump.hpp"

namespace gyro_deblur {

/// What a frame waits for.
enum class Awaited { NOTHING, CAMERA_INFO, EXPOSURE, IMU, TRANSFORM, STEREO_PARTNER };

struct FrameInWork;

/// An image that the node has not published yet.
struct PendingFrame {
  sensor_msgs::ImageConstPtr image;              ///< never null
  sensor_msgs::CameraInfoConstPtr info;          ///< null until known
  std::optional<CameraCalibration> calibration;  ///< of info
  Lens lens = Lens::CALIBRATED;                  ///< source of calibration, which is ideal_lens() unless CALIBRATED
  bool described_by_topic = false;               ///< info is from the topic, not from a file
  TimeNs stamp_ns = 0;                           ///< camera clock
  std::shared_ptr<Picture> picture;              ///< that the image shows; null if the image is not usable
  bool repeats = false;                          ///< an earlier image showed the same picture
  TimeNs arrival_ns = 0;                         ///< node clock (may be simulated time)
  TimeNs arrival_steady_ns = 0;                  ///< steady clock
  std::optional<TimeNs> ready_steady_ns;         ///< steady clock; when its inputs became complete, if they are
  int epoch = 0;                                 ///< set by FrameQueue::push, see EpochCounter
  /// Why the frame passes through unchanged; NONE: it may be deblurred.
  PassThroughReason pass_through_reason = PassThroughReason::NONE;
  std::string pass_through_text;
  Awaited awaits = Awaited::NOTHING;  ///< as of the last check
  bool timed_out = false;             ///< inputs that have not come are no longer waited for
  std::string missing_extrinsic;      ///< why the frame waits for the extrinsic; empty: it does not
  bool partners_notified = false;     ///< the stereo rig knows that the frame passes through
  /// Results so far, if the frame waits for its stereo partners in the middle of its processing; otherwise null.
  std::shared_ptr<FrameInWork> in_work;

  /// Whether the queue may still pass it through.
  bool is_undecided() const { return pass_through_reason == PassThroughReason::NONE && !in_work; }

  /// Stamp of the first image that showed the same picture.
  TimeNs picture_ns() const { return picture ? picture->stamp_ns : stamp_ns; }

  void pass_through(PassThroughReason reason, const std::string& text) {
    pass_through_reason = reason;
    pass_through_text = text;
  }
};

/// What to do with a frame.
enum class Readiness {
  WAITS,         ///< an input is missing that may still come
  PASS_THROUGH,  ///< publish it unchanged, see PendingFrame::pass_through_reason
  READY,         ///< process it: all inputs are there
};

inline Readiness wait_for(Awaited awaited, PendingFrame* frame) {
  frame->awaits = awaited;
  return Readiness::WAITS;
}

inline Readiness pass_through(PendingFrame* frame, PassThroughReason reason, const std::string& text) {
  frame->pass_through(reason, text);
  return Readiness::PASS_THROUGH;
}

/// First in, first out. No frame is lost: one that cannot wait any longer passes through, in its turn. Not thread-safe.
class FrameQueue {
 public:
  /// @param capacity  frames that may wait, >= 1
  explicit FrameQueue(std::size_t capacity) : capacity_(capacity) {}

  void set_capacity(std::size_t capacity) { capacity_ = capacity; }

  /// Appends a frame. If more than the capacity wait, the oldest of them pass through as OVERLOAD.
  void push(PendingFrame frame);

  /// Time was reset: waiting frames of an earlier epoch pass through, see EpochCounter::reset.
  void pass_through_old(ShownBy shown_by, PassThroughReason reason, const std::string& text);

  bool empty() const { return frames_.empty(); }
  std::size_t size() const { return frames_.size(); }
  std::deque<PendingFrame>& frames() { return frames_; }
  PendingFrame& front() { return frames_.front(); }
  const PendingFrame& front() const { return frames_.front(); }

  /// Number of frames behind the foremost one whose inputs are complete.
  std::size_t ready_behind_front() const;

  /// Precondition: not empty.
  PendingFrame pop();

  /// Makes the frame that pop() returned last the foremost one again.
  void put_back(PendingFrame frame) { frames_.push_front(std::move(frame)); }

 private:
  std::size_t capacity_;
  std::deque<PendingFrame> frames_;
  EpochCounter epochs_;
};

}  // namespace gyro_deblur
