// The published messages, from the core's types.
#pragma once

#include <string>
#include <vector>

#include <sensor_msgs/Image.h>
#include <sensor_msgs/PointCloud.h>
#include <std_msgs/Header.h>
#include <visualization_msgs/MarkerArray.h>

#include "blur/frame_quality.hpp"
#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/config.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "ros/messages.hpp"
#include "sync/pass_through.hpp"

namespace gyro_deblur {

BlurFieldPtr to_message(const FrameBlur& field, const std_msgs::Header& header);

/// Message of an image that was passed through unchanged.
BlurFieldPtr pass_through_message(PassThroughReason reason, const std::string& text, const sensor_msgs::Image& input);

ImageQualityPtr to_message(const FrameQuality& quality, const std_msgs::Header& header);

/// Quality of an image of whose blur nothing is known.
ImageQualityPtr unknown_quality(const std_msgs::Header& header);

KeypointArrayPtr to_message(const PipelineResult& result, const KeypointOptions& options,
                            const std_msgs::Header& header);

/// Corners as an estimator takes them: one point (x, y, 1) each on the undistorted plane z = 1 of the camera, and the
/// channels that it reads, in its order: for VINS-Mono id_of_point, u_of_point, v_of_point [px], velocity_x_of_point,
/// velocity_y_of_point [1/s], for VINS-Fusion doc/guides/slam.md#vins-fusion. Behind these are covariance_uu_of_point,
/// covariance_uv_of_point and covariance_vv_of_point [px^2] of the pixel, against the scene point on which the track
/// began. Corners that were seen for the first time, which have no velocity yet, are left out, as their own trackers
/// do.
sensor_msgs::PointCloudPtr to_message(const std::vector<Track>& tracks, TrackLayout layout,
                                      const std_msgs::Header& header);

/// The blur paths as lines at a depth of 1 m in the camera's frame, in the colours of the overlay; short ones for
/// blocks whose path would cover another's. In a colour of its own, what the images add to a block's motion; a tick
/// where the path is not drawn. One marker with a fixed namespace and id, so that each image's replaces the one before.
visualization_msgs::MarkerArrayPtr to_markers(const FrameBlur& field, const Camera& camera,
                                              const std_msgs::Header& header);

/// Takes the markers of the image before away.
visualization_msgs::MarkerArrayPtr no_markers(const std_msgs::Header& header);

}  // namespace gyro_deblur
