// Curved paths, the blur that they make, and the gain of their inverse.
#pragma once

#include <cmath>
#include <complex>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "blur/path_2d.hpp"
#include "inverse/wiener_inverse_2d.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::test {

/// An even run along a parabola, `extent_px` from end to end and `sagitta_px` high, its chord at angle_rad.
inline Path2d arc_path(double extent_px, double sagitta_px, double angle_rad) {
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const double s = 2.0 * k / (kPathInstants - 1) - 1, along = 0.5 * extent_px * s, across = -sagitta_px * s * s;
    path_px[k] = Eigen::Vector2d(along * std::cos(angle_rad) - across * std::sin(angle_rad),
                                 along * std::sin(angle_rad) + across * std::cos(angle_rad))
                     .cast<float>();
  }
  return path_px;
}

/// Transfer function of the blur at (fx, fy) cycles/px.
inline std::complex<double> transfer_at(const Path2d& path_px, double fx, double fy) {
  std::complex<double> sum = 0;
  for (int k = 0; k + 1 < kPathInstants; ++k) {
    const Eigen::Vector2d from = path_px[k].cast<double>(), to = path_px[k + 1].cast<double>(), f(fx, fy);
    sum += std::polar(sinc(CV_PI * f.dot(to - from)), -CV_PI * f.dot(to + from));
  }
  return sum / (kPathInstants - 1.0);
}

/// u cycles in `size` px, 0 <= u < size [cycles/px].
inline double frequency_of(int u, int size) { return static_cast<double>(u < size / 2 ? u : u - size) / size; }

/// The same at u cycles across and v down in `size` px, 0 <= u, v < size.
inline std::complex<double> transfer_at(const Path2d& path_px, int u, int v, cv::Size size) {
  return transfer_at(path_px, frequency_of(u, size.width), frequency_of(v, size.height));
}

/// The blur of a point that runs along the path, to sub-pixel accuracy; see filter_in_2d.
inline cv::Mat blur_in_2d(const cv::Mat& image, const Path2d& path_px) {
  return filter_in_2d(image, 2.0 * extent_of(path_px).maxCoeff(),
                      [&](double fx, double fy) { return transfer_at(path_px, fx, fy); });
}

/// Gain of the inverse at u cycles across and v down in `size` px, 0 <= u, v < size.
inline std::complex<double> gain_at(const WienerInverse2d& inverse, int u, int v, cv::Size size) {
  if (u == size.width / 2 || v == size.height / 2) return 0;
  const double fx = frequency_of(u, size.width), fy = frequency_of(v, size.height);
  const std::complex<double> h = transfer_at(inverse.path_px, u, v, size);
  const double noise = inverse.noise_to_signal + inverse.noise_rise_px2 * (fx * fx + fy * fy);
  return (1.0 + inverse.noise_to_signal) * std::conj(h) / (std::norm(h) + noise);
}

}  // namespace gyro_deblur::test
