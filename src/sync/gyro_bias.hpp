// The gyroscope's bias from the samples that have come.
#pragma once

#include <optional>
#include <string>

#include <Eigen/Core>

#include "gyro_deblur/config.hpp"
#include "sync/gyro_source.hpp"

namespace gyro_deblur {

/// A mean of fewer samples is too uncertain for a bias.
constexpr std::size_t kMinBiasSamples = 20;

/// Averages the newest samples over the configured window.
/// @param text  set to one line: the bias, or why there is none (the sensor moved, or samples are missing)
/// @return [rad/s]
std::optional<Eigen::Vector3d> estimate_bias(const GyroReader& gyro, const Config& config, std::string* text);

}  // namespace gyro_deblur
