// Writes the output of deblur_bag.
#include "tools/deblur_output.hpp"

#include <cmath>
#include <cstddef>
#include <vector>

#include "base/median.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "ros/conversions.hpp"
#include "ros/outputs.hpp"

namespace gyro_deblur {
namespace {

/// Axial angle as degrees in (-90, 90], where small angles stay small.
double readable_degrees(double angle_rad) {
  const double degrees = angle_rad * 180 / M_PI;
  return degrees > 90 ? degrees - 180 : degrees;
}

void report_field(const FrameBlur& field, nlohmann::json* frame) {
  std::vector<double> extents;
  for (const BlockBlur& block : field.blocks) {
    if (block.status != BlockStatus::NO_GYRO && block.status != BlockStatus::MASKED) extents.push_back(block.extent_px);
  }
  const BlockBlur& center = field.blocks[static_cast<std::size_t>(
      field.grid.index_at((field.grid.width_px() - 1) / 2.0, (field.grid.height_px() - 1) / 2.0))];
  (*frame)["median_extent_px"] = median(extents);
  (*frame)["center_extent_px"] = center.extent_px;
  (*frame)["center_angle_deg"] = readable_degrees(center.angle_rad);
  (*frame)["exposure_s"] = to_seconds(field.exposure_ns);
  (*frame)["readout_s"] = to_seconds(field.readout_ns);
  for (const BlockStatus status : kBlockStatuses) {
    (*frame)["blocks"][to_string(status)] = field.count(status);
  }
}

nlohmann::json report_of(const FrameOutput& output) {
  nlohmann::json frame;
  frame["stamp_ns"] = to_time_ns(output.input->header.stamp);
  frame["reason"] = to_string(output.reason);
  if (!output.reason_text.empty()) frame["reason_text"] = output.reason_text;
  frame["dropped"] = output.dropped;
  frame["identical"] = output.image == output.input;
  frame["keypoints"] = output.keypoints ? output.keypoints->keypoints.size() : 0;
  if (output.field) report_field(*output.field, &frame);
  frame["milliseconds"] = {{"optical_flow", output.times.flow_ms},
                           {"blur_field", output.times.blur_field_ms},
                           {"validation", output.times.validation_ms},
                           {"noise", output.times.noise_ms},
                           {"deconvolution", output.times.deconvolution_ms},
                           {"keypoints", output.times.keypoints_ms},
                           {"global_shutter", output.times.global_shutter_ms},
                           {"tracks", output.tracks_ms},
                           {"messages", output.messages_ms},
                           {"total", output.total_ms}};
  return frame;
}

}  // namespace

void FrameWriter::write(const FrameOutput& frame) {
  const ros::Time time = record_times_.front();
  record_times_.pop_front();
  for_each_output([&](const char* name, auto, auto message) {
    if (frame.*message) bag_.write(name_space_ + "/" + name, time, *(frame.*message));
  });
  processing_ms_ += frame.total_ms;
  if (report_.wanted()) report_.add(report_of(frame));
}

}  // namespace gyro_deblur
