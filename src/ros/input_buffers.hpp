// Keeps the messages that frames wait for; notices that time was reset.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/exposure.hpp"
#include "ros/frame_queue.hpp"
#include "ros/messages.hpp"
#include "ros/picture.hpp"
#include "ros/repetition_watch.hpp"
#include "sync/clock_check.hpp"
#include "sync/gyro_source.hpp"
#include "sync/input_problems.hpp"
#include "sync/missing_inputs.hpp"
#include "sync/per_image_messages.hpp"
#include "sync/time_jump.hpp"

namespace gyro_deblur {

/// What has come in since the start.
struct InputStatistics {
  std::size_t frames_in = 0;
  std::size_t repeated_pictures = 0;   ///< frames that show the picture of the one before
  std::size_t undecodable_images = 0;  ///< compressed ones that are left out; not among frames_in
  std::size_t time_jumps = 0;
};

/// Equal in all but the stamp (and the sequence number).
struct SameCameraInfo {
  bool operator()(const sensor_msgs::CameraInfoConstPtr& a, const sensor_msgs::CameraInfoConstPtr& b) const;
};
struct SameExposure {
  bool operator()(const Exposure& a, const Exposure& b) const;
};

/// Stores messages by their stamps until a frame has what belongs to it. Its owner serialises access.
class InputBuffers {
 public:
  struct Clocks {
    std::function<TimeNs()> node;    ///< ros::Time, or the time of a bag
    std::function<TimeNs()> steady;  ///< keeps going when a simulated clock stops; may be absent
  };

  /// @param exposure_sender  true when somebody will send exposure messages; may be absent
  /// @param problems  has to outlive this
  InputBuffers(Clocks clocks, std::shared_ptr<GyroSource> gyro_source, std::function<bool()> exposure_sender,
               InputProblems* problems);

  void set_config(const Config& config);
  /// From now on frames pass through with BAD_CONFIGURATION and this text.
  void set_config_error(const std::string& text) { config_error_ = text; }
  /// Empty while the configuration can be used.
  const std::string& config_error() const { return config_error_; }

  void add_exposure(const Exposure& exposure);
  /// @param exposure_ns  0: the driver does not know
  void add_exposure_setting(TimeNs exposure_ns);
  void add_camera_info(const sensor_msgs::CameraInfoConstPtr& info);
  /// Precondition of the frame: image, stamp, and a reason to pass through if it is not usable. A stamp of 0 says
  /// nothing about time.
  void add_image(PendingFrame frame);
  /// Samples have come to the source.
  void add_imu() { now(); }
  /// A compressed image that cannot be decoded is left out.
  void count_undecodable(const std::string& text);

  /// No more images will come: none is kept to compare the next one with.
  void forget_picture() { pictures_.forget(); }

  /// As after the start: waiting frames pass through as TIME_JUMP.
  void reset();

  /// Nothing more will come: reports what never has.
  void finish() { missing_.finish(config_, seen()); }

  /// Reads the clock, and notices what it and the source of samples have done since.
  TimeNs now();
  TimeNs steady_now() const { return clocks_.steady ? clocks_.steady() : 0; }
  /// True when a frame has waited for input_timeout (by the node's clock, or several times that by the steady one).
  bool has_timed_out(const PendingFrame& frame, TimeNs now_ns) const;

  FrameQueue& queue() { return queue_; }
  const FrameQueue& queue() const { return queue_; }

  using CameraInfos = PerImageMessages<sensor_msgs::CameraInfoConstPtr, SameCameraInfo>;
  using Exposures = PerImageMessages<Exposure, SameExposure>;
  const CameraInfos& infos() const { return infos_; }
  /// Whether a camera_info had a calibration since the start.
  bool has_been_calibrated() const { return calibrated_; }
  const Exposures& exposures() const { return exposures_; }
  /// True when images have exposure messages, or somebody will send some.
  bool exposure_expected() const;
  /// Exposure time of the newest setting; 0: the driver does not know it.
  std::optional<TimeNs> exposure_setting_ns() const { return exposure_setting_ns_; }
  /// The exposure time is known from the images.
  void set_exposure_from_images() { exposure_of_images_ = true; }
  bool has_exposure_from_images() const { return exposure_of_images_; }
  /// Of new pictures: repeated ones leave it as it is.
  const FramePeriod& frame_period() const { return frame_period_; }
  const GyroReader& gyro() const { return gyro_; }
  std::string imu_frame() const { return gyro_source_->frame_id(); }
  /// True while the IMU is expected to follow a reset of time: what it brings is still old.
  bool imu_is_stale() const { return jumps_.is_stale(Stream::IMU); }
  /// An image is passed through whose exposure began after the newest sample.
  /// @param begin_ns  IMU clock
  void count_without_imu(TimeNs begin_ns);
  /// There have been a few of these images in a row and no sample since, and the newest one is a second older than this
  /// exposure, or there is none: images no longer wait for samples.
  bool imu_is_silent(TimeNs begin_ns) const;
  /// An image is published with all that belongs to it, `options` of its gyroscope.
  void record_repetition(const PendingFrame& frame, const GyroOptions& options) {
    repetitions_.add(frame, gyro_, options, statistics_.repeated_pictures, statistics_.frames_in);
  }
  const InputStatistics& statistics() const { return statistics_; }

 private:
  void handle(TimeJumpDetector::Result result, Stream stream, TimeNs from_ns, TimeNs to_ns);
  void record_time(Stream stream, TimeNs stamp_ns);
  /// What the source of samples has done since.
  void record_imu();
  /// Drops what the stream brought before time was reset: all that has come when its own next message shows the reset.
  void forget(Stream stream, ShownBy shown_by);
  std::size_t store_size() const;
  /// Notes in the frame which picture it shows.
  void find_picture(PendingFrame* frame);
  /// Stops waiting for per-image messages that do not come, and reports it.
  void record_liveness(TimeNs now_ns);
  MissingInputs::Seen seen() const;
  /// Reports an exposure time of a message or a setting that cannot be used.
  void check_exposure(ExposureOrigin origin, TimeNs exposure_ns);
  /// Reports parameters that the frame period contradicts.
  void check_parameters();

  const Clocks clocks_;
  const std::shared_ptr<GyroSource> gyro_source_;  // locks itself
  const std::function<bool()> exposure_sender_;
  InputProblems& problems_;
  Config config_;
  std::string config_error_ = "not configured yet";
  TimeJumpDetector jumps_;
  GyroReader gyro_;
  Exposures exposures_;
  CameraInfos infos_;
  bool calibrated_ = false;
  std::optional<TimeNs> exposure_setting_ns_;
  PictureTracker pictures_;
  RepetitionWatch repetitions_;
  bool exposure_known_ = false;       // from a message or a setting
  bool exposure_of_images_ = false;   // from the images' blur
  std::size_t without_imu_ = 0;       // images in a row, and no sample since
  bool setting_lacks_stamp_ = false;  // the setting is a message of a single image that lacks its stamp
  MissingInputs missing_;
  ClockCheck clocks_apart_;
  FramePeriod frame_period_;
  FrameQueue queue_;
  InputStatistics statistics_;
};

}  // namespace gyro_deblur
