// From messages to messages: what the nodelet and deblur_bag have in common. Knows no node handle, topic or publisher.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>

#include "engine/engine.hpp"
#include "features/gyro_unit_watch.hpp"
#include "features/residual_rotation.hpp"
#include "features/track_rectification.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "ros/frame_synchronizer.hpp"
#include "ros/image_conversion.hpp"
#include "ros/input_mask.hpp"
#include "ros/messages.hpp"
#include "ros/processing.hpp"
#include "ros/self_calibrator.hpp"
#include "ros/statistics.hpp"
#include "sync/calibration_in_use.hpp"
#include "sync/gyro_source.hpp"
#include "sync/input_problems.hpp"
#include "sync/stereo_rig.hpp"
#include "sync/work_signal.hpp"

namespace gyro_deblur {

/// A frame that is being processed, with its results so far.
struct FrameInWork {
  explicit FrameInWork(SynchronizedFrame frame) : synchronized(std::move(frame)) {}

  SynchronizedFrame synchronized;
  FrameRequest request;
  FrameOutput output;
  TimeNs idle_since_ns = 0;  ///< steady clock; when it came, or was put back into the queue
  ImageView view;            ///< of the image; set by begin(), as is rotation
  std::optional<RotationTrack> rotation;
  double preparation_ms = 0;  ///< of set-up, before its blur is predicted
  ChosenExposure chosen;
  std::shared_ptr<const MadePicture> made;  ///< result of an earlier image of the same picture, or null
  /// Without `made`: the validated blur, in the pipeline; null until validate().
  const PipelineResult* validated = nullptr;
};

/// The steps of a frame and their locks: messages go into the input buffers (from any thread), a frame is synchronised
/// from what is there, processed, and given out, in order (to the one thread that calls advance and finish).
class Processor {
 public:
  /// Where the outside world comes in. None may call back into the processor: most are called with a lock held.
  struct Environment {
    std::function<TimeNs()> clock;  ///< node clock (ros::Time, or the time of a bag), required
    Log log;                        ///< required
    /// Samples that others use as well; whoever adds to it calls on_imu_sample. Absent: one of its own, for add_imu.
    std::shared_ptr<GyroSource> gyro;
    /// The camera's place in a stereo rig; absent: it has no stereo partners.
    std::shared_ptr<StereoCamera> stereo;
    /// A clock that keeps going when a simulated one stops, by which processing keeps up or not. Absent: frames wait
    /// for `clock` alone, and there is all the time of the world to process them.
    std::function<TimeNs()> steady_clock;
    /// R_cam_imu for (camera frame, IMU frame); absent: from the configuration only.
    FrameSynchronizer::Extrinsic extrinsic;
    /// True when somebody will send exposure messages. Once one has come they are expected anyway.
    std::function<bool()> exposure_expected;
    /// What is wanted of the frame that is about to be processed; absent: image and keypoints.
    std::function<FrameRequest()> request;
    /// Absent: make_engine.
    EngineFactory make_engine;
    /// Where a calibration that is not given is estimated.
    SelfCalibrator::Work self_calibration = SelfCalibrator::Work::AT_ONCE;
    /// What was learned before of images of this width and height; asked once. Absent: nothing.
    std::function<std::optional<LearnedCalibration>(int, int)> stored_calibration;
  };
  /// Takes a frame; false: enough for now, the rest stays.
  using Sink = std::function<bool(FrameOutput&&)>;

  /// Frames are passed through with BAD_CONFIGURATION until set_config succeeds.
  explicit Processor(Environment environment);

  /// Throws OptionError and keeps the former configuration when the new one cannot be used. What was estimated from
  /// images stays in use. An engine is made only when engine or threads change; what else has to be rebuilt is when the
  /// next frame is processed, by the thread that does so: many changes in a row cost no more than one.
  void set_config(const Config& config);
  /// From now on frames pass through with BAD_CONFIGURATION and this text.
  void set_config_error(const std::string& text);

  void add_imu(const sensor_msgs::Imu& imu);
  /// A message has come to a shared source.
  void on_imu_sample();
  void add_exposure(const Exposure& exposure);
  /// A setting that holds for the images from now on, until the next.
  void add_exposure_setting(TimeNs exposure_ns);
  void add_camera_info(const sensor_msgs::CameraInfoConstPtr& info);
  /// @param problem  why its pixels cannot be used; empty: they can
  void add_image(const sensor_msgs::ImageConstPtr& image, const std::string& problem = {});
  /// @return true when a frame came in; false when the image cannot be decoded: it is counted, and has no output
  bool add_compressed_image(const sensor_msgs::CompressedImage& compressed);
  /// Replaces the configuration's mask, see InputMask.
  void add_mask(const sensor_msgs::Image& mask);
  /// Reports a message that could not be read; an empty text ends the report.
  void record_unreadable(const std::string& kind, const std::string& text);

  /// Hands every frame that is finished to `sink`. Exceptions of processing become INTERNAL_ERROR; those of `sink`
  /// pass.
  /// @param finishing  all frames, with what is there
  void advance(const Sink& sink, bool finishing = false);
  /// advance() for all frames: nothing more will come.
  void finish(const Sink& sink);

  /// Sleeps until advance() may have something to do, for at most `poll` while frames wait: timeouts come without a
  /// message. For the thread that calls advance().
  /// @return false after stop()
  bool wait(std::chrono::nanoseconds poll);
  /// Ends wait() if frames wait: something else than a message of theirs may have made one ready.
  void wake();
  /// Ends wait() for good, and advance() after the frame in progress.
  void stop() { signal_->stop(); }

  /// Frames that are not published yet.
  std::size_t waiting() const;
  /// What the foremost of them waits for, as of the last call of advance.
  Awaited awaited() const;

