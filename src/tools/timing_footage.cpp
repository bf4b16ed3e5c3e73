// Reads images and gyroscope samples of a bag for calibration.
#include "tools/timing_footage.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <tf2_msgs/TFMessage.h>

#include "base/median.hpp"
#include "calibrate/frame_tracker.hpp"
#include "ros/conversions.hpp"
#include "ros/messages.hpp"
#include "ros/picture.hpp"
#include "tools/bag_reading.hpp"
#include "tools/progress.hpp"

namespace gyro_deblur {
namespace {

/// Exposure times of the whole bag, by stamp.
std::map<TimeNs, Exposure> read_exposures(const rosbag::Bag& bag, const std::string& topic) {
  std::map<TimeNs, Exposure> exposures;
  if (topic.empty()) return exposures;
  for_each_message<Exposure>(
      bag, {topic}, [&exposures](const Exposure& message) { exposures[to_time_ns(message.header.stamp)] = message; });
  return exposures;
}

std::vector<GyroSample> read_gyro(const rosbag::Bag& bag, const std::string& topic, std::string* frame,
                                  TimeNs* delay_ns) {
  std::vector<GyroSample> samples;
  std::vector<TimeNs> delays_ns;
  rosbag::View view(bag, rosbag::TopicQuery(topic));
  for (const rosbag::MessageInstance& instance : view) {
    const auto imu = read_message<sensor_msgs::Imu>(instance);
    const std::optional<GyroSample> sample = imu ? to_gyro_sample(*imu) : std::nullopt;
    if (!sample || !sample->rate_rad_s.allFinite()) continue;
    *frame = imu->header.frame_id;
    samples.push_back(*sample);
    delays_ns.push_back(to_time_ns(instance.getTime()) - sample->t_ns);
  }
  if (!delays_ns.empty()) *delay_ns = median(std::move(delays_ns));
  // Messages of a bag are in the order of their arrival.
  const auto earlier = [](const GyroSample& a, const GyroSample& b) { return a.t_ns < b.t_ns; };
  std::stable_sort(samples.begin(), samples.end(), earlier);
  samples.erase(std::unique(samples.begin(), samples.end(),
                            [](const GyroSample& a, const GyroSample& b) { return a.t_ns == b.t_ns; }),
                samples.end());
  return samples;
}

/// Camera of the images, and the part of the sensor's readout that they take.
void read_camera(const rosbag::Bag& bag, const cv::Size& size, const FootageTopics& topics, const Config& config,
                 Footage* footage) {
  const int width = size.width, height = size.height;
  const bool from_file = config.calibration && config.calibration->camera && !config.rectified_input;
  sensor_msgs::CameraInfo info;
  if (from_file) info = camera_info_message(*config.calibration->camera);
  if (!topics.camera_info.empty()) {
    rosbag::View view(bag, rosbag::TopicQuery(topics.camera_info));
    const auto first = view.size() == 0 ? nullptr : read_message<sensor_msgs::CameraInfo>(*view.begin());
    if (first && !from_file) info = *first;
    if (first && from_file) {
      info.roi = first->roi;
      info.binning_x = first->binning_x;
      info.binning_y = first->binning_y;
    }
  }
  footage->camera = from_file ? to_calibration(*config.calibration->camera, info, width, height)
                              : to_calibration(info, width, height, config.rectified_input);
  constexpr TimeNs kWhole = 1'000'000'000;
  footage->readout_part = to_seconds(region_readout_ns(kWhole, info)) / to_seconds(kWhole);
}

/// Follows points from image to image.
class PairCollector {
 public:
  /// The footage has its camera by the first image.
  PairCollector(const std::map<TimeNs, Exposure>& exposures, const Config& config, int points, Footage* footage)
      : exposures_(exposures),
        shutter_(config.shutter),
        bit_depth_(config.pipeline.significant_bits),
        tracker_(points),
        footage_(footage) {}

  void add(TimeNs stamp_ns, const ImageView& pixels) {
    const FrameTime now{stamp_ns, exposure_of(stamp_ns)};
    // Across lost frames the motion is too large to be followed.
    constexpr TimeNs kLongestStep = 250'000'000;
    if (last_ns_ && (now.stamp_ns <= *last_ns_ || now.stamp_ns - *last_ns_ > kLongestStep)) tracker_.cut();
    const int bits = bit_depth_.of(pixels.image, pixels.layout);
    const cv::Mat luminance = luminance8(pixels.image, pixels.layout, bits);
    tracker_.add(now, luminance);
    add_rate(now, luminance);
    last_ns_ = now.stamp_ns;
    footage_->period.add(now.stamp_ns);
    ++footage_->frames;
  }

  /// After the last image.
  void finish() { footage_->windows = tracker_.take(); }

 private:
  TimeNs exposure_of(TimeNs stamp_ns) {
    const auto exposure = exposures_.find(stamp_ns);
    if (exposure == exposures_.end()) return shutter_.exposure_ns;
    if (!exposure->second.readout_time.isZero()) {
      footage_->message_readout_ns = exposure->second.readout_time.toNSec();
    }
    const TimeNs exposure_ns = exposure->second.exposure_time.toNSec();
    if (exposure_ns > 0) footage_->message_exposures_ns[stamp_ns] = exposure_ns;
    return exposure_ns;
  }

