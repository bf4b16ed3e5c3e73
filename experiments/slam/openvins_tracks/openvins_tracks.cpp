// OpenVINS (Geneva et al., ICRA 2020) on the feature_tracks of a bag in place of corners of its own: all weighed
// equally, or each weighed by its covariance. Starts from a given state and writes the poses that it estimates.
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <deque>
#include <exception>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <dlfcn.h>

#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud.h>
#include <Eigen/Dense>

#include "core/VioManager.h"
#include "core/VioManagerOptions.h"
#include "state/State.h"
#include "tools/tool_main.hpp"
#include "update/UpdaterHelper.h"
#include "utils/dataset_reader.h"

namespace {

/// Covariances [px^2] of the corners of the images that are still of use, by stamp [s] and place [px].
class Covariances {
 public:
  /// The filter takes errors of a corner in several images for independent, but a track that has wandered in one is off
  /// in the next by as much. Chosen on V2_02, slam.py's flight for tuning: doc/reports/slam.md.
  static constexpr double kVarianceFactor = 4;

  void add(double stamp_s, float u_px, float v_px, const Eigen::Matrix2d& covariance_px2) {
    images_[stamp_s][{u_px, v_px}] = covariance_px2;
    // OpenVINS keeps tens of poses.
    constexpr std::size_t kMostImages = 100;
    if (images_.size() > kMostImages) images_.erase(images_.begin());
  }

  /// W, of which W (kVarianceFactor C) W^T is identity. Throws std::out_of_range where the corner is not known.
  Eigen::Matrix2d whitening(double stamp_s, float u_px, float v_px) const {
    const Eigen::Matrix2d C = kVarianceFactor * images_.at(stamp_s).at({u_px, v_px});
    return C.llt().matrixL().solve(Eigen::Matrix2d::Identity());
  }

 private:
  std::map<double, std::map<std::pair<float, float>, Eigen::Matrix2d>> images_;
};

/// Of the one filter that runs: what replaces its function below is static.
struct Weighing {
  bool on = false;
  Covariances covariances;
  std::size_t whitened = 0;  ///< observations
} weighing;

}  // namespace

namespace ov_msckf {

/// Takes the place of the function of this name in OpenVINS' library, calls it, and whitens what it gives: two rows for
/// each observation, in the order of feature.timestamps. OpenVINS weighs all of them by one standard deviation, which
/// has to be 1 then.
void UpdaterHelper::get_feature_jacobian_full(std::shared_ptr<State> state, UpdaterHelperFeature& feature,
                                              Eigen::MatrixXd& H_f, Eigen::MatrixXd& H_x, Eigen::VectorXd& res,
                                              std::vector<std::shared_ptr<ov_type::Type>>& x_order) {
  using Function = decltype(&UpdaterHelper::get_feature_jacobian_full);
  static const Function of_library = [] {
    void* own = reinterpret_cast<void*>(&UpdaterHelper::get_feature_jacobian_full);
    Dl_info info{};
    if (dladdr(own, &info) == 0 || info.dli_saddr != own) throw std::runtime_error("symbols are not exported");
    void* next = dlsym(RTLD_NEXT, info.dli_sname);
    if (next == nullptr) throw std::runtime_error(std::string("OpenVINS' library has no ") + info.dli_sname);
    return reinterpret_cast<Function>(next);
  }();
  of_library(state, feature, H_f, H_x, res, x_order);
  if (!weighing.on) return;
  Eigen::Index row = 0;
  for (const auto& [camera, stamps_s] : feature.timestamps) {
    const auto& places_px = feature.uvs.at(camera);
    for (std::size_t k = 0; k < stamps_s.size(); ++k, row += 2, ++weighing.whitened) {
      const Eigen::Matrix2d W = weighing.covariances.whitening(stamps_s[k], places_px[k](0), places_px[k](1));
      res.segment<2>(row) = (W * res.segment<2>(row)).eval();
      H_f.middleRows<2>(row) = (W * H_f.middleRows<2>(row)).eval();
      H_x.middleRows<2>(row) = (W * H_x.middleRows<2>(row)).eval();
    }
  }
}

}  // namespace ov_msckf

