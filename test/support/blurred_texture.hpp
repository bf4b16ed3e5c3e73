// A texture of sinusoids, seen through an affine map and blurred along a path: exact at every pixel.
#pragma once

#include <cmath>
#include <complex>
#include <cstdint>
#include <vector>

#include <Eigen/Dense>
#include <opencv2/core.hpp>

#include "features/blur_alignment.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "paths_2d.hpp"

namespace gyro_deblur::test {

/// The same power in each octave of frequency, as photographs have it.
class SinusoidTexture {
 public:
  SinusoidTexture(int waves, std::uint64_t seed) {
    constexpr double kLowest = 0.01, kHighest = 0.3;  // cycles/px: nothing that pixels could not sample
    cv::RNG rng(seed);
    for (int i = 0; i < waves; ++i) {
      const double frequency = kLowest * std::pow(kHighest / kLowest, rng.uniform(0.0, 1.0)),
                   angle_rad = rng.uniform(0.0, CV_PI);
      waves_.push_back(
          {frequency * Eigen::Vector2d(std::cos(angle_rad), std::sin(angle_rad)), rng.uniform(0.0, 2 * CV_PI)});
    }
  }

  /// A camera for which the texture's point u is at map * u + shift_px, blurred along the path.
  struct View {
    Eigen::Matrix2d map = Eigen::Matrix2d::Identity();
    Eigen::Vector2d shift_px = Eigen::Vector2d::Zero();
    Path2d path_px = still_path();
    Eigen::Vector2d at(const Eigen::Vector2d& texture_px) const { return map * texture_px + shift_px; }
  };

  /// @param contrast  standard deviation of the texture, not blurred [grey levels]
  /// @return CV_64FC1, mean 128
  cv::Mat seen_by(const View& view, cv::Size size, double contrast) const {
    const auto count = static_cast<Eigen::Index>(waves_.size());
    Eigen::MatrixXd cos_x(count, size.width), sin_x(count, size.width), cos_y(size.height, count),
        sin_y(size.height, count);
    const double amplitude = contrast * std::sqrt(2.0 / static_cast<double>(waves_.size()));
    for (Eigen::Index i = 0; i < count; ++i) {
      const Wave& wave = waves_[static_cast<std::size_t>(i)];
      const Eigen::Vector2d frequency = view.map.inverse().transpose() * wave.frequency;
      const std::complex<double> transfer = transfer_at(view.path_px, frequency.x(), frequency.y());
      const double phase_rad = wave.phase_rad - 2 * CV_PI * frequency.dot(view.shift_px) + std::arg(transfer);
      for (int x = 0; x < size.width; ++x) {
        cos_x(i, x) = std::cos(2 * CV_PI * frequency.x() * x);
        sin_x(i, x) = std::sin(2 * CV_PI * frequency.x() * x);
      }
      for (int y = 0; y < size.height; ++y) {
        cos_y(y, i) = amplitude * std::abs(transfer) * std::cos(2 * CV_PI * frequency.y() * y + phase_rad);
        sin_y(y, i) = amplitude * std::abs(transfer) * std::sin(2 * CV_PI * frequency.y() * y + phase_rad);
      }
    }
    cv::Mat image(size, CV_64FC1);
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>> pixels(image.ptr<double>(),
                                                                                              size.height, size.width);
    pixels = (cos_y * cos_x - sin_y * sin_x).array() + 128;
    return image;
  }

 private:
  struct Wave {
    Eigen::Vector2d frequency;  // cycles/px of the texture
    double phase_rad;
  };
  std::vector<Wave> waves_;
};

}  // namespace gyro_deblur::test
