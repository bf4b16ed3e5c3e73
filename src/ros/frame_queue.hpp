// Frames that wait for what belongs to them, or to be processed, in order.
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

/// What may keep a frame waiting.
enum class Awaited { NOTHING, CAMERA_INFO, EXPOSURE, IMU, TRANSFORM, STEREO_PARTNER };

struct FrameInWork;

/// An image that the node has not published yet.
struct PendingFrame {
  sensor_msgs::ImageConstPtr image;              ///< never null
  sensor_msgs::CameraInfoConstPtr info;          ///< null until known
  std::optional<CameraCalibration> calibration;  ///< of info
  Lens lens = Lens::CALIBRATED;                  ///< of calibration, which is otherwise ideal_lens()
  bool described_by_topic = false;               ///< info came with the image, and not from a file
  TimeNs stamp_ns = 0;                           ///< camera clock
  std::shared_ptr<Picture> picture;              ///< that it shows; null while it is not known, and if not usable
  bool repeats = false;                          ///< an image before showed the same picture
  TimeNs arrival_ns = 0;                         ///< node clock (may be simulated time)
  TimeNs arrival_steady_ns = 0;                  ///< steady clock
  std::optional<TimeNs> ready_steady_ns;         ///< steady clock; since when it has all that it needs
  int epoch = 0;                                 ///< set by the queue; grows when time was reset
  /// Why the frame passes through unchanged; NONE: nothing speaks against deblurring it.
  PassThroughReason pass_through_reason = PassThroughReason::NONE;
  std::string pass_through_text;
  Awaited awaits = Awaited::NOTHING;  ///< when it was checked last
  bool timed_out = false;             ///< it waits for nothing any longer
  std::string missing_extrinsic;      ///< why it waits for the rotation between IMU and camera; empty: it does not
  bool partners_notified = false;     ///< to the stereo partners
  /// What has been done already of one that waits for its stereo partners: it is processed to the end. Otherwise null.
  std::shared_ptr<FrameInWork> in_work;

  /// Whether it may still come to pass through.
  bool is_undecided() const { return pass_through_reason == PassThroughReason::NONE && !in_work; }

  /// Stamp of the picture: of the first image that showed it.
  TimeNs picture_ns() const { return picture ? picture->stamp_ns : stamp_ns; }

  void pass_through(PassThroughReason reason, const std::string& text) {
    pass_through_reason = reason;
    pass_through_text = text;
  }
};

/// What a frame can do.
enum class Readiness {
  WAITS,         ///< for messages that may still come
  PASS_THROUGH,  ///< it is published unchanged, PendingFrame::pass_through_reason says why
  READY,         ///< it has what belongs to it
};

inline Readiness wait_for(Awaited awaited, PendingFrame* frame) {
  frame->awaits = awaited;
  return Readiness::WAITS;
}

inline Readiness pass_through(PendingFrame* frame, PassThroughReason reason, const std::string& text) {
  frame->pass_through(reason, text);
  return Readiness::PASS_THROUGH;
}

/// First in, first out; nothing is ever lost: a frame that cannot wait any longer passes through in order.
/// Not thread-safe.
class FrameQueue {
 public:
  /// Precondition: capacity >= 1, the frames that may wait.
  explicit FrameQueue(std::size_t capacity) : capacity_(capacity) {}

  void set_capacity(std::size_t capacity) { capacity_ = capacity; }

  /// Appends a frame; the oldest waiting ones beyond the capacity pass through as OVERLOAD.
  void push(PendingFrame frame);

  /// Passes the waiting frames through that are from before time was reset, see EpochCounter::reset.
  void pass_through_old(ShownBy shown_by, PassThroughReason reason, const std::string& text);

  bool empty() const { return frames_.empty(); }
  std::size_t size() const { return frames_.size(); }
  std::deque<PendingFrame>& frames() { return frames_; }
  PendingFrame& front() { return frames_.front(); }
  const PendingFrame& front() const { return frames_.front(); }

  /// Frames behind the foremost one that have all that they need.
  std::size_t ready_behind_front() const;

  /// Precondition: not empty.
  PendingFrame pop();

  /// The frame that pop() gave last cannot be published yet: it is the foremost one again.
  void put_back(PendingFrame frame) { frames_.push_front(std::move(frame)); }

 private:
  std::size_t capacity_;
  std::deque<PendingFrame> frames_;
  EpochCounter epochs_;
};

}  // namespace gyro_deblur
