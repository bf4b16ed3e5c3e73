// Brings together what belongs to a frame: calibration, exposure, gyroscope samples, extrinsic.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <Eigen/Geometry>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "pipeline/exposure_choice.hpp"
#include "ros/frame_queue.hpp"
#include "ros/input_buffers.hpp"
#include "sync/calibration_in_use.hpp"
#include "sync/input_problems.hpp"
#include "sync/overload.hpp"

namespace gyro_deblur {

/// A frame with all that processing it takes; copies, so that it needs no lock. The motion is that of its picture, but
/// for a frame that passes through.
struct SynchronizedFrame : PictureMotion {
  PendingFrame frame;
  std::shared_ptr<Pipeline> pipeline;    ///< null while the configuration cannot be used
  std::shared_ptr<const Config> config;  ///< as it is given; null as well
  bool drop_poor = false;
  bool behind_camera_rate = false;  ///< see OverloadRule::is_behind_camera_rate()
  PixelMask mask;                   ///< empty, or of the image's size
  /// The camera sends pictures again: what is made of this one is kept for them.
  bool pictures_repeat = false;
};

/// From messages to frames with all that belongs to them: add_image(), add_imu(), add_camera_info(), add_exposure() of
/// InputBuffers take messages in, next() gives frames out. Its owner serialises access.
class FrameSynchronizer : public InputBuffers {
 public:
  /// R_cam_imu for (camera frame, IMU frame), where tf has it.
  using Extrinsic = std::function<std::optional<Eigen::Matrix3d>(const std::string&, const std::string&)>;
  /// Exposures of the images that corners are followed from: by the tracker, and for the motion of blocks. They differ
  /// where nobody listens to tracks.
  using Followed = std::array<std::optional<TimeRange>, 2>;

  /// @param extrinsic  may be absent
  /// @param calibration, exposures  what holds for frames apart from messages; with problems they outlive this
  FrameSynchronizer(InputBuffers inputs, Extrinsic extrinsic, const CalibrationInUse* calibration,
                    const ExposureChoice* exposures, InputProblems* problems);

  /// Records which frames have become ready. After every message.
  void mark_ready();

  /// The foremost frame, ready or with the reason and text to pass it through; nothing while it has to wait.
  /// @param finishing  nothing is waited for any longer
  std::optional<SynchronizedFrame> next(const Followed& followed_cam, bool finishing);

  /// The frame that next() gave last has to wait for its stereo partners: it is the first again, with its in_work.
  void put_back(PendingFrame frame);
  /// Takes the foremost frame out again, if it was put back; else null.
  std::shared_ptr<FrameInWork> resume();

 private:
  const Config& config() const { return calibration_.config(); }

  /// The rule: records in `frame` what was found and whether it passes through, in `motion` when and how it was
  /// exposed, but for the samples: cheap enough for every message.
  Readiness decide(PendingFrame* frame, PictureMotion* motion) const;
  /// The frame's camera_info and calibration, from the topic or the calibration file.
  Readiness find_calibration(PendingFrame* frame) const;
  /// The frame's own camera_info, or a copy of its neighbours' where that is lost; null when there is none, or none of
  /// its neighbours' describes an image of this size.
  sensor_msgs::CameraInfoConstPtr best_info(const PendingFrame& frame) const;
  /// The camera_info of another image, or of all, that stands for the one of this stamp; null when there is none.
  /// @param give_up  the last one will do: none that is newer is waited for
  const sensor_msgs::CameraInfoConstPtr* find_other(TimeNs stamp_ns, bool give_up) const;
  /// The same with this image's stamp, where it describes an image of its size; else null.
  sensor_msgs::CameraInfoConstPtr substitute(const PendingFrame& frame, bool give_up) const;
  /// Why there is no camera_info for the frame. Precondition: there is none.
  std::string missing_info_text(const PendingFrame& frame) const;
  /// Whether optical flow alone moves images of this camera_info, because nothing describes the camera. A single
  /// message of zeros in a stream of others is a fault.
  bool goes_uncalibrated(const sensor_msgs::CameraInfo& info) const;
  Readiness find_exposure(PendingFrame* frame, PictureMotion* motion) const;
  /// Exposure and readout time from a message, a setting or the parameters.
  /// @param origin  of the exposure time
  Readiness find_timing(PendingFrame* frame, ShutterTiming* timing, ExposureOrigin* origin) const;
  /// The exposure time assumed until the blur has been examined.
  /// @param given  the exposure time of a message, a setting or the parameter; 0: not known
  Readiness plan_exposure(TimeNs given_ns, ExposureOrigin origin, PendingFrame* frame, ExposurePlan* plan) const;
  /// Whether samples have come up to the frame's end, or will not. Precondition: the exposure is known.
  Readiness find_samples(PendingFrame* frame, PictureMotion* motion) const;
  /// The rotation from the parameters, the calibration file, tf or the images.
  Readiness find_extrinsic(PendingFrame* frame, PictureMotion* motion) const;
  void collect(const Followed& followed_cam, PictureMotion* motion) const;
  /// Counts an image that is taken out of the queue before samples of its exposure have come.
  void record_lacking_samples(const PendingFrame& frame, const PictureMotion& motion);
  /// Lets a frame pass through that comes too late to be processed.
  void check_overload(TimeNs steady_ns, PendingFrame* frame, SynchronizedFrame* synchronized) const;
  const Extrinsic extrinsic_;
  const CalibrationInUse& calibration_;
  const ExposureChoice& exposures_;
  InputProblems& problems_;
  OverloadRule overload_;
};

}  // namespace gyro_deblur
