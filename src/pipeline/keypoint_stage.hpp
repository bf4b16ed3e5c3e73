// The stage that finds keypoints, moves them to the reference time, and says how certain they are.
#pragma once

#include <memory>
#include <optional>

#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "pipeline/frame_context.hpp"

namespace gyro_deblur {

/// Keypoints of one camera's images. Not thread-safe.
class KeypointStage {
 public:
  /// Not checked before keypoints are asked for.
  void set_options(KeypointOptions options) noexcept;

  /// Fills features, points and covariances of the frame's result.
  /// @param luminance  deblurred
  void find(const cv::Mat& luminance, const FrameCamera& camera, FrameContext& frame);

  /// The same for an image whose motion is not known: see Pipeline::detect().
  /// @param mask  empty, or of the image's size
  void find_unrectified(const cv::Mat& luminance, const PixelMask& mask, const std::optional<Camera>& camera,
                        PipelineResult* result);

 private:
  /// Fills features, or keypoints_text.
  void extract(const cv::Mat& luminance, const PixelMask& mask, PipelineResult* result);

  KeypointOptions options_;
  std::unique_ptr<FeatureExtractor> extractor_;  // made when keypoints are asked for
};

}  // namespace gyro_deblur
