// All topics that a frame is published on. Nodelet and deblur_bag take their topics from here alone.
#pragma once

#include "ros/processing.hpp"

namespace gyro_deblur {

/// Calls visit(name, request, message) for each output, an image before its camera_info.
/// name     topic, relative to the camera's namespace
/// request  member of FrameRequest that asks for the output; null: it is always made
/// message  member of FrameOutput that points to it; the pointer is null for a frame without this output
template <typename Visitor>
void for_each_output(Visitor&& visit) {
  constexpr bool FrameRequest::*kAlways = nullptr;
  visit("deblurred/image_raw", &FrameRequest::image, &FrameOutput::image);
  visit("deblurred/camera_info", &FrameRequest::image, &FrameOutput::camera_info);
  visit("keypoints", &FrameRequest::keypoints, &FrameOutput::keypoints);
  visit("blur_field", kAlways, &FrameOutput::blur_field);
  visit("image_quality", kAlways, &FrameOutput::quality);
  visit("trust_mask", &FrameRequest::trust_mask, &FrameOutput::trust_mask);
  visit("blur_overlay", &FrameRequest::overlay, &FrameOutput::overlay);
  visit("blur_markers", &FrameRequest::markers, &FrameOutput::markers);
  visit("feature_tracks", &FrameRequest::tracks, &FrameOutput::tracks);
  visit("global_shutter/image_raw", &FrameRequest::global_shutter, &FrameOutput::global_shutter);
  visit("global_shutter/camera_info", &FrameRequest::global_shutter, &FrameOutput::global_shutter_info);
  visit("global_shutter/feature_tracks", &FrameRequest::global_shutter_tracks, &FrameOutput::global_shutter_tracks);
}

}  // namespace gyro_deblur
