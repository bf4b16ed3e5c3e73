// Reads masks from image files.
#include "mask_file/mask_file.hpp"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <stdexcept>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "gyro_deblur/options.hpp"

namespace gyro_deblur {
namespace {

constexpr char kRemedy[] = "; give a PNG or PGM of the image's size, 0 where a pixel does not show the scene";

[[noreturn]] void refuse(const std::string& path, const std::string& problem) {
  throw OptionError("mask = " + path + " " + problem + kRemedy);
}

bool is_jpeg(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension == ".jpg" || extension == ".jpeg";
}

}  // namespace

PixelMask load_mask(const std::string& path) {
  if (!std::filesystem::is_regular_file(path)) refuse(path, "is no file");
  if (is_jpeg(path)) refuse(path, "is a JPEG, which does not keep zeros");
  cv::Mat image;
  try {
    image = cv::imread(path, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    // Sizes beyond OpenCV's limit; its message names neither file nor limit.
  }
  if (image.empty()) refuse(path, "is not an image that can be read");
  std::vector<cv::Mat> channels;
  cv::split(image, channels);
  const bool has_alpha = channels.size() == 2 || channels.size() == 4;
  if (has_alpha) channels.pop_back();
  cv::Mat used = channels.front() != 0;
  for (const cv::Mat& channel : channels) used |= channel != 0;
  if (cv::countNonZero(used) == 0) refuse(path, "has no pixel above 0: nothing of the image would be used");
  return PixelMask(used);
}

}  // namespace gyro_deblur
