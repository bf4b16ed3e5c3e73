#include "scene.hpp"

#include <algorithm>
#include <string>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "synthetic_blur.hpp"

namespace gyro_deblur::benchmark {

BlurFieldOptions wide_options() {
  BlurFieldOptions options;
  options.min_extent_px = 1;
  options.max_extent_px = 500;
  return options;
}

std::vector<cv::Mat> natural_images() {
  std::vector<cv::Mat> images;
  for (const char* set : {"graf", "boat", "leuven", "bikes", "bark", "trees", "ubc", "wall"}) {
    const std::string path = std::string(GYRO_DEBLUR_DATA_DIR) + "/oxford_affine/" + set + "/img1.png";
    const cv::Mat image = cv::imread(path, cv::IMREAD_GRAYSCALE);
    if (!image.empty()) images.push_back(image);
  }
  if (images.empty()) images = {test::textured_image(800, 640, 1), test::textured_image(800, 640, 2)};
  return images;
}

cv::Mat extend(const cv::Mat& image, cv::Size size) {
  // Reflections keep the photograph's own sharpness, which scaling would not.
  cv::Mat tiled;
  cv::copyMakeBorder(image, tiled, 0, std::max(0, size.height - image.rows), 0, std::max(0, size.width - image.cols),
                     cv::BORDER_REFLECT_101);
  return tiled(cv::Rect({}, size)).clone();
}

}  // namespace gyro_deblur::benchmark
