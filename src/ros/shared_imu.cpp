// Shares the subscription to an IMU among cameras.
#include "ros/shared_imu.hpp"

#include <tuple>
#include <utility>

#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

/// A second of a 1 kHz IMU.
constexpr std::uint32_t kQueue = 1000;

/// What those who share have to agree on.
using Key = std::tuple<std::string, TimeNs, TimeNs, double>;

std::mutex shared_imus_mutex;  // the next one
std::map<Key, std::weak_ptr<SharedImu>> shared_imus;

void log(LogLevel level, const std::string& text) {
  switch (level) {
    case LogLevel::INFO:
      ROS_INFO_STREAM(text);
      break;
    case LogLevel::WARNING:
      ROS_WARN_STREAM(text);
      break;
    case LogLevel::ERROR:
      ROS_ERROR_STREAM(text);
      break;
  }
}

}  // namespace

std::shared_ptr<SharedImu> SharedImu::get(const std::string& topic, const GyroSource::Options& options) {
  const std::lock_guard<std::mutex> lock(shared_imus_mutex);
  std::weak_ptr<SharedImu>& entry =
      shared_imus[{topic, options.time_jump_ns, options.gyro.max_gap_ns, options.gyro.range_rad_s}];
  std::shared_ptr<SharedImu> imu = entry.lock();
  if (imu) {
    imu->source_->require_capacity(options.capacity_ns);
  } else {
    imu = unshared(topic, options);
    entry = imu;
  }
  return imu;
}

std::shared_ptr<SharedImu> SharedImu::unshared(const std::string& topic, const GyroSource::Options& options) {
  return std::shared_ptr<SharedImu>(new SharedImu(topic, options));
}

std::size_t SharedImu::count() {
  const std::lock_guard<std::mutex> lock(shared_imus_mutex);
  std::size_t held = 0;
  for (const auto& [key, entry] : shared_imus) held += !entry.expired();
  return held;
}

SharedImu::SharedImu(const std::string& topic, const GyroSource::Options& options)
    : source_(std::make_shared<GyroSource>(
          options, [topic](LogLevel level, const std::string& text) { log(level, topic + ": " + text); })) {
  ros::NodeHandle nh;
  nh.setCallbackQueue(&queue_);
  subscriber_ = nh.subscribe(topic, kQueue, &SharedImu::on_imu, this, ros::TransportHints().tcpNoDelay());
  spinner_.start();
}

SharedImu::~SharedImu() {
  subscriber_.shutdown();
  spinner_.stop();
}

void SharedImu::listen(const void* owner, Listener listener) {
  const std::lock_guard<std::mutex> lock(mutex_);
  listeners_[owner] = std::move(listener);
}

void SharedImu::stop_listening(const void* owner) {
  const std::lock_guard<std::mutex> lock(mutex_);
  listeners_.erase(owner);
}

std::size_t SharedImu::listeners() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return listeners_.size();
}

void SharedImu::on_imu(const sensor_msgs::ImuConstPtr& imu) {
  if (!source_->add(to_gyro_sample(*imu), imu->header.frame_id)) return;
  const std::lock_guard<std::mutex> lock(mutex_);
  for (const auto& [owner, listener] : listeners_) listener();
}

}  // namespace gyro_deblur
