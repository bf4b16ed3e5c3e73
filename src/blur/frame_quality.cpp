// Grades an image by the blur that remains in its blocks.
#include "blur/frame_quality.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <utility>
#include <vector>

namespace gyro_deblur {
namespace {

/// Extent [px] and pixels of a block.
using Weighed = std::pair<double, double>;

double weighed_quantile(std::vector<Weighed> extents, double share) {
  if (extents.empty()) return 0;
  std::sort(extents.begin(), extents.end());
  double sum = 0;
  for (const Weighed& extent : extents) sum += extent.second;
  double below = 0;
  for (const auto& [extent_px, pixels] : extents) {
    below += pixels;
    if (below >= share * sum) return extent_px;
  }
  return extents.back().first;
}

ExtentSpread spread_of(const std::vector<Weighed>& extents) {
  return {weighed_quantile(extents, 0.5), weighed_quantile(extents, 0.95)};
}

/// How far blur reaches from a pixel, to each side [px].
Eigen::Vector2d reach_of(const BlockBlur& block) {
  if (!block.curved_path_px) {
    return 0.5 * block.extent_px * Eigen::Vector2d(std::abs(std::cos(block.angle_rad)), std::sin(block.angle_rad));
  }
  Eigen::Vector2f least = block.curved_path_px->front(), most = least;
  for (const Eigen::Vector2f& place_px : *block.curved_path_px) {
    least = least.cwiseMin(place_px);
    most = most.cwiseMax(place_px);
  }
  return 0.5 * (most - least).cast<double>();
}

}  // namespace

const char* to_string(QualityGrade grade) {
  static constexpr const char* kNames[]{"SHARP", "DEBLURRED", "PARTLY_DEBLURRED", "POOR", "UNKNOWN"};
  const auto i = static_cast<std::size_t>(grade);
  return i < std::size(kNames) ? kNames[i] : "?";
}

std::optional<double> expected_repeatability(const BlockBlur& block, double noise_to_contrast) {
  if (!has_known_blur(block.status)) return std::nullopt;
  const double extent_px = block.extent_px;
  if (block.status == BlockStatus::DEBLURRED) {
    constexpr double kSharp = 0.79, kHalvedPx = 54, kByNoise = 1.36, kNoiseFromPx = 1.25;
    return kSharp / (1 + extent_px / kHalvedPx) *
           std::exp(-kByNoise * noise_to_contrast * std::log1p(extent_px / kNoiseFromPx));
  }
  constexpr double kSharp = 0.963, kHalvedPx = 5.93, kSteepness = 2.155, kByNoise = 2.05;
  return kSharp / (1 + std::pow(extent_px / kHalvedPx, kSteepness)) * std::exp(-kByNoise * noise_to_contrast);
}

double noise_to_contrast(const FrameBlur& field) {
  if (!field.noise || field.contrast <= 0) return 0;
  const double texture = std::sqrt(std::max(0.0, field.contrast * field.contrast - *field.noise * *field.noise));
  return *field.noise < texture ? *field.noise / texture : 1;
}

FrameQuality assess_quality(const FrameBlur& field) {
  FrameQuality quality;
  quality.noise = field.noise;
  quality.contrast = field.contrast;
  const double noise = noise_to_contrast(field);
  std::vector<Weighed> before, after;
  double known = 0, score = 0;
  const double pixels_of_all = static_cast<double>(field.grid.width_px()) * field.grid.height_px();
  for (int i = 0; i < static_cast<int>(field.blocks.size()); ++i) {
    const BlockBlur& block = field.blocks[static_cast<std::size_t>(i)];
    const double pixels = field.grid.rect(i).area();
    quality.shares[static_cast<std::size_t>(block.status)] += pixels / pixels_of_all;
    const std::optional<double> expected = expected_repeatability(block, noise);
    if (!expected) continue;
    known += pixels;
    score += pixels * *expected;
    before.emplace_back(block.extent_px, pixels);
    after.emplace_back(block.status == BlockStatus::DEBLURRED ? 0 : block.extent_px, pixels);
  }
  quality.before = spread_of(before);
  quality.after = spread_of(after);
  const double unmasked = 1 - quality.share(BlockStatus::MASKED);
  // Where most of an image is not known, the rest is no measure of it.
  if (2 * known <= unmasked * pixels_of_all) return quality;
  quality.score = score / known;
  constexpr double kNearlyAll = 0.9;  // ImageQuality.msg says so
  const double sharp = quality.share(BlockStatus::SHARP) / unmasked,
               deblurred = quality.share(BlockStatus::DEBLURRED) / unmasked;
  quality.grade = *quality.score < kPoorScore       ? QualityGrade::POOR
                  : sharp >= kNearlyAll             ? QualityGrade::SHARP
                  : sharp + deblurred >= kNearlyAll ? QualityGrade::DEBLURRED
                                                    : QualityGrade::PARTLY_DEBLURRED;
  return quality;
}

cv::Mat trust_mask(const FrameBlur& field, const PixelMask& mask_of_input) {
  constexpr int kTrusted = 255;
  cv::Mat mask = cv::Mat::zeros(field.grid.height_px(), field.grid.width_px(), CV_8UC1);
  for (int i = 0; i < static_cast<int>(field.blocks.size()); ++i) {
    const BlockBlur& block = field.blocks[static_cast<std::size_t>(i)];
    cv::Rect trusted = field.grid.rect(i);
    if (block.status == BlockStatus::DEBLURRED) {
      const Eigen::Vector2d reach_px = reach_of(block);
      const cv::Point inset(static_cast<int>(std::ceil(reach_px.x())), static_cast<int>(std::ceil(reach_px.y())));
      trusted &= cv::Rect(inset.x, inset.y, mask.cols - 2 * inset.x, mask.rows - 2 * inset.y);
    } else if (block.status != BlockStatus::SHARP) {
      continue;
    }
    mask(trusted) = kTrusted;
  }
  if (!mask_of_input.empty()) mask &= mask_of_input.pixels();
  return mask;
}

}  // namespace gyro_deblur
