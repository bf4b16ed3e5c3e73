// OpenVINS (Geneva et al., ICRA 2020) on feature_tracks in place of corners of its own. Runs instead of its
// run_subscribe_msckf, with its ~config_path and its outputs, or, with ~path_bag, instead of its ros1_serial_msckf.
// Inputs: imu, feature_tracks.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

#include <ros/ros.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud.h>
#include <Eigen/Dense>
#include <boost/make_shared.hpp>
#include <opencv2/core.hpp>

#include "cam/CamBase.h"
#include "core/VioManager.h"
#include "core/VioManagerOptions.h"
#include "feat/FeatureDatabase.h"
#include "ros/ROS1Visualizer.h"
#include "state/State.h"
#include "track/TrackBase.h"
#include "utils/dataset_reader.h"
#include "utils/opencv_yaml_parse.h"
#include "utils/print.h"

namespace {

constexpr int kCamera = 0;  ///< the one that the tracks are of

/// A corner in one image.
struct Corner {
  std::size_t id;
  Eigen::Vector2f place_px, ray;  ///< raw pixel; (x, y) of (x, y, 1) by the calibration of the tracks
};

/// Values of a channel, one a point. Throws std::runtime_error when there is none.
const std::vector<float>& channel(const sensor_msgs::PointCloud& tracks, const std::string& name) {
  for (const sensor_msgs::ChannelFloat32& candidate : tracks.channels) {
    if (candidate.name == name && candidate.values.size() == tracks.points.size()) return candidate.values;
  }
  throw std::runtime_error("a message of tracks has no channel " + name + " with a value a point");
}

/// Those whose place is known. Throws std::runtime_error when channels are missing.
std::vector<Corner> corners_of(const sensor_msgs::PointCloud& tracks) {
  const auto &ids = channel(tracks, "id_of_point"), &u = channel(tracks, "u_of_point"),
             &v = channel(tracks, "v_of_point"), &variance = channel(tracks, "covariance_uu_of_point");
  std::vector<Corner> corners;
  for (std::size_t k = 0; k < ids.size(); ++k) {
    if (!std::isfinite(variance[k])) continue;
    corners.push_back(
        {static_cast<std::size_t>(std::lround(ids[k])), {u[k], v[k]}, {tracks.points[k].x, tracks.points[k].y}});
  }
  return corners;
}

/// A tracker of OpenVINS that gives the corners which came with the image's stamp.
class TrackMessages : public ov_core::TrackBase {
 public:
  /// @param known  the database that initialization and updates read
  TrackMessages(const std::unordered_map<std::size_t, std::shared_ptr<ov_core::CamBase>>& cameras, int most_aruco,
                std::shared_ptr<ov_core::FeatureDatabase> known)
      : TrackBase(cameras, 0, most_aruco, false, HistogramMethod::NONE) {
    database = std::move(known);
  }

  void add(double stamp_s, std::vector<Corner> corners) {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_[stamp_s] = std::move(corners);
    // Without an IMU OpenVINS takes none of them.
    constexpr std::size_t kMostWaiting = 1000;
    if (waiting_.size() > kMostWaiting) waiting_.erase(waiting_.begin());
  }

  void feed_new_camera(const ov_core::CameraData& message) override {
    std::vector<Corner> corners;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      const auto found = waiting_.find(message.timestamp);
      if (found != waiting_.end()) corners = std::move(found->second);
      waiting_.erase(waiting_.begin(), waiting_.upper_bound(message.timestamp));
    }
    ov_core::CamBase& camera = *camera_calib.at(kCamera);
    std::vector<cv::KeyPoint> places;
    std::vector<std::size_t> ids;
    if (!compared_ && !corners.empty()) compare_intrinsics(corners);
    for (const Corner& corner : corners) {
      // The first ids are those of markers.
      ids.push_back(corner.id + currid);
      places.emplace_back(corner.place_px.x(), corner.place_px.y(), 1.F);
      const Eigen::Vector2f ray = camera.undistort_f(corner.place_px);
      database->update_feature(ids.back(), message.timestamp, kCamera, corner.place_px.x(), corner.place_px.y(),
                               ray.x(), ray.y());
    }
    const std::lock_guard<std::mutex> lock(mtx_last_vars);
    img_last[kCamera] = message.images.at(0);
    img_mask_last[kCamera] = message.masks.at(0);
    pts_last[kCamera] = std::move(places);
    ids_last[kCamera] = std::move(ids);
  }

