// The exposure estimated from real blur.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "recorded_exposure.hpp"

namespace gyro_deblur {
namespace {

constexpr double kMs = 1e6;
const std::string kData = GYRO_DEBLUR_DATA_DIR, kDescriptions = GYRO_DEBLUR_SOURCE_DIR "/config/recordings/";

TEST(RecordedExposure, OfShieldBurstIsTwentyMilliseconds) {
  const std::string folder = kData + "/shield_burst";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no " << folder;
  const Recording recording = read_frames(folder, kDescriptions + "shield_burst.yaml");
  for (const double assumed_ms : {10.0, 20.0, 30.0}) {
    SCOPED_TRACE(assumed_ms);
    const auto estimates = test::recorded_exposures(recording, std::llround(assumed_ms * kMs));
    ASSERT_EQ(estimates.size(), 7U);
    // The first two have no flow from the images before, and the camera moves sideways.
    for (std::size_t i = 2; i < estimates.size(); ++i) {
      EXPECT_TRUE(estimates[i]) << "frame " << i + 1;
      if (!estimates[i]) continue;
      const double exposure_ms = assumed_ms * estimates[i]->ratio;
      std::printf("assumed %.0f ms, frame %zu: %.2f ms, within %.1f %%\n", assumed_ms, i + 1, exposure_ms,
                  100 * estimates[i]->log_stddev);
      EXPECT_NEAR(exposure_ms, 20, 0.05 * 20) << "frame " << i + 1;
      EXPECT_LT(std::abs(std::log(exposure_ms / 20)), 3 * estimates[i]->log_stddev) << "frame " << i + 1;
    }
  }
}

TEST(RecordedExposure, OfSharpImagesIsNotKnown) {
  const std::string folder = kData + "/phone_sharp";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no " << folder;
  const Recording recording = read_frames(folder, kDescriptions + "phone_sharp.yaml");
  for (const double assumed_ms : {2.0, 5.0, 15.0, 30.0}) {
    const auto estimates = test::recorded_exposures(recording, std::llround(assumed_ms * kMs));
    ASSERT_EQ(estimates.size(), 40U);
    for (std::size_t i = 0; i < estimates.size(); ++i) {
      if (!estimates[i]) continue;
      ADD_FAILURE() << "assumed " << assumed_ms << " ms, frame " << i + 1 << ": " << estimates[i]->ratio * assumed_ms
                    << " ms within " << 100 * estimates[i]->log_stddev << " %";
    }
  }
}

}  // namespace
}  // namespace gyro_deblur
