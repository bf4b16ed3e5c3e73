// What is wanted of a frame, its output, and the topics of that.
#pragma once

#include <optional>
#include <string>

#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud.h>
#include <visualization_msgs/MarkerArray.h>

#include "blur/exposure_advice.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "pipeline/exposure_choice.hpp"
#include "ros/messages.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {

/// What somebody wants of a frame; nothing else is computed. Processor sets what depends on the frame.
struct FrameRequest : PipelineRequest {
  bool overlay = false;
  bool markers = false;
  bool tracks = false;
  bool global_shutter_tracks = false;
  bool trust_mask = false;

  bool wants_tracks() const { return tracks || global_shutter_tracks; }
};

/// The exposure time that a frame was deblurred by.
struct FrameExposure : ChosenExposure {
  ExposureNeed need = ExposureNeed::NOTHING;  ///< what the images lack for it, where it is not known
};

/// The output of a frame: one for every frame that came in, in the same order. Its residual_rotation is in axes of the
/// IMU.
struct FrameOutput : FrameFindings {
  sensor_msgs::ImageConstPtr input;
  /// It is not published: image, keypoints, both tracks, global_shutter and both camera_infos are null. What is said of
  /// it is there.
  bool dropped = false;
  sensor_msgs::ImageConstPtr image;             ///< the very input message when no pixel was changed
  sensor_msgs::CameraInfoConstPtr camera_info;  ///< the input's; one that is not calibrated when there was none
  BlurFieldPtr blur_field;
  ImageQualityPtr quality;
  sensor_msgs::ImagePtr trust_mask;            ///< null when not requested
  KeypointArrayPtr keypoints;                  ///< null when not requested
  sensor_msgs::ImagePtr overlay;               ///< null when not requested, or without a blur field
  visualization_msgs::MarkerArrayPtr markers;  ///< null when not requested
  sensor_msgs::PointCloudPtr tracks;           ///< null when not requested, or when the pipeline did not run
  /// With all rows, and the stamp, at the reference time; the very input message and camera_info where the motion is
  /// not known, and for a frame that passes through. Null when not requested, and for a frame whose stamp would not
  /// come after that of the one before.
  sensor_msgs::ImageConstPtr global_shutter;
  sensor_msgs::CameraInfoConstPtr global_shutter_info;
  /// The tracks, and the stamp, at the reference time, apart from tracks whose motion is not known. Null as `tracks`,
  /// and where the exposure is not known or the stamp would not come after that of the one before.
  sensor_msgs::PointCloudPtr global_shutter_tracks;
  PassThroughReason reason = PassThroughReason::NONE;
  std::string reason_text;
  std::optional<FrameBlur> field;               ///< of the core; absent when the pipeline did not run
  std::optional<FrameExposure> exposure;        ///< absent when the pipeline did not run
  std::optional<ExposureTerms> exposure_terms;  ///< of the field, where they are known
  std::string engine_warning;                   ///< warning of the engine; mostly empty
  double tracks_ms = 0;                         ///< of following corners
  double waiting_ms = 0;                        ///< steady time in the queue
  double messages_ms = 0;                       ///< conversion from and to messages, overlay and markers
  double total_ms = 0;                          ///< of processing, without waiting
};

/// All topics that a frame is published on: nodelet and deblur_bag take theirs from here alone.
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
