// A rolling-shutter image as a global shutter would have seen it (paper section III-C, for every pixel).
#pragma once

#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {

/// Where each pixel of the image at `reference_ns` is found in the image as it arrived: CV_32FC2 of the camera's size,
/// NaN where nothing is known. Agrees with rectify_points(): what that moves from q to p is found for p at q. Worked
/// out on a grid of 16 px, linear between (the error of that is below 0.02 px up to 5 rad/s and 20 ms of readout at a
/// focal length of 460 px).
/// @param field   of the whole image; residual velocities are interpolated between the centres of blocks, and are 0 for
///                those that have none
/// @param motion  blocks whose times to the reference it does not cover stay where they are
cv::Mat global_shutter_map(const FrameBlur& field, const Camera& camera, const CameraMotion& motion,
                           const RowExposure& exposure, TimeNs reference_ns);

/// The image resampled by the map, bilinearly; pixels without a place in it, and those from beyond its border, are 0.
/// @param image  any type that cv::remap takes; not a Bayer mosaic
cv::Mat to_global_shutter(const cv::Mat& image, const cv::Mat& map);

}  // namespace gyro_deblur
