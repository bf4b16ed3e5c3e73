#include "faults.hpp"

#include <algorithm>
#include <limits>
#include <random>
#include <string>
#include <utility>

#include <boost/make_shared.hpp>
#include <opencv2/imgproc.hpp>

#include "ros/conversions.hpp"

namespace gyro_deblur::test {
namespace {

constexpr TimeNs kSecond = 1'000'000'000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

/// Full scale of a common gyroscope, 2000 degrees a second [rad/s]; gyro_range in config.yaml.
constexpr double kFullScaleRadS = 34.9;

using Random = std::mt19937_64;

int pick(Random& random, int count) { return std::uniform_int_distribution<int>(0, count - 1)(random); }
double uniform(Random& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

void corrupt(sensor_msgs::Imu& imu, Random& random) {
  switch (pick(random, 4)) {
    case 0:
      imu.angular_velocity.y = kNan;
      break;
    case 1:
      imu.angular_velocity.x = -kInf;
      break;
    case 2:
      imu.angular_velocity.x = imu.angular_velocity.y = imu.angular_velocity.z = kFullScaleRadS;
      break;
    default:
      imu.angular_velocity_covariance[0] = -1;
      break;
  }
}

void corrupt(sensor_msgs::Image& image, Random& random) {
  switch (pick(random, 8)) {
    case 0:
      image.data.resize(image.data.size() / 2);
      break;
    case 1:
      image.data.clear();
      break;
    case 2:
      std::fill(image.data.begin(), image.data.end(), 255);  // saturated
      break;
    case 3:
      image.encoding = "nonsense";
      break;
    case 4:
      image.encoding = "32FC1";
      break;
    case 5:
      image.step = 1;
      break;
    case 6:
      image.height = std::numeric_limits<std::uint32_t>::max();
      break;
    default:
      image.width = 0;
      break;
  }
}

void corrupt(sensor_msgs::CameraInfo& info, Random& random) {
  switch (pick(random, 8)) {
    case 0:
      info.K[0] = kNan;
      break;
    case 1:
      info.K[2] = kInf;
      break;
    case 2:
      info.K.fill(0);
      break;
    case 3:
      info.D.assign(5, 1e300);
      break;
    case 4:
      info.D.assign(3, kNan);
      break;
    case 5:
      info.width = std::numeric_limits<std::uint32_t>::max();
      break;
    case 6:
      info.distortion_model = "nonsense";
      break;
    default:
      info.roi.y_offset = info.binning_y = std::numeric_limits<std::uint32_t>::max();
      break;
  }
}

void corrupt(Exposure& exposure, Random& random) {
  switch (pick(random, 4)) {
    case 0:
      exposure.exposure_time = ros::Duration(0, 0);
      break;
    case 1:
      exposure.exposure_time = ros::Duration(-1, 0);
      break;
    case 2:
      exposure.exposure_time = ros::Duration(std::numeric_limits<std::int32_t>::max(), 0);
      break;
    default:
      exposure.readout_time = ros::Duration(std::numeric_limits<std::int32_t>::min(), 0);
      break;
  }
}

/// Replaces a delivery's message by a changed copy.
template <typename Change>
void change(Delivery* delivery, Change change_message) {
  std::visit(
      [&](auto& message) {
        if constexpr (!std::is_same_v<std::decay_t<decltype(message)>, ActionConstPtr>) {
          auto copy = copy_of(message);
          change_message(*copy);
          message = copy;
        }
      },
      delivery->message);
}

void shift_stamp(Delivery* delivery, TimeNs by_ns) {
  change(delivery,
         [by_ns](auto& message) { message.header.stamp = to_ros_time(to_time_ns(message.header.stamp) + by_ns); });
}

void sort_by_arrival(std::vector<Delivery>* deliveries) {
  std::stable_sort(deliveries->begin(), deliveries->end(),
                   [](const Delivery& a, const Delivery& b) { return a.at_ns < b.at_ns; });
}

/// When the second message of the stream after `from` arrives; a second later where there is none.
TimeNs arrival_after_two(const std::vector<Delivery>& deliveries, std::size_t from, Stream stream) {
  int left = 2;
  for (std::size_t i = from + 1; i < deliveries.size(); ++i) {
    if (stream_of(deliveries[i]) == stream && --left == 0) return deliveries[i].at_ns;
  }
  return deliveries[from].at_ns + kSecond;
}

cv::Mat pixels_of(const sensor_msgs::Image& image) { return view_image(image).image; }

sensor_msgs::ImageConstPtr image_like(const sensor_msgs::Image& like, const cv::Mat& pixels,
                                      const std::string& encoding) {
  sensor_msgs::Image header_and_encoding;
  header_and_encoding.header = like.header;
  header_and_encoding.encoding = encoding;
  return to_image(pixels, header_and_encoding);
}

}  // namespace

const char* to_string(Fault fault) {
  switch (fault) {
    case Fault::DROP:
      return "drop";
    case Fault::DELAY:
      return "delay";
    case Fault::DUPLICATE:
      return "duplicate";
    case Fault::REORDER:
      return "reorder";
    case Fault::CORRUPT:
      return "corrupt";
    case Fault::TIME_JUMP:
      return "time-jump";
  }
  return "unknown";
}

std::vector<Delivery> inject(const std::vector<Delivery>& deliveries, Stream stream, Fault fault, double rate,
                             std::uint64_t seed) {
  Random random(seed);
  std::vector<Delivery> result;
  result.reserve(deliveries.size());
  for (std::size_t i = 0; i < deliveries.size(); ++i) {
    Delivery delivery = deliveries[i];
    if (stream_of(delivery) != stream || uniform(random, 0, 1) >= rate) {
      result.push_back(std::move(delivery));
      continue;
    }
    switch (fault) {
      case Fault::DROP:
        continue;
      case Fault::DELAY:
        delivery.at_ns += to_ns(uniform(random, 0.01, 1));
        delivery.clock_ns = delivery.at_ns;
        break;
      case Fault::DUPLICATE:
        result.push_back(delivery);
        break;
      case Fault::REORDER:
        delivery.at_ns = delivery.clock_ns = arrival_after_two(deliveries, i, stream) + 1;
        break;
      case Fault::CORRUPT:
        change(&delivery, [&random](auto& message) { corrupt(message, random); });
        break;
      case Fault::TIME_JUMP:
        shift_stamp(&delivery, to_ns((pick(random, 2) == 0 ? -1 : 1) * uniform(random, 1, 100)));
        break;
    }
    result.push_back(std::move(delivery));
  }
  sort_by_arrival(&result);
  return result;
}

std::vector<Delivery> silence(const std::vector<Delivery>& deliveries, Stream stream, TimeNs from_ns, TimeNs to_ns) {
  std::vector<Delivery> result;
  for (const Delivery& delivery : deliveries) {
    if (stream_of(delivery) != stream || delivery.at_ns < from_ns || delivery.at_ns >= to_ns) {
      result.push_back(delivery);
    }
  }
  return result;
}

std::vector<Delivery> thin_out(const std::vector<Delivery>& deliveries, Stream stream, std::size_t period) {
  std::vector<Delivery> result;
  std::size_t count = 0;
  for (const Delivery& delivery : deliveries) {
    if (stream_of(delivery) != stream || count++ % period == 0) result.push_back(delivery);
  }
  return result;
}

std::vector<Delivery> unset_stamps(const std::vector<Delivery>& deliveries, Stream stream, std::size_t period,
                                   std::size_t first) {
  std::vector<Delivery> result = deliveries;
  std::size_t count = 0;
  for (Delivery& delivery : result) {
    if (stream_of(delivery) != stream || count++ % period != first) continue;
    change(&delivery, [](auto& message) { message.header.stamp = ros::Time(); });
  }
  return result;
}

std::vector<Delivery> in_batches(const std::vector<Delivery>& deliveries, Stream stream, TimeNs batch_ns) {
  std::vector<Delivery> result = deliveries;
  const TimeNs begin_ns = deliveries.front().at_ns;
  for (Delivery& delivery : result) {
    if (stream_of(delivery) != stream) continue;
    const TimeNs waits_ns = batch_ns - 1 - (delivery.at_ns - begin_ns) % batch_ns;
    delivery.at_ns += waits_ns;
    delivery.clock_ns += waits_ns;
  }
  sort_by_arrival(&result);
  return result;
}

std::vector<Delivery> step_clock(const std::vector<Delivery>& deliveries, TimeNs from_ns, TimeNs step_ns) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    if (delivery.at_ns < from_ns) continue;
    delivery.clock_ns += step_ns;
    shift_stamp(&delivery, step_ns);
  }
  return result;
}

