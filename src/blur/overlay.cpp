// Draws the blur field.
#include "gyro_deblur/overlay.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "base/format.hpp"
#include "base/median.hpp"
#include "blur/frame_quality.hpp"

namespace gyro_deblur {
namespace {

cv::Scalar color_bgr(const cv::Vec3b& rgb) {
  return {static_cast<double>(rgb[2]), static_cast<double>(rgb[1]), static_cast<double>(rgb[0])};
}

cv::Scalar color_bgr(BlockStatus status) { return color_bgr(status_color_rgb(status)); }

/// Fractional bits of the coordinates that the drawing functions take.
constexpr int kShift = 4;

cv::Point fixed_point(const Eigen::Vector2d& p) {
  // Far beyond any image, yet small enough for the drawing functions' integers.
  const Eigen::Vector2d scaled = (p * (1 << kShift)).cwiseMax(-1e6).cwiseMin(1e6);
  return {static_cast<int>(std::lround(scaled.x())), static_cast<int>(std::lround(scaled.y()))};
}

/// Number of blocks with a residual velocity, and the median displacement by it within the exposure.
std::string residual_text(const FrameBlur& field) {
  std::vector<double> lengths_px;
  for (int i = 0; i < field.grid.size(); ++i) {
    if (const auto segment = residual_segment(field, i)) {
      lengths_px.push_back((segment->to_px - segment->from_px).norm());
    }
  }
  if (lengths_px.empty()) return {};
  return format("%zu with %.1f px from images", lengths_px.size(), median(lengths_px));
}

struct LegendLine {
  std::string text;
  cv::Scalar color;
};

/// What became of a block, in words that need no manual, and its colour.
struct StatusLook {
  const char* fate;
  cv::Vec3b rgb;
};

const StatusLook& look_of(BlockStatus status) {
  static const StatusLook kLooks[]{{"sharp, unchanged", {200, 200, 200}},   {"deblurred", {60, 230, 60}},
                                   {"do not fit the image", {255, 60, 60}}, {"blurred too far", {255, 80, 255}},
                                   {"without gyroscope", {255, 230, 0}},    {"blurred along a curve", {70, 200, 255}},
                                   {"too noisy to gain", {140, 110, 255}},  {"masked", {90, 90, 90}},
                                   {"at a static edge", {255, 140, 130}},   {"", {255, 255, 255}}};
  static_assert(std::size(kLooks) == kBlockStatuses.size() + 1, "the last is that of a value beyond the enumeration");
  return kLooks[std::min(static_cast<std::size_t>(status), kBlockStatuses.size())];
}

/// Length of the scale bar [px].
constexpr int kScaleBarPx = 50;

/// Squared distance of a point from a segment.
double distance2(const Eigen::Vector2d& p, const BlurSegment& s) {
  const Eigen::Vector2d along = s.to_px - s.from_px;
  const double length2 = along.squaredNorm();
  const double t = length2 > 0 ? std::clamp(along.dot(p - s.from_px) / length2, 0.0, 1.0) : 0;
  return (s.from_px + t * along - p).squaredNorm();
}

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

bool come_near(const BlurSegment& a, const BlurSegment& b, double gap_px) {
  const double gap2 = gap_px * gap_px;
  if (distance2(a.from_px, b) < gap2 || distance2(a.to_px, b) < gap2 || distance2(b.from_px, a) < gap2 ||
      distance2(b.to_px, a) < gap2) {
    return true;
  }
  // Apart from that segments are only near where they cross.
  const auto side = [](const BlurSegment& s, const Eigen::Vector2d& p) {
    return cross(s.to_px - s.from_px, p - s.from_px);
  };
  return side(a, b.from_px) * side(a, b.to_px) < 0 && side(b, a.from_px) * side(b, a.to_px) < 0;
}

void draw_legend(cv::Mat& image, const FrameBlur& field, int paths, double scale) {
  std::vector<LegendLine> lines;
  const auto deblurred = [](BlockStatus status) { return status == BlockStatus::DEBLURRED; };
  lines.push_back({format("median blur %.1f px", median_extent_px(field, deblurred)), cv::Scalar::all(255)});
  for (const BlockStatus status : kBlockStatuses) {
    const std::size_t count = field.count(status);
    if (count > 0) lines.push_back({std::to_string(count) + " " + look_of(status).fate, color_bgr(status)});
  }
  const std::string from_images = residual_text(field);
  if (!from_images.empty()) lines.push_back({from_images, color_bgr(residual_color_rgb())});
  if (paths < field.grid.size()) {
    const std::string drawn = "paths of " + std::to_string(paths) + " of " + std::to_string(field.grid.size());
    lines.push_back({drawn, cv::Scalar::all(255)});
  }

  const int font = cv::FONT_HERSHEY_SIMPLEX;
  const double font_scale = 0.5 * scale;
  const int thickness = std::max(1, static_cast<int>(std::lround(scale)));
  const int margin_px = std::max(2, static_cast<int>(std::lround(6 * scale)));
  int width_px = 0, line_px = 0;
  for (const LegendLine& line : lines) {
    int baseline_px = 0;
    const cv::Size size = cv::getTextSize(line.text, font, font_scale, thickness, &baseline_px);
    width_px = std::max(width_px, size.width);
    line_px = std::max(line_px, size.height + baseline_px + 1);
  }
  const std::string bar_text = std::to_string(kScaleBarPx) + " px";
  width_px = std::max(width_px,
                      kScaleBarPx + margin_px + cv::getTextSize(bar_text, font, font_scale, thickness, nullptr).width);
  const int rows = static_cast<int>(lines.size()) + 1;  // the scale bar is the last
  const cv::Rect box(0, 0, width_px + 2 * margin_px, line_px * rows + margin_px);
  if (box.width > image.cols || box.height > image.rows) return;  // would hide the image
  image(box) *= 0.3;
  int baseline_y_px = 0;
  for (const LegendLine& line : lines) {
    baseline_y_px += line_px;
    cv::putText(image, line.text, {margin_px, baseline_y_px}, font, font_scale, line.color, thickness, cv::LINE_AA);
  }
  baseline_y_px += line_px;
  const cv::Scalar white = cv::Scalar::all(255);
  const int bar_y_px = baseline_y_px - line_px / 4, tick_px = line_px / 4;
  cv::line(image, {margin_px, bar_y_px}, {margin_px + kScaleBarPx, bar_y_px}, white, 2 * thickness);
  for (const int x_px : {margin_px, margin_px + kScaleBarPx}) {
    cv::line(image, {x_px, bar_y_px - tick_px}, {x_px, bar_y_px + tick_px}, white, 2 * thickness);
  }
  cv::putText(image, bar_text, {2 * margin_px + kScaleBarPx, baseline_y_px}, font, font_scale, white, thickness,
              cv::LINE_AA);
}

}  // namespace

cv::Vec3b status_color_rgb(BlockStatus status) { return look_of(status).rgb; }

BlurSegment blur_segment(const FrameBlur& field, int index) {
  const BlockBlur& blur = field.blocks.at(index);
  const Eigen::Vector2d center_px = field.grid.center(index);
  const Eigen::Vector2d half_px =
      0.5 * blur.extent_px * Eigen::Vector2d(std::cos(blur.angle_rad), std::sin(blur.angle_rad));
  return {center_px - half_px, center_px + half_px};
}

cv::Vec3b residual_color_rgb() { return {255, 150, 0}; }

std::optional<BlurSegment> residual_segment(const FrameBlur& field, int index) {
  const BlockBlur& blur = field.blocks.at(index);
  if (!blur.residual) return std::nullopt;
  const Eigen::Vector2d center_px = field.grid.center(index);
  return BlurSegment{center_px, center_px + to_seconds(field.exposure_ns) * blur.residual->velocity_px_s};
}

std::vector<char> paths_apart(const FrameBlur& field, double gap_px) {
  std::vector<char> chosen(field.blocks.size(), 0);
  std::vector<std::pair<int, BlurSegment>> paths;
  for (int i = 0; i < field.grid.size(); ++i) {
    const BlurSegment own = blur_segment(field, i);
    const bool apart = std::none_of(paths.begin(), paths.end(), [&](const auto& other) {
      const double reach_px = 0.5 * (field.blocks[i].extent_px + field.blocks[other.first].extent_px) + gap_px;
      const double between_px = (field.grid.center(i) - field.grid.center(other.first)).norm();
      return between_px < reach_px && come_near(own, other.second, gap_px);
    });
    if (!apart) continue;
    chosen[i] = 1;
    paths.emplace_back(i, own);
  }
  return chosen;
}

cv::Mat draw_overlay(const cv::Mat& luminance, const FrameBlur& field) {
  field.grid.require_luminance(luminance, "the overlay");
  cv::Mat image;
  cv::cvtColor(luminance, image, cv::COLOR_GRAY2BGR);
  // 1 at VGA height, so that lines and text keep their share of the picture.
  const double scale = std::max(1.0, std::min(luminance.cols, luminance.rows) / 480.0);
  const int thickness = std::max(1, static_cast<int>(std::lround(scale)));
  constexpr double kGapPx = 8;  // at VGA
  const std::vector<char> has_path = paths_apart(field, kGapPx * scale);
  const auto draw_segment = [&](const BlurSegment& segment, const cv::Scalar& color, int extra_px) {
    cv::line(image, fixed_point(segment.from_px), fixed_point(segment.to_px), color, thickness + extra_px, cv::LINE_AA,
             kShift);
  };
  const auto draw_dot = [&](int index, const cv::Scalar& color, int extra_px) {
    cv::circle(image, fixed_point(field.grid.center(index)),
               static_cast<int>(std::lround((1.5 * thickness + 0.5 * extra_px) * (1 << kShift))), color, cv::FILLED,
               cv::LINE_AA, kShift);
  };
  const auto draw_ring = [&](int index, const cv::Scalar& color, int extra_px) {
    cv::circle(image, fixed_point(field.grid.center(index)), (5 * thickness) << kShift, color, thickness + extra_px,
               cv::LINE_AA, kShift);
  };
  const cv::Scalar residual_color = color_bgr(residual_color_rgb());
  // A dark rim first keeps the colours legible on bright ground; later blocks must not be rimmed over earlier ones.
  constexpr int kRimPx = 2;
  for (const int rim_px : {kRimPx, 0}) {
    for (int i = 0; i < field.grid.size(); ++i) {
      const cv::Scalar color = rim_px > 0 ? cv::Scalar::all(0) : color_bgr(field.blocks[i].status);
      const cv::Scalar of_images = rim_px > 0 ? color : residual_color;
      const std::optional<BlurSegment> residual = residual_segment(field, i);
      // From below to above, so that a short path is seen on the ring, and a residual along the path on that.
      if (residual) draw_ring(i, of_images, rim_px);
      if (has_path[i]) draw_segment(blur_segment(field, i), color, rim_px);
      if (residual && has_path[i]) draw_segment(*residual, of_images, rim_px);
      draw_dot(i, color, rim_px);
    }
  }
  draw_legend(image, field, static_cast<int>(std::count(has_path.begin(), has_path.end(), 1)), scale);
  return image;
}

}  // namespace gyro_deblur
