// What calibrate reads of a camera that sends pictures again.
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "picture_bag.hpp"
#include "tools/timing_footage.hpp"

namespace gyro_deblur {
namespace {

using test::HandheldCamera;
using test::Shot;

TEST(ReadFootage, TakesRepeatedPicturesOnce) {
  std::string folder = (std::filesystem::temp_directory_path() / "footage_XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) throw std::runtime_error("no temporary directory");
  const HandheldCamera camera(20);
  const std::string path = folder + "/in.bag";
  const auto read = [&](const std::vector<Shot>& shots) {
    write_bag(path, camera, shots);
    FootageOptions options;
    options.quiet = true;
    Config config;
    config.shutter.exposure_ns = 20 * test::kMs;
    const InputBag bag(path);
    return read_footage(bag, choose_topics(bag, {}, config), options, config);
  };
  const Footage clean = read(camera.every_picture()), twice = read(camera.every_picture_twice());
  std::filesystem::remove_all(folder);
  EXPECT_EQ(clean.frames, 20u);
  EXPECT_EQ(twice.frames, clean.frames);
  EXPECT_EQ(twice.period.get(), HandheldCamera::kPeriodNs);
  EXPECT_GT(clean.windows.size(), 0u);
  EXPECT_EQ(twice.windows.size(), clean.windows.size());
}

}  // namespace
}  // namespace gyro_deblur