 private:
  /// Warns if OpenVINS has other intrinsics than the tracks. Once, because OpenVINS may improve its own.
  void compare_intrinsics(const std::vector<Corner>& corners) {
    compared_ = true;
    // Lens models that were fitted to each other differ by less.
    constexpr double kTolerancePx = 2;
    ov_core::CamBase& camera = *camera_calib.at(kCamera);
    std::vector<double> apart_px;
    for (const Corner& corner : corners) {
      apart_px.push_back(camera.get_K()(0, 0) * (camera.undistort_f(corner.place_px) - corner.ray).norm());
    }
    const auto median = apart_px.begin() + static_cast<std::ptrdiff_t>(apart_px.size() / 2);
    std::nth_element(apart_px.begin(), median, apart_px.end());
    if (*median <= kTolerancePx) return;
    ROS_WARN_STREAM("by the intrinsics of OpenVINS corners are " << *median << " px from where they are by those of "
                                                                 << "gyro_deblur: give both the same calibration");
  }

  bool compared_ = false;
  std::mutex mutex_;
  std::map<double, std::vector<Corner>> waiting_;  ///< by stamp [s]
};

/// OpenVINS with corners from TrackMessages. Precondition: one camera.
class Filter : public ov_msckf::VioManager {
 public:
  explicit Filter(ov_msckf::VioManagerOptions& options)
      : VioManager(options),
        tracks_(std::make_shared<TrackMessages>(state->_cam_intrinsics_cameras, state->_options.max_aruco_features,
                                                trackFEATS->get_feature_database())) {
    trackFEATS = tracks_;
  }

  TrackMessages& tracks() { return *tracks_; }
  bool is_initializing() const { return thread_init_running; }

 private:
  std::shared_ptr<TrackMessages> tracks_;
};

/// Publishes what OpenVINS publishes.
class Outputs : public ov_msckf::ROS1Visualizer {
 public:
  using ROS1Visualizer::ROS1Visualizer;
  bool is_updating() const { return thread_update_running; }
};

class Node {
 public:
  explicit Node(const std::shared_ptr<ros::NodeHandle>& handle) : handle_(handle) {
    std::string settings;
    if (!handle->getParam("config_path", settings)) {
      throw std::runtime_error("~config_path is not set: OpenVINS' estimator_config.yaml, absolute path");
    }
    auto parser = std::make_shared<ov_core::YamlParser>(settings);
    parser->set_node_handler(handle);
    std::string verbosity = "INFO";
    parser->parse_config("verbosity", verbosity);
    ov_core::Printer::setPrintLevel(verbosity);
    ov_msckf::VioManagerOptions options;
    options.print_and_load(parser);
    if (!parser->successful()) throw std::runtime_error(settings + " lacks settings, which are named above");
    if (options.state_options.num_cameras != 1) {
      throw std::runtime_error("max_cameras is " + std::to_string(options.state_options.num_cameras) + " in " +
                               settings + ": tracks are of one camera, it has to be 1");
    }
    if (options.downsample_cameras) {
      throw std::runtime_error("downsample_cameras is true in " + settings + ": tracks are in pixels of the image");
    }
    if (options.use_aruco) {
      throw std::runtime_error("use_aruco is true in " + settings + ": there are no images to look for markers in");
    }
    least_step_s_ = 1 / options.track_frequency;
    from_bag_ = handle->getParam("path_bag", bag_);
    options.use_multi_threading_subs = !from_bag_;
    // Its thread would not end before the objects that it uses.
    options.use_multi_threading_pubs = false;
    filter_ = std::make_shared<Filter>(options);
    outputs_ = std::make_unique<Outputs>(handle, filter_);
  }

