// Any text as a calibration file (Kalibr, EuRoC, VINS, Basalt, camera_calibration): read, or refused with OptionError.
#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "gyro_deblur/calibration.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const int file = memfd_create("calibration", 0);
  if (file < 0 || write(file, data, size) != static_cast<ssize_t>(size)) std::abort();
  try {
    const auto calibration = gyro_deblur::load_calibration("/proc/self/fd/" + std::to_string(file));
    if (calibration.camera) calibration.camera->validate();
    gyro_deblur::merge_calibrations({calibration, calibration});
  } catch (const gyro_deblur::OptionError&) {
    // What anything else than a calibration has to give.
  }
  close(file);
  return 0;
}
