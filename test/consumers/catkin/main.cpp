// The blur of an image as the core has it and as a message, in one file.
#include <iostream>

#include <gyro_deblur/BlurField.h>
#include <gyro_deblur/Exposure.h>
#include <gyro_deblur/KeypointArray.h>
#include <gyro_deblur/blur_field.hpp>
#include <gyro_deblur/frame_blur.hpp>
#include <gyro_deblur/pipeline.hpp>

#include "../synthetic_pan.hpp"

namespace {

gyro_deblur::BlurField message_of(const gyro_deblur::FrameBlur& blur) {
  gyro_deblur::BlurField message;
  message.cols = static_cast<std::uint32_t>(blur.grid.cols());
  message.rows = static_cast<std::uint32_t>(blur.grid.rows());
  for (const gyro_deblur::BlockBlur& block : blur.blocks) {
    message.angle.push_back(block.angle_rad);
    message.extent.push_back(block.extent_px);
    message.status.push_back(static_cast<std::uint8_t>(block.status));
  }
  return message;
}

}  // namespace

int main() {
  const SyntheticPan pan = deblur_synthetic_pan();
  const gyro_deblur::BlurField message = message_of(pan.result.field);
  std::size_t deblurred = 0;
  for (const std::uint8_t status : message.status) deblurred += status == gyro_deblur::BlurField::DEBLURRED;
  std::cout << "error blurred " << pan.error_of(pan.blurred) << ", deblurred " << pan.error_of(pan.result.image)
            << " grey levels; " << deblurred << " of " << message.status.size() << " blocks\n";
  const bool all_blocks = message.status.size() == std::size_t{message.cols} * message.rows;
  return pan.is_deblurred() && all_blocks && 2 * deblurred > message.status.size() ? 0 : 1;
}
