// What a camera publishes whose pictures repeat, freeze or jump.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <yaml-cpp/yaml.h>
#include <opencv2/core.hpp>

#include "gyro_deblur/time.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::test {

/// A published image.
struct Shot {
  cv::Mat pixels;
  TimeNs stamp_ns = 0;
  int picture = 0;       ///< of the simulated camera, that it shows
  bool repeats = false;  ///< an image before showed it
};

/// A hand-held camera before a wall: rotates and moves, never at rest, blur of 5 to 10 px, times `speed`.
class HandheldCamera {
 public:
  static constexpr TimeNs kPeriodNs = 50'000'000;

  explicit HandheldCamera(int frames = 40, double speed = 1)
      : simulator_(sim::parse_scene(YAML::Load("frames: " + std::to_string(frames) + R"(
seed: 5
lead_time: 1
camera: {size: [376, 240], intrinsics: [235, 235, 187.5, 119.5], fps: 20, exposure_time: 0.02, readout_time: 0.015,
  noise: 1.5}
imu: {rate: 200}
planes: [{size: [9, 7], position: [0, 0, 2], texture_size: [1600, 1244], texture_seed: 4}]
motion: {type: curve, rotation: {sines: [{amplitude: [6, 9, 5], frequency: )" +
                                               std::to_string(1.3 * speed) +
                                               R"(, phase: 20},
                                          {amplitude: [4, -3, 6], frequency: )" +
                                               std::to_string(1.9 * speed) + R"(, phase: 70}]},
  position: {sines: [{amplitude: [0.08, 0.06, 0.05], frequency: 0.9, phase: 70}]}}
)"),
                                    "", "handheld camera")) {
    for (int i = 0; i < frames; ++i) {
      pictures_.push_back(simulator_.frame(i).image);
      sharp_.push_back(simulator_.sharp(i));
    }
  }

  const sim::Simulator& simulator() const { return simulator_; }
  int frames() const { return simulator_.frames(); }
  const cv::Mat& picture(int i) const { return pictures_[static_cast<std::size_t>(i)]; }

  const cv::Mat& sharp(int i) const { return sharp_[static_cast<std::size_t>(i)]; }

  Shot shot(int i) const { return {picture(i), simulator_.stamp(i), i, false}; }
  /// The picture again, so long after it.
  Shot repetition(int i, TimeNs after_ns) const { return {picture(i), simulator_.stamp(i) + after_ns, i, true}; }

  /// Every picture, and after each those that `after` gives.
  std::vector<Shot> every_picture(const std::function<std::vector<Shot>(int)>& after = {}) const {
    std::vector<Shot> shots;
    for (int i = 0; i < frames(); ++i) {
      shots.push_back(shot(i));
      if (!after) continue;
      for (const Shot& more : after(i)) shots.push_back(more);
    }
    return shots;
  }
  /// At twice the sensor's rate.
  std::vector<Shot> every_picture_twice() const {
    return every_picture([this](int i) { return std::vector<Shot>{repetition(i, kPeriodNs / 2)}; });
  }
  /// The one before in place of each fifth.
  std::vector<Shot> every_fifth_replaced() const {
    std::vector<Shot> shots = every_picture();
    for (int i = 4; i < frames(); i += 5) shots[static_cast<std::size_t>(i)] = repetition(i - 1, kPeriodNs);
    return shots;
  }

  /// PSNR [dB] of an image of a picture against the truth without blur.
  double psnr_db(const cv::Mat& image, int picture) const {
    return test::psnr_db(image, sharp_[static_cast<std::size_t>(picture)]);
  }

 private:
  sim::Simulator simulator_;
  std::vector<cv::Mat> pictures_, sharp_;
};

}  // namespace gyro_deblur::test