std::vector<Delivery> clip_gyro(const std::vector<Delivery>& deliveries, double range_rad_s) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    auto* imu = std::get_if<sensor_msgs::ImuConstPtr>(&delivery.message);
    if (imu == nullptr) continue;
    auto clipped = copy_of(*imu);
    for (double* rate : {&clipped->angular_velocity.x, &clipped->angular_velocity.y, &clipped->angular_velocity.z}) {
      *rate = std::clamp(*rate, -range_rad_s, range_rad_s);
    }
    *imu = clipped;
  }
  return result;
}

std::vector<Delivery> scale_rates(const std::vector<Delivery>& deliveries, double factor) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    auto* imu = std::get_if<sensor_msgs::ImuConstPtr>(&delivery.message);
    if (imu == nullptr) continue;
    auto scaled = copy_of(*imu);
    for (double* rate : {&scaled->angular_velocity.x, &scaled->angular_velocity.y, &scaled->angular_velocity.z}) {
      *rate *= factor;
    }
    *imu = scaled;
  }
  return result;
}

std::vector<Delivery> shift_clock(const std::vector<Delivery>& deliveries, Stream stream, TimeNs by_ns) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    if (stream_of(delivery) == stream) shift_stamp(&delivery, by_ns);
  }
  return result;
}

