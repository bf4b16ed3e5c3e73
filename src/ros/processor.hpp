// From messages to messages: what the nodelet and deblur_bag have in common. Knows no node handle, topic or publisher.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <nav_msgs/Odometry.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud.h>
#include <sensor_msgs/Range.h>
#include <visualization_msgs/MarkerArray.h>

#include "gyro_deblur/config.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "ros/frame_queue.hpp"
#include "ros/gyro_source.hpp"
#include "ros/messages.hpp"
#include "ros/throttled_log.hpp"
#include "ros/time_jump.hpp"
#include "ros/translation_input.hpp"

namespace gyro_deblur {

/// A mean of fewer samples says little about a bias.
constexpr std::size_t kMinBiasSamples = 20;

/// What somebody wants of a frame; nothing else is computed.
struct FrameRequest {
  bool image = true;
  bool keypoints = true;
  bool overlay = false;
  bool markers = false;
  bool tracks = false;
};

/// A frame on its way out: one for every frame that came in, in the same order.
struct FrameOutput {
  sensor_msgs::ImageConstPtr input;
  sensor_msgs::ImageConstPtr image;             ///< the very input message when no pixel was changed
  sensor_msgs::CameraInfoConstPtr camera_info;  ///< the input's; one that is not calibrated when there was none
  BlurFieldPtr blur_field;
  KeypointArrayPtr keypoints;                  ///< null when not requested
  sensor_msgs::ImagePtr overlay;               ///< null when not requested, or without a blur field
  visualization_msgs::MarkerArrayPtr markers;  ///< null when not requested
  sensor_msgs::PointCloudPtr tracks;           ///< null when not requested, or when the pipeline did not run
  PassThroughReason reason = PassThroughReason::NONE;
  std::string reason_text;
  std::optional<FrameBlur> field;  ///< of the core; absent when the pipeline did not run
  bool translated = false;         ///< odometry and depth were used
  std::string translation_text;    ///< why not, where an odometry is expected; else empty
  StageTimes stages;               ///< [ms]
  double tracks_ms = 0;            ///< of following corners
  double waiting_ms = 0;           ///< steady time in the queue
  double messages_ms = 0;          ///< conversion from and to messages, overlay and markers
  double total_ms = 0;             ///< of processing, without waiting
};

/// Counters since the start; those of the IMU since that of its source.
struct ProcessorStatistics : ImuStatistics {
  std::size_t frames_in = 0;
  std::size_t frames_out = 0;
  std::map<PassThroughReason, std::size_t> passed_through;
  std::map<BlockStatus, std::size_t> blocks;  ///< of the frames that were not passed through
  std::size_t odometry_refused = 0;
  std::size_t frames_translated = 0;      ///< whose blur field has the odometry's translation
  std::size_t frames_not_translated = 0;  ///< without, though an odometry is there
  std::string translation_text;           ///< why the newest of those is without
  std::size_t time_jumps = 0;
  std::size_t waiting = 0;              ///< frames in the queue now
  std::optional<TimeNs> newest_imu_ns;  ///< IMU clock
  TimeRange gyro_available;             ///< IMU clock
  std::string engine;                   ///< empty while the configuration cannot be used
  std::string configuration_error;      ///< empty when it can
};

/// Takes messages in (from any thread), and gives frames out in order (to the one thread at a time that calls advance).
class Processor {
 public:
  /// Where the outside world comes in. None may call back into the processor: most are called with a lock held.
  struct Environment {
    std::function<TimeNs()> clock;  ///< node clock (ros::Time, or the time of a bag), required
    Log log;                        ///< required
    /// Samples that others use as well; whoever adds to it calls notice_imu. Absent: one of its own, for add_imu.
    std::shared_ptr<GyroSource> gyro;
    /// A clock that keeps going when a simulated one stops; absent: frames wait for `clock` alone.
    std::function<TimeNs()> steady_clock;
    /// R_cam_imu for (camera frame, IMU frame); absent: from the configuration only.
    std::function<std::optional<Eigen::Matrix3d>(const std::string&, const std::string&)> extrinsic;
    /// Pose of a body in the camera's frame, for (camera frame, body frame); absent: from the configuration only.
    TranslationInput::Transform transform;
    /// True when somebody will send exposure messages. Once one has come they are expected anyway.
    std::function<bool()> exposure_expected;
    /// What is wanted of the frame that is about to be processed; absent: image and keypoints.
    std::function<FrameRequest()> request;
    /// Absent: make_engine.
    EngineFactory make_engine;
  };
  /// Takes a frame; false: enough for now, the rest stays.
  using Sink = std::function<bool(FrameOutput&&)>;

  /// Frames are passed through with BAD_CONFIGURATION until set_config succeeds.
  explicit Processor(Environment environment);

  /// Throws OptionError and keeps the former configuration when the new one cannot be used. A bias that was estimated
  /// stays in use. An engine is made only when engine or threads change; what else has to be rebuilt is when the next
  /// frame is processed, by the thread that does so: many changes in a row cost no more than one.
  void set_config(const Config& config);
  /// From now on frames pass through with BAD_CONFIGURATION and this text.
  void set_config_error(const std::string& text);

  void add_imu(const sensor_msgs::Imu& imu);
  /// A shared source has taken this message in.
  void notice_imu(const sensor_msgs::Imu& imu);
  void add_exposure(const Exposure& exposure);
  /// A setting that holds for the images from now on, until the next.
  void add_exposure_setting(TimeNs exposure_ns);
  void add_camera_info(const sensor_msgs::CameraInfoConstPtr& info);
  /// Velocity and depth of the scene. Frames never wait for them: they may come from the frames themselves.
  void add_odometry(const nav_msgs::Odometry& odometry);
  void add_scene_depth(const sensor_msgs::Range& depth);
  void add_image(const sensor_msgs::ImageConstPtr& image);

