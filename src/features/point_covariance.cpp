// Covariance of a keypoint, from noise, structure and the uncertainty of its motion.
#include "features/point_covariance.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include <Eigen/Dense>

namespace gyro_deblur {
namespace {

/// Whole grey levels are all that 8 bits have.
constexpr double kRoundingVariance = 1.0 / 12;

/// Sum over a window of the outer products of central differences [grey levels^2], and of how many.
struct GradientSum {
  std::int64_t xx = 0, xy = 0, yy = 0, count = 0;
};

/// @param steps    samples to either side of the middle
/// @param step_px  between two samples, and from a sample to the pixels of its differences
GradientSum sum_gradients(const cv::Mat& image, const cv::Point& middle, int steps, int step_px) {
  // Samples outside the image do not count.
  const auto first = [&](int at) { return -std::min(steps, (at - step_px) / step_px); };
  const auto last = [&](int at, int length) { return std::min(steps, (length - 1 - step_px - at) / step_px); };
  GradientSum sum;
  const int first_x = first(middle.x), last_x = last(middle.x, image.cols);
  for (int j = first(middle.y); j <= last(middle.y, image.rows); ++j) {
    const int y = middle.y + j * step_px;
    const uchar *above = image.ptr(y - step_px) + middle.x, *row = image.ptr(y) + middle.x,
                *below = image.ptr(y + step_px) + middle.x;
    std::int32_t xx = 0, xy = 0, yy = 0;
    for (int i = first_x; i <= last_x; ++i) {
      const int x = i * step_px;
      const std::int32_t gx = row[x + step_px] - row[x - step_px], gy = below[x] - above[x];
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
    sum.xx += xx, sum.xy += xy, sum.yy += yy;
    sum.count += std::max(0, last_x - first_x + 1);
  }
  return sum;
}

/// Gradients of an image's window times themselves, without those of noise [grey levels^2].
Eigen::Matrix2d texture_of(const cv::Mat& image, const Eigen::Vector2d& pixel_px, double radius_px, double variance) {
  // Large patches belong to coarse features, which coarse differences show.
  constexpr double kMostSteps = 6;
  const int step_px = std::max(1, static_cast<int>(std::ceil(radius_px / kMostSteps)));
  const int steps = static_cast<int>(radius_px / step_px);
  if (image.cols <= 2 * step_px || image.rows <= 2 * step_px) return Eigen::Matrix2d::Zero();
  const auto inside = [step_px](double place_px, int length) {
    return static_cast<int>(std::clamp(std::round(place_px), step_px * 1.0, length - 1.0 - step_px));
  };
  const GradientSum sum =
      sum_gradients(image, {inside(pixel_px.x(), image.cols), inside(pixel_px.y(), image.rows)}, steps, step_px);
  // A difference spans 2 step_px; a sample stands for step_px^2 pixels. The difference of two pixels has twice the
  // variance of one.
  Eigen::Matrix2d products;
  products << static_cast<double>(sum.xx), static_cast<double>(sum.xy), static_cast<double>(sum.xy),
      static_cast<double>(sum.yy);
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> parts(products);
  const double of_noise = 2 * variance * static_cast<double>(sum.count);
  const Eigen::Vector2d left = (parts.eigenvalues().array() - of_noise).max(0.0) / 4;
  return parts.eigenvectors() * left.asDiagonal() * parts.eigenvectors().transpose();
}

}  // namespace

const PointErrors kBlobErrors{3.0, 1, 0.038, 0.032, 0.144, 0.092, 3.2, 0.024, 0};
const PointErrors kCornerErrors{5.6, 2, 0.048, 0.045, 0.158, 0.118, 1.1, 0, 0.036};

PointCovariance::PointCovariance(const cv::Mat& luminance, const FrameBlur& field)
    : luminance_(luminance), field_(field) {
  field.grid.require_luminance(luminance, "keypoint covariance");
}

Eigen::Matrix2d PointCovariance::at(const Eigen::Vector2d& pixel_px, double radius_px,
                                    const PointErrors& errors) const {
  const BlockBlur& block = field_.blocks[static_cast<std::size_t>(field_.grid.index_at(pixel_px.x(), pixel_px.y()))];
  if (!field_.noise || !has_known_blur(block.status)) {
    return Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity()).asDiagonal();
  }
  const auto squared = [](double value) { return value * value; };
  const bool deblurred = block.status == BlockStatus::DEBLURRED;
  const double variance = std::max(squared(*field_.noise) * (deblurred ? block.noise_gain : 1), kRoundingVariance);
  const Eigen::Matrix2d identity = Eigen::Matrix2d::Identity();
  const Eigen::Matrix2d information =
      texture_of(luminance_, pixel_px, radius_px, variance) / (squared(errors.noise) * variance) +
      identity / squared(errors.unseen_px);
  Eigen::Matrix2d covariance = information.inverse();

  const double extent_px = block.extent_px;
  const double length_px = deblurred ? extent_px : squared(extent_px) / (extent_px + errors.from_px);
  const double along_px = length_px * (deblurred ? errors.deblurred_along : errors.blurred_along);
  const double across_px = length_px * (deblurred ? errors.deblurred_across : errors.blurred_across);
  const Eigen::Vector2d line(std::cos(block.angle_rad), std::sin(block.angle_rad));
  covariance += squared(across_px) * identity + (squared(along_px) - squared(across_px)) * line * line.transpose();
  covariance += covariance_of_moving(block, to_seconds(field_.exposure_ns));
  covariance += (squared(errors.least_px) + squared(errors.of_radius * radius_px)) * identity;
  covariance(1, 0) = covariance(0, 1);  // to the last bit
  return covariance;
}

Eigen::Matrix2d covariance_of_moving(const BlockBlur& block, double seconds) {
  const double stddev_px = block.residual ? block.residual->stddev_px_s * seconds : 0;
  return stddev_px * stddev_px * Eigen::Matrix2d::Identity();
}

}  // namespace gyro_deblur
