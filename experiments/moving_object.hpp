// A scene with an object that moves by itself, before a camera that rotates.
#pragma once

#include <vector>

#include <opencv2/core.hpp>

#include "footage.hpp"

namespace gyro_deblur::experiments {

/// What became of blocks, over all frames after the first two.
struct BlockCounts {
  int blocks = 0;
  int blurred = 0;                ///< by min_extent_px and more
  int wrong = 0;                  ///< deblurred for a displacement that is off by 3 px and more
  int left = 0;                   ///< of the blurred ones: not deblurred
  std::vector<double> errors_px;  ///< of the displacement
};

struct ObjectResult {
  BlockCounts object;        ///< that lie in the object altogether
  BlockCounts surroundings;  ///< that see nothing of it
  cv::Mat shown;             ///< the middle frame as it comes out, CV_8UC1
};

/// An object in front of a rotating camera, deblurred by the gyroscope alone and with the images.
struct ObjectScene {
  ObjectResult alone, images;
  cv::Mat blurred;  ///< the middle frame as it arrived
};

/// @param footage        of a camera that rotates, with a global shutter
/// @param velocity_px_s  of the object in the image; zero: the camera follows it
ObjectScene film_object(const Footage& footage, const cv::Point2d& velocity_px_s);

}  // namespace gyro_deblur::experiments
