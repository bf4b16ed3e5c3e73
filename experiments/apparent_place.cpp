#include "apparent_place.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <memory>
#include <numeric>

#include <Eigen/Core>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "base/median.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "sim/texture.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr int kWidthPx = 640, kHeightPx = 448;

/// A point that runs along a line at a speed that changes evenly: uniform * t + change * t^2, t from -1/2 to 1/2.
struct AcceleratedPath {
  double angle_rad, uniform_px, change_px;

  double along_px(double t) const { return uniform_px * t + change_px * t * t; }
  std::array<Eigen::Vector2d, kPathInstants> places_px() const {
    std::array<Eigen::Vector2d, kPathInstants> places;
    for (int k = 0; k < kPathInstants; ++k) {
      places[k] = along_px(k / (kPathInstants - 1.0) - 0.5) * Eigen::Vector2d(std::cos(angle_rad), std::sin(angle_rad));
    }
    return places;
  }
};

/// To sub-pixel accuracy, with noise of 2 grey levels.
cv::Mat blurred(const cv::Mat& sharp, const AcceleratedPath& path) {
  // The transfer function, tabulated up to the highest frequency along any line.
  constexpr int kSteps = 200, kEntries = 8192;
  const double step = std::sqrt(0.5) / (kEntries - 2);
  std::vector<std::complex<double>> table(kEntries, 0);
  for (int e = 0; e < kEntries; ++e) {
    for (int k = 0; k < kSteps; ++k) {
      table[e] += std::polar(1.0 / kSteps, -2 * CV_PI * e * step * path.along_px((k + 0.5) / kSteps - 0.5));
    }
  }
  cv::Mat image =
      test::filter_along_line(sharp, path.angle_rad, path.uniform_px + std::abs(path.change_px), [&](double f) {
        const double entry = std::min(std::abs(f) / step, kEntries - 2.0);
        const auto below = static_cast<std::size_t>(entry);
        const double part = entry - static_cast<double>(below);
        const std::complex<double> value = (1 - part) * table[below] + part * table[below + 1];
        return f < 0 ? std::conj(value) : value;
      });
  cv::Mat noise(image.size(), CV_64F);
  cv::RNG rng(7);
  rng.fill(noise, cv::RNG::NORMAL, 0, 2);
  image += noise;
  image.convertTo(image, CV_8U);
  return image;
}

/// Median shift of corners along the line [px].
double shift_px(const cv::Mat& sharp, const cv::Mat& shown, double angle_rad, double reach_px) {
  constexpr int kCorners = 400;
  constexpr double kQuality = 0.01, kDistancePx = 8;
  const cv::Size window(21, 21);
  const int border = static_cast<int>(2.5 * reach_px) + 16;
  cv::Mat mask = cv::Mat::zeros(sharp.size(), CV_8U);
  mask(cv::Rect(border, border, sharp.cols - 2 * border, sharp.rows - 2 * border)) = 1;
  std::vector<cv::Point2f> corners, found;
  std::vector<uchar> status;
  std::vector<float> error;
  cv::goodFeaturesToTrack(sharp, corners, kCorners, kQuality, kDistancePx, mask);
  cv::calcOpticalFlowPyrLK(sharp, shown, corners, found, status, error, window, 1);
  std::vector<double> shifts_px;
  for (std::size_t k = 0; k < corners.size(); ++k) {
    const cv::Point2f d = found[k] - corners[k];
    if (status[k]) shifts_px.push_back(d.x * std::cos(angle_rad) + d.y * std::sin(angle_rad));
  }
  return median(shifts_px);
}

}  // namespace

std::vector<ApparentPlace> apparent_places(int images) {
  constexpr std::array<double, 6> kExtentsPx = {10, 20, 30, 40, 50, 60};
  constexpr std::array<double, 4> kShares = {-0.95, -0.5, 0.5, 0.95};  // of the limit of evenness
  const BlurFieldOptions options;
  const FilterBank bank{FilterOptions{}};
  const std::unique_ptr<Engine> engine = make_engine("auto");
  std::vector<ApparentPlace> places;
  for (int i = 0; i < images; ++i) {
    cv::Mat sharp;
    cv::cvtColor(sim::procedural_texture(kWidthPx, kHeightPx, 100 + static_cast<std::uint64_t>(i)), sharp,
                 cv::COLOR_BGR2GRAY);
    for (const double extent_px : kExtentsPx) {
      for (const double share : kShares) {
        // A parabola departs from its chord by a quarter of the change, half of it to either side of the best shift.
        const AcceleratedPath path{0.3 + 1.1 * i, extent_px, 8 * share * even_path_px(extent_px)};
        const BlockBlur blur = classify_path(path.places_px(), options);
        FrameBlur field;
        field.grid = BlockGrid(kWidthPx, kHeightPx, options.block_size_px);
        field.blocks.assign(field.grid.size(), blur);
        cv::Mat deblurred;
        deconvolve(blurred(sharp, path), PixelLayout::GRAY, field, bank, *engine, deblurred);
        const Eigen::Vector2d line(std::cos(path.angle_rad), std::sin(path.angle_rad));
        places.push_back({extent_px, line.dot(blur.chord_middle_px.cast<double>()),
                          line.dot(blur.mean_place_px.cast<double>()), line.dot(blur.apparent_offset_px()),
                          shift_px(sharp, deblurred, path.angle_rad, extent_px)});
      }
    }
  }
  return places;
}

double slope(const std::vector<double>& x, const std::vector<double>& y) {
  return std::inner_product(x.begin(), x.end(), y.begin(), 0.0) /
         std::inner_product(x.begin(), x.end(), x.begin(), 0.0);
}

}  // namespace gyro_deblur::experiments