namespace {

struct Arguments {
  std::string settings, bag, start, states, imu_topic = "/imu", tracks_topic = "/camera/feature_tracks";
  bool weigh = false;
};

const std::vector<float>& channel(const sensor_msgs::PointCloud& cloud, const std::string& name) {
  for (const sensor_msgs::ChannelFloat32& candidate : cloud.channels) {
    if (candidate.name == name && candidate.values.size() == cloud.points.size()) return candidate.values;
  }
  throw std::runtime_error("tracks without " + name);
}

/// Of one image.
void feed_tracks(const sensor_msgs::PointCloud& cloud, ov_msckf::VioManager& filter) {
  const double stamp_s = cloud.header.stamp.toSec();
  const auto &ids = channel(cloud, "id_of_point"), &u = channel(cloud, "u_of_point"), &v = channel(cloud, "v_of_point"),
             &uu = channel(cloud, "covariance_uu_of_point"), &uv = channel(cloud, "covariance_uv_of_point"),
             &vv = channel(cloud, "covariance_vv_of_point");
  std::vector<std::pair<std::size_t, Eigen::VectorXf>> corners;
  for (std::size_t k = 0; k < ids.size(); ++k) {
    if (!std::isfinite(uu[k])) continue;  // nobody knows where it is
    Eigen::Matrix2d covariance_px2;
    covariance_px2 << uu[k], uv[k], uv[k], vv[k];
    weighing.covariances.add(stamp_s, u[k], v[k], covariance_px2);
    corners.emplace_back(static_cast<std::size_t>(std::lround(ids[k])), Eigen::Vector2f(u[k], v[k]));
  }
  filter.feed_measurement_simulation(stamp_s, {0}, {corners});
}

void run(const Arguments& arguments) {
  ov_core::Printer::setPrintLevel("WARNING");
  auto parser = std::make_shared<ov_core::YamlParser>(arguments.settings);
  ov_msckf::VioManagerOptions options;
  options.print_and_load(parser);
  if (!parser->successful()) throw std::runtime_error(arguments.settings + " lacks settings");
  weighing.on = arguments.weigh;
  if (weighing.on && (options.msckf_options.sigma_pix != 1 || options.slam_options.sigma_pix != 1)) {
    throw std::runtime_error("weights want up_msckf_sigma_px: 1 and up_slam_sigma_px: 1");
  }
  ov_msckf::VioManager filter(options);
  std::map<double, Eigen::Matrix<double, 17, 1>> start;
  ov_core::DatasetReader::load_gt_file(arguments.start, start);

  const rosbag::Bag bag(arguments.bag);
  std::ofstream states(arguments.states);
  states << std::setprecision(17) << "# t [s], q (x y z w), p [m]\n";
  std::deque<sensor_msgs::PointCloudConstPtr> waiting;  // until the IMU has passed them
  bool started = false;
  double written_s = -1;
  for (const rosbag::MessageInstance& message :
       rosbag::View(bag, rosbag::TopicQuery({arguments.imu_topic, arguments.tracks_topic}))) {
    if (const auto cloud = message.instantiate<sensor_msgs::PointCloud>()) {
      Eigen::Matrix<double, 17, 1> state;
      if (!started && ov_core::DatasetReader::get_gt_state(message.getTime().toSec(), state, start)) {
        filter.initialize_with_gt(state);
        started = true;
      }
      if (started) waiting.push_back(cloud);
    } else if (const auto sample = message.instantiate<sensor_msgs::Imu>()) {
      ov_core::ImuData data;
      data.timestamp = sample->header.stamp.toSec();
      data.wm << sample->angular_velocity.x, sample->angular_velocity.y, sample->angular_velocity.z;
      data.am << sample->linear_acceleration.x, sample->linear_acceleration.y, sample->linear_acceleration.z;
      filter.feed_measurement_imu(data);
      const double shift_s = filter.get_state()->_calib_dt_CAMtoIMU->value()(0);
      while (!waiting.empty() && waiting.front()->header.stamp.toSec() + shift_s < data.timestamp) {
        feed_tracks(*waiting.front(), filter);
        waiting.pop_front();
        const auto state = filter.get_state();
        if (state->_timestamp == written_s) continue;  // the filter has not moved
        written_s = state->_timestamp;
        // At once: OpenVINS ends the process where its covariance breaks down.
        states << written_s + shift_s << ' ' << state->_imu->quat().transpose() << ' ' << state->_imu->pos().transpose()
               << std::endl;
      }
    }
  }
  if (!started) throw std::runtime_error("no tracks near the state of " + arguments.start);
  if (weighing.on && weighing.whitened == 0) throw std::runtime_error("OpenVINS' library calls its own function");
  if (!states) throw std::runtime_error("cannot write " + arguments.states);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  gyro_deblur::CommandLine app{"Runs OpenVINS on the tracks of a bag.", "openvins_tracks"};
  app.add_option("SETTINGS", arguments.settings, "estimator's YAML file; up_msckf_sigma_px and up_slam_sigma_px: 1")
      .required();
  app.add_option("BAG", arguments.bag, "with feature_tracks and the IMU").required();
  app.add_option("--start", arguments.start, "state at most 0.1 s from the first tracks, in EuRoC's columns")
      .required();
  app.add_option("--states", arguments.states, "file for the poses").required();
  app.add_option("--imu-topic", arguments.imu_topic, "[/imu]");
  app.add_option("--tracks-topic", arguments.tracks_topic, "[/camera/feature_tracks]");
  app.add_flag("--weigh", arguments.weigh, "corners by their covariances, in place of the settings' 1 px for all");
  if (const std::optional<int> ended = gyro_deblur::read_arguments(app, argc, argv)) return *ended;
  try {
    run(arguments);
  } catch (const std::exception& error) {
    std::cerr << "openvins_tracks: " << error.what() << '\n';
    std::remove(arguments.states.c_str());  // what is there is not what was asked for
    return 1;
  }
  return 0;
}
