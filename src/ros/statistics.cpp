// Counts frames by outcome.
#include "ros/statistics.hpp"

namespace gyro_deblur {

void OutputStatistics::count(const FrameOutput& output) {
  ++(output.dropped ? dropped_poor : frames_out);
  if (output.reason != PassThroughReason::NONE) ++passed_through[output.reason];
  if (output.field) {
    for (const BlockBlur& block : output.field->blocks) {
      ++blocks[block.status];
      if (block.residual) ++blocks_from_images;
    }
  }
  if (output.field && output.field->images_alone && output.reason == PassThroughReason::NONE) ++frames_by_images_alone;
  for (const auto& [reason, number] : output.fallback_counts) fallback_counts[reason] += number;
  keypoints_text = output.keypoints_text;
}

}  // namespace gyro_deblur
