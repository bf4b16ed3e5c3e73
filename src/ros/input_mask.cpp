// Provides the mask for an image.
#include "ros/input_mask.hpp"

#include <exception>

#include <sensor_msgs/image_encodings.h>

#include "base/format.hpp"
#include "mask_file/mask_file.hpp"
#include "ros/image_conversion.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {
namespace {

constexpr char kFileKind[] = "mask file", kTopicKind[] = "mask topic", kSizeKind[] = "mask size";

PixelMask read_message(const sensor_msgs::Image& message) {
  namespace encodings = sensor_msgs::image_encodings;
  if (message.encoding != encodings::MONO8 && message.encoding != encodings::TYPE_8UC1) {
    throw std::invalid_argument("its encoding \"" + message.encoding + "\" is neither mono8 nor 8UC1");
  }
  const cv::Mat used = view_image(message).image;
  if (cv::countNonZero(used) == 0) {
    throw std::invalid_argument("it has no pixel above 0: nothing of the image would be used");
  }
  return PixelMask(used);
}

}  // namespace

void InputMask::set_file(const std::string& path) {
  if (path == path_) return;
  path_ = path;
  if (!by_topic_) mask_ = PixelMask();
  if (path.empty()) {
    problems_.resolve(kFileKind);
    return;
  }
  try {
    const PixelMask mask = load_mask(path);
    problems_.resolve(kFileKind);
    if (by_topic_) return;
    mask_ = mask;
    origin_ = "mask = " + path;
  } catch (const std::exception& error) {
    path_.clear();  // to be tried again
    problems_.report(kFileKind, std::string(error.what()) + ". Images are processed without it", LogLevel::ERROR);
  }
}

void InputMask::set_message(const sensor_msgs::Image& message) {
  try {
    mask_ = read_message(message);
    origin_ = "the message on the topic mask";
    by_topic_ = true;
    problems_.resolve(kTopicKind);
    problems_.resolve(kFileKind);
  } catch (const std::exception& error) {
    problems_.report(kTopicKind,
                     std::string("a message on the topic mask cannot be used: ") + error.what() +
                         ". Publish mono8 of the image's size, 0 where a pixel does not show the scene; until then the "
                         "mask stays what it was",
                     LogLevel::ERROR);
  }
}

PixelMask InputMask::for_image(const cv::Size& size) {
  if (mask_.empty() || mask_.size() == size) {
    problems_.resolve(kSizeKind);
    return mask_;
  }
  problems_.report(kSizeKind,
                   origin_ + " has " + size_text(mask_.size().width, mask_.size().height) + ", the images have " +
                       size_text(size.width, size.height) + ": they are processed without it; give one of their size",
                   LogLevel::ERROR);
  return {};
}

}  // namespace gyro_deblur
