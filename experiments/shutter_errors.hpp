// Where the image of a global shutter finds its points in an image of a rolling one, against where they are.
#pragma once

#include <array>
#include <vector>

#include "feature_gain.hpp"
#include "footage.hpp"

namespace gyro_deblur::experiments {

/// Distances [px] between where global_shutter_map() looks for points and where they are, for points on a grid of 16 px
/// of all frames after the first two; one list for each of kAllKnowledge. NONE: every row stays where it is.
std::array<std::vector<double>, 4> shutter_errors(const Footage& footage, const Light& light);

/// The frame that the rolling shutter distorts most, in daylight.
struct CurvedFrame {
  cv::Mat arrived, global_shutter;  ///< CV_8UC1; the second as the pipeline makes it
};
CurvedFrame most_curved_frame(const Footage& footage);

}  // namespace gyro_deblur::experiments
