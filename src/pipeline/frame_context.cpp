// Luminance and motion of the image in progress.
#include "pipeline/frame_context.hpp"

namespace gyro_deblur {

const cv::Mat& FrameContext::luminance() {
  if (luminance_.empty()) luminance_ = luminance8(image, layout, result.significant_bits);
  return luminance_;
}

bool FrameContext::has_own_luminance() const {
  return is_yuv422(layout) || (layout == PixelLayout::GRAY && image.depth() == CV_8U);
}

const CameraMotion& FrameContext::known_motion() const {
  if (images_alone) return stationary_;
  return motion;
}

}  // namespace gyro_deblur
