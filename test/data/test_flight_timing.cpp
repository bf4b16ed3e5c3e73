// Timing of a camera that flies through a room: recorded trajectories through the simulator.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "flight_timing.hpp"

namespace gyro_deblur {
namespace {

constexpr double kNanoseconds = 1e-6;  // in milliseconds

/// @param seconds  experiments/flight_timing.cpp flies for forty
void expect_calibrated(std::size_t flight, double seconds, TimeNs exposure_ns, TimeNs readout_ns) {
  const std::string folder = GYRO_DEBLUR_DATA_DIR;
  if (!std::filesystem::exists(folder + "/trajectories")) GTEST_SKIP() << "no " << folder << "/trajectories";
  const test::FlightTiming timing =
      test::calibrate_flight({test::recorded_flights().at(flight), seconds, 1, exposure_ns, readout_ns}, folder);
  std::printf("offset %.3f ms, readout %.3f ms, bias %.4f rad/s, rotation %.3f degrees wrong; normalised %.2f\n",
              timing.offset_ms(), timing.readout_ms(), timing.bias_rad_s(), timing.rotation_deg(),
              std::sqrt(timing.normalised_square()));
  constexpr double kOffsetMs = 0.5, kReadoutPart = 0.03, kGlobalReadoutMs = 0.6, kBiasRadS = 0.003, kRotationDeg = 0.3;
  EXPECT_LT(timing.offset_ms(), kOffsetMs);
  EXPECT_LT(timing.readout_ms(),
            readout_ns == 0 ? kGlobalReadoutMs : kReadoutPart * kNanoseconds * static_cast<double>(readout_ns));
  EXPECT_LT(timing.bias_rad_s(), kBiasRadS);
  EXPECT_LT(timing.rotation_deg(), kRotationDeg);
  constexpr double kSigmas = 3;
  for (Eigen::Index i = 0; i < timing.errors.size(); ++i) {
    EXPECT_LT(std::abs(timing.errors[i]), kSigmas * timing.stddevs[i]) << "value " << i;
  }
  // There was something to be confused by.
  EXPECT_GT(timing.estimate.median_at_start_px, 20 * timing.estimate.median_px);
  EXPECT_GT(timing.estimate.speed_per_s, 0.1);
}

TEST(FlightTiming, EurocRollingShutter) { expect_calibrated(0, 12, 15'000'000, 20'000'000); }
TEST(FlightTiming, EurocLongExposureGlobalShutter) { expect_calibrated(1, 12, 30'000'000, 0); }
TEST(FlightTiming, HandHeldLongExposureRollingShutter) { expect_calibrated(2, 20, 30'000'000, 20'000'000); }

}  // namespace
}  // namespace gyro_deblur