  /// Waits for the threads of OpenVINS, which nobody can join.
  ~Node() {
    while (outputs_ && (outputs_->is_updating() || filter_->is_initializing())) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  Node(const Node&) = delete;
  Node& operator=(const Node&) = delete;

  void run() {
    if (from_bag_) {
      read_bag();
    } else {
      ros::NodeHandle topics;
      const auto imu = topics.subscribe<sensor_msgs::Imu>(
          "imu", 1000, [this](const sensor_msgs::ImuConstPtr& sample) { outputs_->callback_inertial(sample); });
      const auto tracks = topics.subscribe<sensor_msgs::PointCloud>(
          "feature_tracks", 10, [this](const sensor_msgs::PointCloudConstPtr& message) {
            try {
              take(*message);
            } catch (const std::exception& error) {
              ROS_ERROR_STREAM_THROTTLE(5, error.what());
            }
          });
      ROS_INFO_STREAM("waiting for tracks on " << tracks.getTopic() << " and samples on " << imu.getTopic());
      ros::AsyncSpinner spinner(0);
      spinner.start();
      ros::waitForShutdown();
    }
    outputs_->visualize_final();
  }

 private:
  /// Takes the tracks of one image. Throws std::runtime_error when OpenVINS cannot use them.
  void take(const sensor_msgs::PointCloud& message) {
    const double stamp_s = message.header.stamp.toSec(), step_s = stamp_s - newest_s_;
    constexpr double kLateS = 1;  // such are of an earlier time, not late
    if (step_s < -kLateS) {
      throw std::runtime_error("time went back by " + std::to_string(-step_s) +
                               " s, which OpenVINS cannot follow: restart it");
    }
    if (step_s > 0 && step_s < least_step_s_) {
      ROS_WARN_STREAM_THROTTLE(5, "OpenVINS leaves out tracks that are " << step_s << " s after the last ones: "
                                                                         << "track_frequency has to be above "
                                                                         << 1 / step_s << " Hz");
    }
    newest_s_ = std::max(newest_s_, stamp_s);
    filter_->tracks().add(stamp_s, corners_of(message));
    // OpenVINS keeps images until the IMU has passed them, and draws on them.
    auto image = boost::make_shared<sensor_msgs::Image>();
    auto& camera = *filter_->get_state()->_cam_intrinsics_cameras.at(kCamera);
    image->header = message.header;
    image->encoding = "mono8";
    image->width = static_cast<std::uint32_t>(camera.w());
    image->height = static_cast<std::uint32_t>(camera.h());
    image->step = image->width;
    image->data.resize(std::size_t{image->step} * image->height);
    outputs_->callback_monocular(image, kCamera);
  }

  /// As fast as it goes; from the state of ~path_gt (EuRoC's columns) nearest to the first tracks, where that is given.
  void read_bag() {
    std::map<double, Eigen::Matrix<double, 17, 1>> start;
    std::string start_file;
    if (handle_->getParam("path_gt", start_file)) ov_core::DatasetReader::load_gt_file(start_file, start);
    const rosbag::Bag bag(bag_);
    const std::string imu = ros::names::resolve("imu"), tracks = ros::names::resolve("feature_tracks");
    std::size_t images = 0;
    for (const rosbag::MessageInstance& message : rosbag::View(bag, rosbag::TopicQuery({imu, tracks}))) {
      if (!ros::ok()) return;
      if (const auto sample = message.instantiate<sensor_msgs::Imu>()) {
        outputs_->callback_inertial(sample);
      } else if (const auto cloud = message.instantiate<sensor_msgs::PointCloud>()) {
        Eigen::Matrix<double, 17, 1> state;
        if (!start.empty() && !filter_->initialized() &&
            ov_core::DatasetReader::get_gt_state(message.getTime().toSec(), state, start)) {
          filter_->initialize_with_gt(state);
        }
        take(*cloud);
        ++images;
      }
    }
    if (images == 0) throw std::runtime_error("there are no tracks on " + tracks + " in " + bag_);
  }

  std::shared_ptr<ros::NodeHandle> handle_;
  std::string bag_;
  bool from_bag_ = false;
  std::shared_ptr<Filter> filter_;
  std::unique_ptr<Outputs> outputs_;
  double newest_s_ = 0, least_step_s_ = 0;  // stamp of the newest tracks; images nearer than this are left out
};

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "openvins_tracks");
  // Outlives what is thrown: without a handle nothing is logged any more.
  const auto handle = std::make_shared<ros::NodeHandle>("~");
  try {
    Node(handle).run();
  } catch (const std::exception& error) {
    ROS_FATAL_STREAM(error.what());
    return EXIT_FAILURE;
  }
  return EXIT_SUCCESS;
}
