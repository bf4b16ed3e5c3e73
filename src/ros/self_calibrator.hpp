// Learns a camera's calibration from its images and samples, while frames are processed.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include <sensor_msgs/Image.h>

#include "calibrate/image_rate.hpp"
#include "calibrate/self_calibration.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/pixel_mask.hpp"
#include "gyro_deblur/time.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// Thread-safe. Nothing of it waits for the work that it does in the background.
class SelfCalibrator {
 public:
  enum class Work {
    AT_ONCE,        ///< in add(): the same images give the same values under any processor load
    IN_BACKGROUND,  ///< on a thread of low priority, which leaves images out when it cannot keep up
  };

  /// @param problems  has to outlive this
  SelfCalibrator(Work work, InputProblems* problems);
  ~SelfCalibrator();
  SelfCalibrator(const SelfCalibrator&) = delete;
  SelfCalibrator& operator=(const SelfCalibrator&) = delete;

  struct Image {
    sensor_msgs::ImageConstPtr image;  ///< not null, of the calibration's size
    CameraCalibration calibration;
    RowExposure exposure;  ///< with what is known of it: see LearnedCalibration::time_offset_s
    PixelMask mask;        ///< empty, or of the image's size
    bool lens_known;       ///< see ImageRateTracker::add()
  };

  /// The time offset is looked for around this. Another one than before makes it forget.
  void set_expected_offset(TimeNs offset_ns);

  /// @param samples  that have come since the call before, IMU clock
  /// @param image    of the camera, in the order of time; of images at more than 30 Hz some are left out
  void add(std::vector<GyroSample> samples, Image image);

  LearnedCalibration learned() const;
  /// How often it has learned something since the start.
  std::size_t updates() const;

  /// Time has been reset, see SelfCalibration::restart().
  void restart();
  /// Forgets everything.
  void clear();

 private:
  struct Job {
    enum class Kind { IMAGE, RESTART, CLEAR } kind = Kind::IMAGE;
    std::size_t clears = 0;           // when it came
    TimeNs expected_offset_ns = 0;    // of CLEAR
    std::vector<GyroSample> samples;  // before the image
    std::optional<Image> image;
  };
  void forget(Job::Kind kind);  // needs mutex_
  void work();
  /// Runs the first job, which leaves the queue. Gives the lock of mutex_ back meanwhile.
  void run_first(std::unique_lock<std::mutex>* lock);
  void run(const Job& job);
  void look_at(const Image& image);

  const Work work_;
  InputProblems& problems_;

  mutable std::mutex mutex_;  // the next members
  std::condition_variable wakes_;
  std::deque<Job> jobs_;
  std::vector<GyroSample> samples_;  // of images that were left out
  std::optional<TimeNs> newest_ns_;  // image that was taken, camera clock
  TimeNs expected_offset_ns_ = 0;
  LearnedCalibration learned_;
  std::size_t updates_ = 0;
  std::size_t clears_ = 0;
  bool stops_ = false;

  // Used by the thread that runs jobs alone.
  ImageRateTracker tracker_;
  BitDepth bit_depth_;
  SelfCalibration calibration_;

  std::thread thread_;
};

}  // namespace gyro_deblur
