// Between image messages and pixels.
#pragma once

#include <optional>
#include <string>

#include <sensor_msgs/Image.h>
#include <std_msgs/Header.h>
#include <opencv2/core.hpp>

#include "gyro_deblur/image_format.hpp"

namespace gyro_deblur {

/// Pixels of an image message without a copy (big-endian 16-bit data is swapped into one).
struct ImageView {
  cv::Mat image;  ///< shares the message's memory: it must outlive this, and must not be written to
  PixelLayout layout = PixelLayout::GRAY;
};

/// Throws FrameError: BAD_IMAGE when empty or its buffer does not fit its header, UNSUPPORTED_ENCODING.
ImageView view_image(const sensor_msgs::Image& message);

/// Type of the cv::Mat that view_image gives for an encoding; nothing where it is not supported.
std::optional<int> type_of_encoding(const std::string& encoding);

/// The checks of view_image alone.
void check_image(const sensor_msgs::Image& message);

/// An image message with the header and encoding of `input` and other pixels of the same type.
sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const sensor_msgs::Image& input);

/// Little-endian, rows without padding.
sensor_msgs::ImagePtr to_image(const cv::Mat& pixels, const std_msgs::Header& header, const std::string& encoding);

}  // namespace gyro_deblur
