// One subscription to an IMU for all cameras of a process.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/Imu.h>

#include "sync/gyro_source.hpp"

namespace gyro_deblur {

/// Takes the messages of a topic in, in a thread of its own: no camera's work delays a sample of another. Lives as long
/// as somebody holds it.
class SharedImu {
 public:
  /// Called for every message that the source has taken in, in order. Must neither throw nor call back.
  using Listener = std::function<void()>;

  /// The one of this process for the topic and the same limits of samples, which is made when nobody has one.
  /// @param topic  resolved name
  static std::shared_ptr<SharedImu> get(const std::string& topic, const GyroSource::Options& options);
  /// One for a camera whose limits of samples are not known.
  static std::shared_ptr<SharedImu> unshared(const std::string& topic, const GyroSource::Options& options);
  /// How many of those that get() made are held.
  static std::size_t count();

  ~SharedImu();
  SharedImu(const SharedImu&) = delete;
  SharedImu& operator=(const SharedImu&) = delete;

  const std::shared_ptr<GyroSource>& source() const { return source_; }

  /// @param owner  no two listeners have the same
  void listen(const void* owner, Listener listener);
  /// When it returns, the owner's listener runs no more.
  void stop_listening(const void* owner);
  std::size_t listeners() const;

 private:
  SharedImu(const std::string& topic, const GyroSource::Options& options);
  void on_imu(const sensor_msgs::ImuConstPtr& imu);

  std::shared_ptr<GyroSource> source_;
  mutable std::mutex mutex_;
  std::map<const void*, Listener> listeners_;
  ros::CallbackQueue queue_;
  ros::Subscriber subscriber_;
  ros::AsyncSpinner spinner_{1, &queue_};
};

}  // namespace gyro_deblur
