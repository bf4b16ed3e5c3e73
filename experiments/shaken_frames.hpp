// Frames that a recorded hand shake has blurred, before a wall of photographs.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"
#include "image_pairs.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::experiments {

struct ShakenCamera {
  const char* name;
  int width_px, height_px;
  double focal_px;
};
constexpr ShakenCamera kVga{"752x480", 752, 480, 460}, kFullHd{"1080p", 1920, 1080, 1559};

/// When a frame is exposed, and where the camera looks in the middle of it.
struct View {
  double middle_s;
  Eigen::Quaterniond R_world_cam;
  std::size_t photograph;
};

constexpr int kPhotographs = 4, kViewsOfEach = 4;

/// Views at random times of a recording of this length, kViewsOfEach of each photograph.
std::vector<View> random_views(std::uint64_t seed, double length_s);

/// One frame without noise, blurred and sharp.
struct Shot {
  sim::Simulator simulator;
  cv::Mat blurred, sharp;  ///< CV_16UC1, 257 a grey level
  RotationTrack rotation;
};

/// What a camera that shakes as recorded, `scale` times as fast, sees of a wall of photographs.
Shot take_shot(const ShakenCamera& camera, const std::vector<sim::TraceSample>& trace, double scale, TimeNs exposure_ns,
               const View& view, const std::vector<ImagePair>& photographs);

/// Features where they were at the middle of the exposure.
Features rectified(Features features, const FrameBlur& field, const Shot& shot);

/// The recording in the data's folder. Throws std::runtime_error when there is none.
std::vector<sim::TraceSample> load_hand_shake(const std::string& data);

}  // namespace gyro_deblur::experiments
