// From compressed image messages to images.
#pragma once

#include <string>

#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <opencv2/core.hpp>

namespace gyro_deblur {

/// What a compressed message holds.
struct DecodedImage {
  sensor_msgs::ImagePtr image;  ///< with the message's header; null where nothing can be decoded
  std::string problem;          ///< why there is no image, or why it is not whole; else empty
};

/// Decodes what OpenCV reads (JPEG, PNG, ...). The encoding is the one that image_transport's own subscriber gives:
/// the name before the semicolon of `format`, "ENCODING; jpeg compressed ORDER", where the decoded pixels have its
/// channels and depth. Colours that the format does not call "compressed bgr" are in RGB order
/// (compressed_subscriber.cpp of compressed_image_transport 1.14). Without a semicolon, or where name and pixels do not
/// fit: mono8, bgr8 or bgra8, or the same with 16 bits.
DecodedImage decode_image(const sensor_msgs::CompressedImage& compressed);

/// The encoding that pixels as OpenCV decodes them have: mono, bgr or bgra of 8 or 16 bits; empty when there is none.
std::string encoding_of(const cv::Mat& pixels);

}  // namespace gyro_deblur