  void add_rate(const FrameTime& now, const cv::Mat& luminance) {
    if (!camera_) camera_.emplace(footage_->camera);
    ShutterTiming middle = shutter_;
    middle.stamp_phase = StampPhase::MIDDLE;
    middle.exposure_ns = 1;  // any: times are those of the middle
    const TimeNs middle_ns = now.stamp_ns + middle_after_stamp_ns(shutter_.stamp_phase, now.exposure_ns);
    if (const auto rate = rates_.add(luminance, *camera_, RowExposure(middle_ns, luminance.rows, middle))) {
      footage_->rates.push_back(*rate);
    }
  }

  const std::map<TimeNs, Exposure>& exposures_;
  ShutterTiming shutter_;
  BitDepth bit_depth_;
  FrameTracker tracker_;
  ImageRateTracker rates_;
  std::optional<Camera> camera_;
  std::optional<TimeNs> last_ns_;
  Footage* footage_;
};

std::optional<Eigen::Matrix3d> extrinsic_of(const rosbag::Bag& bag, const std::string& camera_frame,
                                            const std::string& imu_frame) {
  Transforms transforms;
  const auto add = [&](const std::string& name, Transforms::Topic topic) {
    for_each_message<tf2_msgs::TFMessage>(bag, {name},
                                          [&](const tf2_msgs::TFMessage& message) { transforms.add(message, topic); });
  };
  add("/tf", Transforms::Topic::TF);
  add("/tf_static", Transforms::Topic::TF_STATIC);
  return transforms.R_cam_imu(camera_frame, imu_frame);
}

}  // namespace

FootageTopics choose_topics(const InputBag& input, const NamedFootage& named, const Config& config) {
  FootageTopics chosen;
  chosen.image = choose_images(input, named.images);
  const std::string name_space = chosen.image.name_space();
  const bool info_required = !config.calibration || !config.calibration->camera;
  chosen.camera_info = input.choose_topic<sensor_msgs::CameraInfo>("camera_info", named.camera_info,
                                                                   name_space + "/camera_info", info_required);
  chosen.imu = input.choose_topic<sensor_msgs::Imu>("imu", named.imu, "", true);
  chosen.exposure =
      input.choose_topic<Exposure>("exposure", named.exposure, named.images.home(name_space) + "/exposure", false);
  return chosen;
}

void for_each_picture(const InputBag& input, const FootageTopics& topics, const FootageOptions& options,
                      const std::string& what, const std::function<void(const FootagePicture&)>& use) {
  const rosbag::Bag& bag = input.bag();
  rosbag::View whole(bag);
  const ros::Time begin = whole.getBeginTime() + ros::Duration(options.start_s);
  const ros::Time end = options.end_s ? whole.getBeginTime() + ros::Duration(*options.end_s) : ros::TIME_MAX;
  rosbag::View view(bag, rosbag::TopicQuery(topics.image.name), begin, end);
  Progress progress(view.size(), what, options.quiet);
  PictureTracker pictures;
  std::size_t done = 0;
  for (const rosbag::MessageInstance& instance : view) {
    const sensor_msgs::ImageConstPtr image = read_image(instance, topics.image.compressed);
    if (!image) continue;
    FootagePicture picture{to_time_ns(image->header.stamp), to_time_ns(instance.getTime()), image->header.frame_id,
                           view_image(*image)};
    // Between a picture and itself nothing moves, whatever the gyroscope says.
    if (!pictures.add(image, picture.stamp_ns).is_new) continue;
    use(picture);
    progress.done(++done);
  }
}

TimeNs middle_after_stamp_ns(StampPhase phase, TimeNs exposure_ns) {
  return phase == StampPhase::START ? exposure_ns / 2 : phase == StampPhase::END ? -exposure_ns / 2 : 0;
}

Footage read_footage(const InputBag& input, const FootageTopics& topics, const FootageOptions& options,
                     const Config& config) {
  const rosbag::Bag& bag = input.bag();
  Footage footage;
  std::string imu_frame, camera_frame;
  footage.samples = read_gyro(bag, topics.imu, &imu_frame, &footage.imu_delay_ns);
  const std::map<TimeNs, Exposure> exposures = read_exposures(bag, topics.exposure);

  PairCollector collector(exposures, config, options.points, &footage);
  std::vector<TimeNs> delays_ns;
  for_each_picture(input, topics, options, "images followed", [&](const FootagePicture& picture) {
    if (footage.frames == 0) {
      read_camera(bag, picture.pixels.image.size(), topics, config, &footage);
      camera_frame = picture.frame_id;
    }
    const TimeNs stamp_ns = picture.stamp_ns;
    collector.add(stamp_ns, picture.pixels);
    delays_ns.push_back(picture.recorded_ns - stamp_ns);
    footage.images = footage.frames == 1 ? TimeRange{stamp_ns, stamp_ns}
                                         : TimeRange{std::min(footage.images.begin_ns, stamp_ns),
                                                     std::max(footage.images.end_ns, stamp_ns)};
  });
  collector.finish();
  if (footage.frames == 0)
    throw std::runtime_error("no image on " + topics.image.name + " within --start and --end: give a longer slice");
  footage.image_delay_ns = median(std::move(delays_ns));
  footage.R_cam_imu = extrinsic_of(bag, camera_frame, imu_frame);
  return footage;
}

}  // namespace gyro_deblur
