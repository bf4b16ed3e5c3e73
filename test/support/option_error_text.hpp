// What an OptionError says.
#pragma once

#include <functional>
#include <string>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur::test {

/// The text of the OptionError that `action` throws; empty when it throws none. Other exceptions pass.
inline std::string option_error(const std::function<void()>& action) {
  try {
    action();
  } catch (const OptionError& error) {
    return error.what();
  }
  return {};
}

}  // namespace gyro_deblur::test
