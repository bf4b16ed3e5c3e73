// Any text as a configuration: accepted and valid, or refused with OptionError.
#include <cstddef>
#include <cstdint>
#include <string>

#include "gyro_deblur/config.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    gyro_deblur::parse_config(std::string(reinterpret_cast<const char*>(data), size)).validate();
  } catch (const gyro_deblur::OptionError&) {
    // What anything else than a configuration has to give.
  }
  return 0;
}
