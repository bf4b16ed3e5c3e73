// Which topics deblur_bag reads, and where it writes.
#pragma once

#include <string>

#include "gyro_deblur/config.hpp"
#include "tools/bag_file.hpp"
#include "tools/image_topics.hpp"

namespace gyro_deblur {

/// Topics that the user named; empty ones are looked for.
struct NamedTopics {
  NamedImages images;
  std::string camera_info, imu, exposure;
  bool mask_by_file = false;  ///< that of the bag is left aside
  std::string output_namespace;
};

struct DeblurTopics {
  ImageTopic image;
  std::string imu, camera_info, exposure, mask;  ///< empty: none
  bool reads_driver_messages = false;            ///< exposure has messages of another type than the package's
  std::string output_namespace;
};

/// Throws std::runtime_error that names the bag, and lists its topics.
DeblurTopics choose_topics(const InputBag& input, const NamedTopics& named, const Config& config);

}  // namespace gyro_deblur