std::vector<Delivery> set_exposures(const std::vector<Delivery>& deliveries, TimeNs exposure_ns, std::size_t count) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    auto* exposure = std::get_if<ExposureConstPtr>(&delivery.message);
    if (exposure == nullptr || count == 0) continue;
    --count;
    auto changed = copy_of(*exposure);
    changed->exposure_time.fromNSec(exposure_ns);
    *exposure = changed;
  }
  return result;
}

std::vector<Delivery> with_action(const std::vector<Delivery>& deliveries, TimeNs period_ns, const Action& action) {
  std::vector<Delivery> result = deliveries;
  const ActionConstPtr shared = boost::make_shared<Action>(action);
  for (TimeNs at_ns = deliveries.front().at_ns; at_ns <= deliveries.back().at_ns; at_ns += period_ns) {
    result.push_back({at_ns, at_ns, shared, 0});
  }
  sort_by_arrival(&result);
  return result;
}

namespace {

/// Images for which `repeats` holds show the picture of the one before, under their own stamps; their truth is its.
template <typename Repeats>
std::vector<Delivery> with_repetitions(const std::vector<Delivery>& deliveries, Repeats repeats) {
  std::vector<Delivery> result = deliveries;
  const Delivery* shown = nullptr;
  for (Delivery& delivery : result) {
    auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message);
    if (image == nullptr) continue;
    if (shown != nullptr && repeats(delivery)) {
      auto again = copy_of(std::get<sensor_msgs::ImageConstPtr>(shown->message));
      again->header = (*image)->header;
      *image = again;
      delivery.frame = shown->frame;
    }
    shown = &delivery;
  }
  return result;
}

}  // namespace

std::vector<Delivery> repeat_pictures(const std::vector<Delivery>& deliveries, std::size_t period) {
  std::size_t images = 0;
  return with_repetitions(deliveries, [&](const Delivery&) { return ++images % period == 0; });
}

std::vector<Delivery> freeze(const std::vector<Delivery>& deliveries, TimeNs from_ns, TimeNs to_ns) {
  return with_repetitions(
      deliveries, [&](const Delivery& delivery) { return delivery.at_ns >= from_ns && delivery.at_ns < to_ns; });
}

std::vector<Delivery> change_encodings(const std::vector<Delivery>& deliveries, std::size_t period) {
  std::vector<Delivery> result = deliveries;
  for (Delivery& delivery : result) {
    auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message);
    if (image == nullptr) continue;
    const cv::Mat grey = pixels_of(**image);
    cv::Mat pixels = grey;
    switch (delivery.frame / period % 9) {
      case 1:
        grey.convertTo(pixels, CV_16U, 257);
        *image = image_like(**image, pixels, "mono16");
        break;
      case 2:
        cv::cvtColor(grey, pixels, cv::COLOR_GRAY2BGR);
        *image = image_like(**image, pixels, "bgr8");
        break;
      case 3:
        cv::cvtColor(grey, pixels, cv::COLOR_GRAY2RGBA);
        *image = image_like(**image, pixels, "rgba8");
        break;
      case 4:
        *image = image_like(**image, grey, "bayer_rggb8");
        break;
      case 5:
        *image = image_like(**image, grey, "nonsense");
        break;
      case 6:
        cv::cvtColor(grey, pixels, cv::COLOR_GRAY2RGB);
        *image = image_like(**image, pixels, "rgb8");
        break;
      case 7:
        cv::cvtColor(grey, pixels, cv::COLOR_GRAY2BGR);
        *image = image_like(**image, pixels, "8UC3");
        break;
      case 8:
        cv::merge(std::vector<cv::Mat>{cv::Mat(grey.size(), CV_8UC1, cv::Scalar(128)), grey}, pixels);
        *image = image_like(**image, pixels, "yuv422");
        break;
      default:
        break;
    }
  }
  return result;
}

std::vector<Delivery> change_sizes(const std::vector<Delivery>& deliveries, std::size_t period) {
  std::vector<Delivery> result = deliveries;
  const auto size_of = [period](std::size_t frame, cv::Size full) {
    const std::pair<int, int> parts[] = {{4, 4}, {2, 4}, {3, 2}, {1, 1}};  // quarters of width and height
    const auto& [width, height] = parts[frame / period % 4];
    return cv::Size(full.width * width / 4, full.height * height / 4);
  };
  for (Delivery& delivery : result) {
    if (auto* image = std::get_if<sensor_msgs::ImageConstPtr>(&delivery.message)) {
      const cv::Mat pixels = pixels_of(**image);
      *image = image_like(**image, pixels(cv::Rect({}, size_of(delivery.frame, pixels.size()))), (*image)->encoding);
    } else if (auto* info = std::get_if<sensor_msgs::CameraInfoConstPtr>(&delivery.message)) {
      auto cut = copy_of(*info);
      const cv::Size size = size_of(delivery.frame, {static_cast<int>(cut->width), static_cast<int>(cut->height)});
      cut->width = static_cast<std::uint32_t>(size.width);
      cut->height = static_cast<std::uint32_t>(size.height);
      *info = cut;
    }
  }
  return result;
}

}  // namespace gyro_deblur::test
