// The files that repeat the table of parameters, as they have to be.
#pragma once

#include <string>

namespace gyro_deblur {
namespace test {

/// config/default.yaml: every key with its default.
std::string default_yaml();

/// cfg/Deblur.cfg: what may change while running.
std::string deblur_cfg();

/// The part of doc/guides/parameters.md between its markers.
std::string parameter_tables();

}  // namespace test
}  // namespace gyro_deblur
