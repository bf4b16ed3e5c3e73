// The mask of the input images: from a file, or from the topic, which replaces it.
#pragma once

#include <string>

#include <sensor_msgs/Image.h>

#include "gyro_deblur/pixel_mask.hpp"
#include "sync/input_problems.hpp"

namespace gyro_deblur {

/// A mask that cannot be used is reported, and images are processed without it: what it would have kept out is then
/// found, as far as it can be, by StaticContent. Its owner serialises access.
class InputMask {
 public:
  /// @param problems  has to outlive this
  explicit InputMask(InputProblems* problems) : problems_(*problems) {}

  /// Reads a file that is not in use already. Empty: no file.
  void set_file(const std::string& path);
  /// From the topic. One that cannot be used changes nothing.
  void set_message(const sensor_msgs::Image& message);

  /// For an image of this size [px]; empty where the mask has another one.
  PixelMask for_image(const cv::Size& size);

 private:
  InputProblems& problems_;
  PixelMask mask_;
  std::string path_;    // of the file that mask_ is from, or was
  std::string origin_;  // of mask_, as users know it
  bool by_topic_ = false;
};

}  // namespace gyro_deblur