  /// Waiting frames pass through as TIME_JUMP, except one that waits for its stereo partner. Samples are forgotten.
  /// What was estimated from images stays.
  void reset();

  void reset_calibration();

  /// The calibration estimated from the images and in use, for images of this size.
  struct CalibrationByImages {
    LearnedCalibration calibration;
    int width_px = 0, height_px = 0;
  };
  /// Nothing before the first image.
  std::optional<CalibrationByImages> calibration_by_images() const;

  ProcessorStatistics statistics() const;

 private:
  /// Reports what of the calibration file was not understood. Needs mutex_.
  void record_calibration_file();
  /// The foremost frame with what belongs to it, or null while it has to wait.
  std::shared_ptr<FrameInWork> next_frame(bool finishing);
  std::optional<SynchronizedFrame> synchronize(bool finishing);  // needs mutex_
  /// The frame waits for its stereo partners. Takes mutex_.
  void put_back(const std::shared_ptr<FrameInWork>& work);
  /// Locks mutex_, calls add(), which gives a message to the synchronizer, and ends wait().
  template <typename Add>
  void take_in(Add add);
  void notify_worker();                                                                       // needs mutex_
  std::size_t frames_waiting() const { return synchronizer_.queue().size() + in_progress_; }  // needs mutex_
  /// Stereo partners need not wait until frames that pass through are published. Needs mutex_.
  void notify_stereo();
  /// Makes the output of a frame. Exceptions of the pipeline become INTERNAL_ERROR; those of passing the frame through
  /// (for lack of memory) pass.
  /// @return false: it waits for its stereo partners, and has to be processed again
  bool process(FrameInWork* work);
  /// What is done with a frame that is ready, by its validated blur; nothing while it waits for its stereo partners.
  std::optional<FrameAction> examine(FrameInWork* work);
  void begin(FrameInWork* work);
  /// Estimates the frame's blur, and validates it by the exposure that is chosen then.
  void validate(FrameInWork* work);
  void deblur(const FrameAction& action, FrameInWork* work);
  void set_up_pipeline(const SynchronizedFrame& synchronized);
  /// What the frame is deblurred by; its picture goes by that from now on. Takes mutex_.
  ChosenExposure choose_exposure(const SynchronizedFrame& synchronized, const PipelineResult& estimated);
  /// What is done with a frame that has this validated field; nothing while it waits for its stereo partners.
  std::optional<FrameAction> decide(const SynchronizedFrame& synchronized, const FrameBlur& field) const;
  void add_result(const FrameAction& action, PipelineResult result, FrameInWork* work);
  /// Corners followed from the image before, as they are in the image and at the reference time.
  void add_tracks(const RowExposure& exposure, const PipelineResult& result, FrameInWork* work);
  /// What a published frame has in any case.
  void complete(FrameInWork* work);
  /// Keypoints of a frame that passes through; an empty array when it can have none.
  void add_raw_keypoints(const SynchronizedFrame& synchronized, FrameOutput* output);
  /// Uses what is stored for images of this size. Needs mutex_.
  void remember_calibration(const sensor_msgs::Image& image);
  /// Learns the calibration from the frame. Takes mutex_.
  /// @param found  what the frame was deblurred by, where its blur was examined
  void learn_from(const SynchronizedFrame& synchronized, const std::optional<FrameExposure>& found);
  /// Reports when the images give the exposure time, and when they contradict the given one. Needs mutex_.
  void record_exposure(const FrameOutput& output);
  /// Stamps of global-shutter images are not those that came in, and grow all the same.
  void keep_global_shutter_in_order(FrameOutput* output);
  void record_static_content(const FrameOutput& output);
  void record(const FrameOutput& output);
  /// Reports when images do not rotate as the gyroscope says. Needs mutex_.
  void check_gyro_unit(const FrameOutput& output);

  const Environment environment_;
  InputProblems problems_;                         // locks itself
  const std::shared_ptr<GyroSource> gyro_source_;  // locks itself; taken after mutex_
  /// Locks itself; taken after all others. The stereo rig has it, too.
  const std::shared_ptr<WorkSignal> signal_ = std::make_shared<WorkSignal>();

  // Of the thread that calls advance alone.
  FeatureTracker tracker_;
  TrackRectifier track_rectifier_;
  std::shared_ptr<const Config> config_of_pipeline_;  // that its options are from
  std::optional<TimeNs> newest_learned_ns_;           // newest sample that self-calibration has
  struct MovedStamp {
    TimeNs input_ns, output_ns;
  };
  std::optional<MovedStamp> last_moved_, last_moved_tracks_;  // of the newest global-shutter image and tracks

  mutable std::mutex mutex_;              // everything below
  std::shared_ptr<const Config> config_;  // as it is given; null while it cannot be used
  std::shared_ptr<Pipeline> pipeline_;
  SelfCalibrator self_calibrator_;  // locks itself
  CalibrationInUse calibration_;
  std::size_t time_jumps_ = 0;           // that exposures_ has been reset for
  std::size_t calibration_updates_ = 0;  // of the former, that the latter has
  double readout_share_ = 1;             // see CalibrationInUse::learn
  bool readout_by_messages_ = false;     // see there
  std::optional<cv::Size> image_size_;   // of the first image
  InputMask mask_;
  ExposureChoice exposures_;
  FrameSynchronizer synchronizer_;
  std::size_t in_progress_ = 0;
  OutputStatistics statistics_;
  GyroErrorWatch gyro_errors_;  // with the configuration and bias in use
  GyroUnitWatch gyro_unit_;
  bool gyro_unit_is_wrong_ = false;
};

}  // namespace gyro_deblur
