// Subscriptions, publishers, services and the worker thread of the nodelet.
#include "ros/deblur_nodelet.hpp"

#include <chrono>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include <image_transport/camera_common.h>
#include <pluginlib/class_list_macros.hpp>

#include "base/stopwatch.hpp"
#include "base/time_slice.hpp"
#include "calibrate/stored_calibration.hpp"
#include "gyro_deblur/config.hpp"
#include "ros/value_conversion.hpp"

namespace gyro_deblur {
namespace {

/// Callbacks only store, so these queues are short in practice; a burst must not be lost here, where nobody would count
/// it.
constexpr std::uint32_t kImageQueue = 100;
/// Of exposures, which a driver's messages of any kind may bring, at the rate of an IMU at most.
constexpr std::uint32_t kFastQueue = 1000;
constexpr std::uint32_t kTfQueue = 100;

/// What can be published at once (all that waited for the same message), plus what a subscriber may lag behind.
std::uint32_t output_queue(const Config& config) {
  constexpr int kLag = 10;
  return static_cast<std::uint32_t>(config.frame_queue_size + kLag);
}

/// How often waiting frames are checked when no message comes: timeouts are late by at most this.
constexpr std::chrono::milliseconds kPollPeriod{20};

/// How long no image may come before that is reported.
constexpr double kImageSilenceS = 5;

}  // namespace

DeblurNodelet::~DeblurNodelet() {
  // First of all: a change of parameters may subscribe anew.
  reconfigure_.reset();
  if (stereo_) stereo_->set_timeout(0);  // it no longer waits for its stereo partners, nor they for it
  // Shutting a subscription down waits for its callback in progress; after this no callback runs any more.
  if (imu_) imu_->stop_listening(this);
  exposure_subscriber_.shutdown();
  diagnostics_timer_.stop();
  for (ros::ServiceServer& service : services_) service.shutdown();
  tf_subscriber_.shutdown();
  tf_static_subscriber_.shutdown();
  mask_subscriber_.shutdown();
  {
    const std::lock_guard<std::mutex> lock(connection_mutex_);
    shutting_down_ = true;
    image_subscriber_.shutdown();
    camera_info_subscriber_.shutdown();
    compressed_subscriber_.shutdown();
  }
  if (processor_) processor_->stop();
  if (worker_.joinable()) worker_.join();
  // What has come in goes out, with what is there.
  if (processor_ && ros::ok()) {
    // A frame whose processing or publishing fails must not keep those behind it from being published.
    for (std::size_t tries = processor_->waiting() + 1; tries > 0 && processor_->waiting() > 0; --tries) {
      guarded("processing the last frames",
              [this] { processor_->finish([this](FrameOutput&& output) { return publish(output); }); });
    }
  }
  if (processor_) guarded("storing the calibration", [this] { save_calibration(); });
  publishers_.shutdown();
}

void DeblurNodelet::log(LogLevel level, const std::string& text) const {
  switch (level) {
    case LogLevel::INFO:
      NODELET_INFO_STREAM(text);
      break;
    case LogLevel::WARNING:
      NODELET_WARN_STREAM(text);
      break;
    case LogLevel::ERROR:
      NODELET_ERROR_STREAM(text);
      break;
  }
}

Processor::Environment DeblurNodelet::make_environment() {
  Processor::Environment environment;
  environment.clock = [] { return to_time_ns(ros::Time::now()); };
  environment.steady_clock = steady_now_ns;
  environment.log = [this](LogLevel level, const std::string& text) { log(level, text); };
  environment.extrinsic = [this](const std::string& camera_frame, const std::string& imu_frame) {
    return transforms_.R_cam_imu(camera_frame, imu_frame);
  };
  environment.exposure_expected = [this] { return exposure_expected_.load(); };
  environment.request = [this] { return publishers_.request(); };
  environment.self_calibration = SelfCalibrator::Work::IN_BACKGROUND;
  environment.stored_calibration = [this](int width_px, int height_px) {
    std::optional<LearnedCalibration> stored;
    guarded("reading the stored calibration", [&] {
      if (ros::Time::isSimTime()) return;
      const std::string path = stored_calibration_path(getName(), width_px, height_px);
      stored = load_stored_calibration(path);
      if (stored)
        NODELET_INFO_STREAM("calibration of the last start from " << path << ", until a better one is estimated");
    });
    return stored;
  };
  return environment;
}

void DeblurNodelet::onInit() {
  ros::NodeHandle& nh = getNodeHandle();
  Processor::Environment environment = make_environment();
  std::string error;
  const std::optional<Config> config = load_parameters(&error);
  const std::string imu_topic = nh.resolveName("imu");
  imu_ = config ? SharedImu::get(imu_topic, GyroSource::options_of(*config))
                : SharedImu::unshared(imu_topic, GyroSource::options_of(Config()));
  environment.gyro = imu_->source();
  environment.stereo = stereo_ = std::make_shared<StereoCamera>(StereoRig::get(imu_topic), nh.resolveName("image_raw"));
  processor_ = std::make_unique<Processor>(std::move(environment));
  try {
    if (config) processor_->set_config(*config);
  } catch (const std::exception& refused) {
    error = refused.what();
  }
  if (!error.empty()) {
    NODELET_ERROR_STREAM("parameters cannot be used, frames pass through unchanged: " << error);
    processor_->set_config_error(error);
  }
  // Before a user can correct the refused parameter, which does both again.
  configured_ = config.has_value();
  subscribe_exposure(config ? config->exposure_source : ExposureSource());
  start_reconfigure();

  transport_ = std::make_unique<image_transport::ImageTransport>(nh);
  const auto subscribe_tf = [&](const char* name, Transforms::Topic topic) {
    return nh.subscribe<tf2_msgs::TFMessage>(
        name, kTfQueue, [this, topic](const tf2_msgs::TFMessageConstPtr& message) { on_transforms(message, topic); });
  };
  tf_static_subscriber_ = subscribe_tf("/tf_static", Transforms::Topic::TF_STATIC);
  tf_subscriber_ = subscribe_tf("/tf", Transforms::Topic::TF);
  mask_subscriber_ = nh.subscribe<sensor_msgs::Image>("mask", 1, [this](const sensor_msgs::ImageConstPtr& mask) {
    guarded("taking a mask in", [&] { processor_->add_mask(*mask); });
  });
  imu_->listen(this, [this] { guarded("taking an IMU sample in", [this] { processor_->on_imu_sample(); }); });
  report_.start(processor_->statistics(), std::chrono::steady_clock::now());
  {
    // Callbacks that come before all publishers are there wait for the lock.
    const std::lock_guard<std::mutex> lock(connection_mutex_);
    publishers_.advertise(nh, *transport_, output_queue(config.value_or(Config())), [this] {
      // A transport that is not installed, for one, throws.
      guarded("subscribing", [this] { subscribe_on_demand(); });
    });
  }
  worker_ = std::thread(&DeblurNodelet::work, this);
  advertise_service("reset", &DeblurNodelet::on_reset);
  advertise_service("reset_calibration", &DeblurNodelet::on_reset_calibration);
  advertise_service("save_calibration", &DeblurNodelet::on_save_calibration);
  start_diagnostics();
}

void DeblurNodelet::advertise_service(const std::string& name, bool (DeblurNodelet::*serve)(std::string*)) {
  using std_srvs::Trigger;
  const boost::function<bool(Trigger::Request&, Trigger::Response&)> callback =
      [this, name, serve](Trigger::Request&, Trigger::Response& response) {
        try {
          response.success = (this->*serve)(&response.message);
        } catch (const std::exception& error) {
          response.success = false;
          response.message += (response.message.empty() ? "" : ", but ") + std::string(error.what());
        }
        log(response.success ? LogLevel::INFO : LogLevel::WARNING, name + ": " + response.message);
        return true;
      };
  services_.push_back(getPrivateNodeHandle().advertiseService(name, callback));
}

void DeblurNodelet::start_diagnostics() {
  diagnostics_ = std::make_unique<diagnostic_updater::Updater>(getNodeHandle(), getPrivateNodeHandle(), getName());
  diagnostics_->setHardwareID("none");
  const auto add_status = [this](const std::string& name,
                                 diagnostic_updater::DiagnosticStatusWrapper DiagnosticStatuses::*part) {
    diagnostics_->add(name, [this, part](diagnostic_updater::DiagnosticStatusWrapper& status) {
      status.summary(statuses_.*part);
      status.values = (statuses_.*part).values;
    });
  };
  add_status("image", &DiagnosticStatuses::image);
  add_status("IMU", &DiagnosticStatuses::imu);
  add_status("calibration", &DiagnosticStatuses::calibration);
  add_status("timing", &DiagnosticStatuses::timing);
  diagnostics_timer_ =
      getNodeHandle().createWallTimer(ros::WallDuration(1.0), &DeblurNodelet::on_diagnostics_timer, this);
}

void DeblurNodelet::subscribe_exposure(const ExposureSource& source) {
  ros::NodeHandle& nh = getNodeHandle();
  const bool of_driver = source.kind != ExposureSource::Kind::MESSAGE;
  ros::Subscriber before;
  {
    const std::lock_guard<std::mutex> lock(exposure_mutex_);
    std::swap(before, exposure_subscriber_);
    exposure_adapter_ = of_driver ? std::make_unique<ExposureAdapter>(source) : nullptr;
  }
  before.shutdown();  // waits for its callback, which takes the lock
  const auto add = [this](const ExposureConstPtr& exposure) {
    guarded("taking an exposure time in", [&] { processor_->add_exposure(*exposure); });
  };
  const ros::Subscriber subscriber = of_driver
                                         ? nh.subscribe("exposure", kFastQueue, &DeblurNodelet::on_driver_message, this)
                                         : nh.subscribe<Exposure>("exposure", kFastQueue, add);
  const std::lock_guard<std::mutex> lock(exposure_mutex_);
  exposure_subscriber_ = subscriber;
}

void DeblurNodelet::subscribe_on_demand() {
  const std::lock_guard<std::mutex> lock(connection_mutex_);
  if (shutting_down_) return;
  if (!publishers_.has_listener()) {
    image_subscriber_.shutdown();
    compressed_subscriber_.shutdown();
    camera_info_subscriber_.shutdown();
    return;
  }
  if (image_subscriber_ || compressed_subscriber_) return;
  ros::NodeHandle& nh = getNodeHandle();
  const std::string image_topic = nh.resolveName("image_raw");
  // The sibling of the image, as for every camera subscriber, unless camera_info has been remapped on its own.
  const bool remapped = nh.resolveName("camera_info", true) != nh.resolveName("camera_info", false);
  const std::string info_topic =
      remapped ? nh.resolveName("camera_info") : image_transport::getCameraInfoTopic(image_topic);
  camera_info_subscriber_ = nh.subscribe<sensor_msgs::CameraInfo>(
      info_topic, kImageQueue, [this](const sensor_msgs::CameraInfoConstPtr& info) {
        guarded("taking a camera_info in", [&] { processor_->add_camera_info(info); });
      });
  const image_transport::TransportHints hints("raw", ros::TransportHints(), getPrivateNodeHandle());
  // image_transport's plugin leaves out what it cannot decode without a word, and nothing could be counted.
  if (hints.getTransport() == "compressed") {
    compressed_subscriber_ =
        nh.subscribe(image_topic + "/compressed", kImageQueue, &DeblurNodelet::on_compressed_image, this);
    last_image_ns_ = steady_now_ns();
    return;
  }
  // By its resolved name: a transport would append its own to "image_raw", which no remapping fits then.
  image_subscriber_ = transport_->subscribe(image_topic, kImageQueue, &DeblurNodelet::on_image, this, hints);
  last_image_ns_ = steady_now_ns();
}

template <typename Function>
void DeblurNodelet::guarded(const char* what, Function function) {
  try {
    function();
  } catch (const std::exception& error) {
    NODELET_ERROR_STREAM_THROTTLE(5.0, what << " failed: " << error.what());
  } catch (...) {
    NODELET_ERROR_STREAM_THROTTLE(5.0, what << " failed for an unknown cause");
  }
}

void DeblurNodelet::on_image(const sensor_msgs::ImageConstPtr& image) {
  last_image_ns_ = steady_now_ns();
  guarded("taking an image in", [&] { processor_->add_image(image); });
}

void DeblurNodelet::on_compressed_image(const sensor_msgs::CompressedImageConstPtr& image) {
  last_image_ns_ = steady_now_ns();
  guarded("taking a compressed image in", [&] { processor_->add_compressed_image(*image); });
}

void DeblurNodelet::on_driver_message(const ros::MessageEvent<topic_tools::ShapeShifter>& event) {
  guarded("reading an exposure time", [&] {
    const topic_tools::ShapeShifter& message = *event.getConstMessage();
    std::vector<std::uint8_t> bytes(message.size());
    ros::serialization::OStream stream(bytes.data(), message.size());
    message.write(stream);
    const std::lock_guard<std::mutex> lock(exposure_mutex_);
    exposure_adapter_->pass_on(message.getDataType(), message.getMessageDefinition(), bytes, processor_.get());
  });
}

void DeblurNodelet::on_transforms(const tf2_msgs::TFMessageConstPtr& message, Transforms::Topic topic) {
  guarded("taking transforms in", [&] {
    transforms_.add(*message, topic);
    processor_->wake();
  });
}

bool DeblurNodelet::on_reset(std::string* text) {
  processor_->reset();
  *text = "gyroscope samples and other stored messages are forgotten, waiting frames pass through";
  return true;
}

bool DeblurNodelet::on_reset_calibration(std::string* text) {
  processor_->reset_calibration();
  *text = "the calibration that was estimated is forgotten";
  const auto seen = processor_->calibration_by_images();
  if (seen && !ros::Time::isSimTime()) {
    remove_stored_calibration(stored_calibration_path(getName(), seen->width_px, seen->height_px));
  }
  return true;
}

std::string DeblurNodelet::save_calibration() const {
  const auto seen = processor_->calibration_by_images();
  if (!seen || ros::Time::isSimTime()) return {};
  const LearnedCalibration& c = seen->calibration;
  if (!c.R_cam_imu.known && !c.time_offset_s.known && !c.readout_s.known && !c.bias_rad_s.known &&
      !c.focal_length.known)
    return {};
  const std::string path = stored_calibration_path(getName(), seen->width_px, seen->height_px);
  if (!path.empty()) save_stored_calibration(path, c);
  return path;
}

bool DeblurNodelet::on_save_calibration(std::string* text) {
  const std::string path = save_calibration();
  *text = !path.empty()            ? "stored in " + path
          : ros::Time::isSimTime() ? "nothing is stored with use_sim_time"
                                   : "nothing is stored: no estimate is in use, see the diagnostics";
  return !path.empty();
}

void DeblurNodelet::work() {
  ask_for_time_slice_of_a_frame();
  while (processor_->wait(kPollPeriod)) {
    guarded("processing", [this] {
      {
        const std::lock_guard<std::mutex> lock(exposure_mutex_);
        exposure_expected_ = exposure_subscriber_.getNumPublishers() > 0;
      }
      processor_->advance([this](FrameOutput&& output) { return publish(output); });
    });
  }
}

bool DeblurNodelet::publish(const FrameOutput& output) {
  report_.add(output);
  publishers_.publish(output);
  return true;
}

void DeblurNodelet::on_diagnostics_timer(const ros::WallTimerEvent&) {
  guarded("reporting diagnostics", [&] {
    statuses_ = report_.fill(
        {processor_->statistics(), imu_->listeners(), to_time_ns(ros::Time::now()), std::chrono::steady_clock::now()});
    // The updater's own clock stands still with simulated time.
    diagnostics_->force_update();
    bool subscribed = false;
    {
      const std::lock_guard<std::mutex> lock(connection_mutex_);
      subscribed = image_subscriber_ || compressed_subscriber_;
    }
    constexpr int kStoredEvery = 60;
    if (++diagnostics_reports_ % kStoredEvery == 0) save_calibration();
    const double silence_s = to_seconds(steady_now_ns() - last_image_ns_);
    if (subscribed && silence_s > kImageSilenceS) {
      NODELET_WARN_STREAM_THROTTLE(30.0, "no image on " << getNodeHandle().resolveName("image_raw") << " for "
                                                        << std::round(silence_s)
                                                        << " s: check the camera's driver and the topic's name");
    }
  });
}

}  // namespace gyro_deblur

PLUGINLIB_EXPORT_CLASS(gyro_deblur::DeblurNodelet, nodelet::Nodelet)
