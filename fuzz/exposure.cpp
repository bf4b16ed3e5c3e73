// Any exposure metadata, with any configured timing, for an image at any time.
#include <cstddef>
#include <cstdint>

#include "input_bytes.hpp"
#include "one_camera.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace gyro_deblur::fuzz;
  InputBytes bytes(data, size);
  OneCamera camera;
  gyro_deblur::Config config = good_config();
  config.shutter.exposure_ns = bytes.take<std::int64_t>();
  config.shutter.readout_ns = bytes.take<std::int64_t>();
  config.shutter.stamp_row = static_cast<gyro_deblur::StampRow>(bytes.choice(3));
  config.shutter.stamp_phase = static_cast<gyro_deblur::StampPhase>(bytes.choice(3));
  config.gyro.time_offset_ns = bytes.take<std::int64_t>();
  try {
    camera.processor().set_config(config);
  } catch (const gyro_deblur::OptionError&) {
    // The good one stays in use.
  }
  camera.add_motion();
  while (!bytes.empty()) {
    const auto image = good_image();
    const auto info = good_camera_info();
    gyro_deblur::Exposure exposure;
    if (bytes.choice(2) == 1)
      image->header.stamp = ros::Time(bytes.take<std::uint32_t>(), bytes.take<std::uint32_t>() % 1000000000);
    info->header.stamp = exposure.header.stamp = image->header.stamp;
    exposure.exposure_time.sec = bytes.take<std::int32_t>();
    exposure.exposure_time.nsec = bytes.take<std::int32_t>();
    exposure.readout_time.sec = bytes.take<std::int8_t>();
    exposure.readout_time.nsec = bytes.take<std::int32_t>();
    info->roi.height = bytes.take<std::uint8_t>();
    camera.processor().add_exposure(exposure);
    camera.processor().add_camera_info(info);
    camera.add_image(image);
    camera.advance();
  }
  camera.finish();
  return 0;
}