  /// Hands every frame that can leave to `sink`. Exceptions of processing become INTERNAL_ERROR; those of `sink` pass.
  void advance(const Sink& sink);
  /// The same for all frames, with what is there: nothing more will come.
  void finish(const Sink& sink);

  /// Frames that have not left.
  std::size_t waiting() const;

  /// As after the start: waiting frames leave as TIME_JUMP, samples and an estimated bias are forgotten.
  void reset();

  /// Averages the newest samples over the configured window and uses the result as bias.
  /// @return true, and the bias in `text`; false with the cause in `text` when the sensor moved or samples are missing
  bool estimate_bias(std::string* text);

  /// Bias in use [rad/s].
  Eigen::Vector3d bias_rad_s() const;

  ProcessorStatistics statistics() const;

 private:
  /// The newest messages of a kind by their stamp.
  template <typename T>
  class StampedStore {
   public:
    void add(TimeNs stamp_ns, T value, std::size_t capacity) {
      entries_.push_back({stamp_ns, epochs_.next(stamp_ns), std::move(value)});
      while (entries_.size() > capacity) entries_.pop_front();
    }
    const T* find(TimeNs stamp_ns) const {
      for (auto entry = entries_.rbegin(); entry != entries_.rend(); ++entry) {
        if (entry->stamp_ns == stamp_ns) return &entry->value;
      }
      return nullptr;
    }
    /// The newest with a stamp in [oldest_ns, stamp_ns).
    const T* find_before(TimeNs stamp_ns, TimeNs oldest_ns) const {
      const Entry* best = nullptr;
      for (const Entry& entry : entries_) {
        if (entry.stamp_ns < oldest_ns || entry.stamp_ns >= stamp_ns) continue;
        if (best == nullptr || entry.stamp_ns > best->stamp_ns) best = &entry;
      }
      return best == nullptr ? nullptr : &best->value;
    }
    void clear() { drop_before(epochs_.begin()); }
    /// See EpochCounter::reset.
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

  /// What processing a frame takes; a copy, so that it needs no lock.
  struct Job {
    PendingFrame frame;
    FrameRequest request;
    std::shared_ptr<Pipeline> pipeline;
    PipelineOptions options;
    bool rectified_input = false;
    std::optional<RowExposure> exposure;
    std::vector<GyroSample> samples;
    GyroOptions gyro;
    Eigen::Matrix3d R_cam_imu = Eigen::Matrix3d::Identity();
    std::string coverage_text;
    std::shared_ptr<FeatureTracker> tracker;
    TrackerOptions tracker_options;
    std::vector<GyroSample> tracker_samples;  // from the frame that the tracker saw last to this one
    std::optional<TranslationJob> translation;
    std::string translation_text;
  };

  void advance(const Sink& sink, bool finishing);
  /// The job of the foremost frame, or nothing while it has to wait.
  std::optional<Job> next_job(bool finishing);
  /// The frame's camera_info and calibration, from the topic or the calibration file. True when the frame needs not
  /// wait for them; settles it when they cannot be used.
  bool find_calibration(PendingFrame& frame, bool timed_out);
  /// The rotation from the parameters, the calibration file or tf, by the same rule.
  bool find_extrinsic(PendingFrame& frame, bool timed_out, Eigen::Matrix3d* R_cam_imu);
  /// True when the frame needs not wait any longer; settles it when it cannot be processed.
  bool prepare(PendingFrame& frame, bool timed_out, Job* job);
  FrameOutput process(const Job& job) const;
  void run_pipeline(const Job& job, FrameOutput* output) const;
  /// Keypoints of a frame that passes through; an empty array when it can have none.
  KeypointArrayPtr raw_keypoints(const Job& job, PassThroughReason reason) const;

  void handle(TimeJumpDetector::Verdict verdict, Stream stream, TimeNs from_ns, TimeNs to_ns);
  void note_time(Stream stream, TimeNs stamp_ns);
  /// What the source of samples has done since.
  void note_imu();
  /// Drops what the stream brought before time was reset: all that has come when its own next message shows the reset.
  enum class ShownBy { ITSELF, OTHER };
  void forget(Stream stream, ShownBy shown_by);
  TimeNs now();
  TimeNs steady_now() const { return environment_.steady_clock ? environment_.steady_clock() : 0; }
  std::size_t store_size() const;

  const Environment environment_;
  ThrottledLog log_;
  const std::shared_ptr<GyroSource> gyro_source_;  // locks itself; taken after mutex_
  std::mutex advance_mutex_;                       // one thread at a time takes frames out; taken before mutex_

  mutable std::mutex mutex_;  // everything below
  std::optional<Config> config_;
  std::string config_error_ = "not configured yet";
  std::shared_ptr<Pipeline> pipeline_;
  std::optional<Eigen::Vector3d> estimated_bias_rad_s_;
  TimeJumpDetector jumps_;
  GyroReader gyro_;
  StampedStore<Exposure> exposures_;
  StampedStore<sensor_msgs::CameraInfoConstPtr> infos_;
  bool exposure_seen_ = false;
  std::optional<TimeNs> exposure_setting_ns_;
  TranslationInput translation_;
  bool info_seen_ = false;
  FramePeriod frame_period_;
  FrameQueue queue_;
  std::shared_ptr<FeatureTracker> tracker_;  // used by the thread that holds advance_mutex_ alone
  std::size_t in_progress_ = 0;
  ProcessorStatistics statistics_;
};

}  // namespace gyro_deblur
