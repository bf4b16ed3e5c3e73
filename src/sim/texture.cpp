// Makes and samples the textures of the simulator.
#include "sim/texture.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "base/require_range.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur::sim {
namespace {

constexpr double kLevelsPerOctave = 4;
constexpr int kMinSide = 16;  // [px]
// A little more than one texel a pixel, and a Gaussian: the image then has the softness of lens and pixel (transfer of
// about 0.2 at its Nyquist frequency), and bilinear sampling costs the same sharpness at every phase.
constexpr double kTexelsPerPixel = 1.4;
constexpr double kPrefilterSigmaTexels = 0.65;

double uniform(cv::RNG& rng, double low, double high) { return low + (high - low) * static_cast<double>(rng); }

cv::Scalar random_color(cv::RNG& rng) {
  // Colours scatter around a common grey, as in photographs.
  constexpr double kChroma = 35;
  const double grey = uniform(rng, 8, 247);
  cv::Scalar color;
  for (int c = 0; c < 3; ++c) color[c] = std::clamp(grey + uniform(rng, -kChroma, kChroma), 0.0, 255.0);
  return color;
}

}  // namespace

Texture::Texture(const cv::Mat& base) : base_(base) {
  require_range("texture width", base.cols, kMinSide, 32766, "px");
  require_range("texture height", base.rows, kMinSide, 32766, "px");
  if (base.type() != CV_8UC1 && base.type() != CV_8UC3) throw OptionError("texture must be CV_8UC1 or CV_8UC3");
  const double smallest = static_cast<double>(kMinSide) / std::min(base.cols, base.rows);
  last_level_ = static_cast<int>(-std::log2(smallest) * kLevelsPerOctave);
}

int Texture::level_for(double texels_per_pixel) const {
  const double level = std::floor(kLevelsPerOctave * std::log2(texels_per_pixel / kTexelsPerPixel));
  return static_cast<int>(std::clamp(level, 0.0, static_cast<double>(last_level_)));
}

const cv::Mat& Texture::level(int index) {
  const auto found = levels_.find(index);
  if (found != levels_.end()) return found->second;
  const double scale = std::exp2(-index / kLevelsPerOctave);
  cv::Mat image;
  base_.convertTo(image, CV_32F);
  if (index > 0) {
    const cv::Size size(static_cast<int>(std::lround(base_.cols * scale)),
                        static_cast<int>(std::lround(base_.rows * scale)));
    cv::resize(image, image, size, 0, 0, cv::INTER_AREA);
  }
  cv::GaussianBlur(image, image, cv::Size(), kPrefilterSigmaTexels, kPrefilterSigmaTexels, cv::BORDER_REPLICATE);
  return levels_.emplace(index, image).first->second;
}

cv::Mat load_texture(const std::string& path) {
  cv::Mat image = cv::imread(path, cv::IMREAD_COLOR);
  if (image.empty()) throw OptionError("texture " + path + " cannot be read as an image");
  return image;
}

cv::Mat procedural_texture(int width_px, int height_px, std::uint64_t seed) {
  constexpr double kSmallestRadius = 5;  // [px]
  constexpr double kCoverage = 2.5;      // mean number of leaves over a pixel
  constexpr double kTextShare = 0.12;    // of the leaves
  constexpr int kShift = 4;              // fractional bits of coordinates
  const double largest = 0.1 * std::max(width_px, height_px);
  // Mean area of a leaf with radius density ~ r^-3 on [smallest, largest].
  const double ratio = largest / kSmallestRadius;
  const double mean_area = 2 * M_PI * kSmallestRadius * kSmallestRadius * std::log(ratio) / (1 - 1 / (ratio * ratio));
  const int leaves = static_cast<int>(kCoverage * width_px * height_px / mean_area);

  cv::RNG rng(seed + 1);  // 0 would be a fixed point of the generator
  cv::Mat image(height_px, width_px, CV_8UC3, random_color(rng));
  const auto fixed = [](double v) { return static_cast<int>(std::lround(v * (1 << kShift))); };
  for (int i = 0; i < leaves; ++i) {
    const double q = uniform(rng, 1 / (ratio * ratio), 1);
    const double radius = kSmallestRadius / std::sqrt(q);
    // One after the other: in which order arguments are drawn is the compiler's choice.
    const double y = uniform(rng, -radius, height_px + radius), x = uniform(rng, -radius, width_px + radius);
    const cv::Point2d center(x, y);
    const cv::Scalar color = random_color(rng);
    if (uniform(rng, 0, 1) < kTextShare && radius < 0.2 * largest) {
      std::string text;
      for (int k = rng.uniform(1, 6); k > 0; --k) text += static_cast<char>(rng.uniform('0', 'Z' + 1));
      const cv::Point origin(static_cast<int>(center.x), static_cast<int>(center.y));
      cv::putText(image, text, origin, cv::FONT_HERSHEY_SIMPLEX, radius / 12, color,
                  std::max(1, static_cast<int>(radius / 5)), cv::LINE_AA);
      continue;
    }
    if (rng.uniform(0, 3) == 0) {
      cv::circle(image, {fixed(center.x), fixed(center.y)}, fixed(radius), color, cv::FILLED, cv::LINE_AA, kShift);
      continue;
    }
    const int corners = rng.uniform(3, 7);
    const double start = uniform(rng, 0, 2 * M_PI);
    std::vector<cv::Point> polygon;
    for (int k = 0; k < corners; ++k) {
      const double angle = start + 2 * M_PI * (k + uniform(rng, -0.3, 0.3)) / corners,
                   r = radius * uniform(rng, 0.7, 1.3);
      polygon.emplace_back(fixed(center.x + r * std::cos(angle)), fixed(center.y + r * std::sin(angle)));
    }
    cv::fillPoly(image, std::vector<std::vector<cv::Point>>{polygon}, color, cv::LINE_AA, kShift);
  }
  return image;
}

}  // namespace gyro_deblur::sim
