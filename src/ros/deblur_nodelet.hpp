// The nodelet: topics, services, parameters and diagnostics around a Processor.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <diagnostic_updater/diagnostic_updater.h>
#include <dynamic_reconfigure/server.h>
#include <image_transport/image_transport.h>
#include <nodelet/nodelet.h>
#include <ros/ros.h>
#include <sensor_msgs/CompressedImage.h>
#include <std_srvs/Trigger.h>
#include <tf2_msgs/TFMessage.h>
#include <topic_tools/shape_shifter.h>
#include <xmlrpcpp/XmlRpcValue.h>

#include "gyro_deblur/DeblurConfig.h"
#include "ros/diagnostics.hpp"
#include "ros/exposure_adapter.hpp"
#include "ros/processor.hpp"
#include "ros/publishers.hpp"
#include "ros/shared_imu.hpp"
#include "ros/tf_conversion.hpp"

namespace gyro_deblur {

/// Deblurs the images of one camera. Callbacks only store messages; frames are processed and published, in order, by
/// one worker thread, so that a slow frame never delays an IMU sample. Nodelets of a process that listen to the same
/// IMU share its subscription and its samples.
///
/// image_raw and camera_info are matched by stamp here rather than by an image_transport::CameraSubscriber, because
/// that one keeps back images without camera_info, and every frame has to come out.
class DeblurNodelet : public nodelet::Nodelet {
 public:
  DeblurNodelet() = default;
  ~DeblurNodelet() override;

 private:
  void onInit() override;
  Processor::Environment make_environment();
  /// A std_srvs/Trigger. `serve` says whether it succeeded, and what to respond and log.
  void advertise_service(const std::string& name, bool (DeblurNodelet::*serve)(std::string* text));
  void start_diagnostics();
  /// The configuration, or nothing with the reason in `error`.
  std::optional<Config> load_parameters(std::string* error);
  void start_reconfigure();
  void on_reconfigure(DeblurConfig& dynamic);

  void subscribe_exposure(const ExposureSource& source);
  /// Subscribes to the camera while somebody listens to an output, as image_proc does.
  void subscribe_on_demand();

  void on_image(const sensor_msgs::ImageConstPtr& image);
  void on_compressed_image(const sensor_msgs::CompressedImageConstPtr& image);
  void on_driver_message(const ros::MessageEvent<topic_tools::ShapeShifter>& event);
  void on_transforms(const tf2_msgs::TFMessageConstPtr& message, Transforms::Topic topic);
  bool on_reset(std::string* text);
  bool on_reset_calibration(std::string* text);
  bool on_save_calibration(std::string* text);
  void on_diagnostics_timer(const ros::WallTimerEvent& event);

  /// Runs `function`; an exception is logged, because it must not reach the nodelet manager.
  template <typename Function>
  void guarded(const char* what, Function function);
  void work();
  bool publish(const FrameOutput& output);  // true: more may follow
  void log(LogLevel level, const std::string& text) const;
  /// Stores the calibration that was estimated from the images, if there is one and it is to be stored. Throws
  /// std::runtime_error.
  /// @return the path of the file; empty: nothing was stored
  std::string save_calibration() const;

  std::unique_ptr<Processor> processor_;

  XmlRpc::XmlRpcValue given_parameters_;  // those of the configuration, as they were when the nodelet was loaded
  boost::recursive_mutex reconfigure_mutex_;
  std::unique_ptr<dynamic_reconfigure::Server<DeblurConfig>> reconfigure_;
  DeblurConfig dynamic_ = DeblurConfig::__getDefault__();  // last accepted values
  bool reconfigure_ready_ = false;

  Transforms transforms_;
  ros::Subscriber tf_subscriber_;
  ros::Subscriber tf_static_subscriber_;
  ros::Subscriber mask_subscriber_;

  std::unique_ptr<image_transport::ImageTransport> transport_;
  std::shared_ptr<SharedImu> imu_;
  std::shared_ptr<StereoCamera> stereo_;
  std::mutex exposure_mutex_;  // for the next two
  ros::Subscriber exposure_subscriber_;
  std::unique_ptr<ExposureAdapter> exposure_adapter_;  // null for the package's own message
  bool configured_ = false;                            // not while the first configuration is refused for any key
  std::atomic<bool> exposure_expected_{false};
  std::atomic<TimeNs> last_image_ns_{0};  // steady clock

  mutable std::mutex connection_mutex_;  // subscribers of the camera and the set of publishers
  image_transport::Subscriber image_subscriber_;
  ros::Subscriber compressed_subscriber_;  // in its place with image_transport: compressed
  ros::Subscriber camera_info_subscriber_;
  Publishers publishers_;
  bool shutting_down_ = false;

  std::vector<ros::ServiceServer> services_;
  ros::WallTimer diagnostics_timer_;
  int diagnostics_reports_ = 0;  // one each second; of the timer alone
  std::unique_ptr<diagnostic_updater::Updater> diagnostics_;

  DiagnosticReport report_;
  DiagnosticStatuses statuses_;  // of the newest report

  std::thread worker_;
};

}  // namespace gyro_deblur
