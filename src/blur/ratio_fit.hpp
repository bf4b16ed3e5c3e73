// How well power spectra fit the blur of paths that are longer or shorter than assumed.
#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

#include "blur/motion_spectrum.hpp"

namespace gyro_deblur {

/// Fits spectra at one ratio of true to assumed path after the other. The model of the power at a frequency f is
///   exp(offset + slope x + curve x^2 + cube x^3) G^depth + noise, x = log f,
/// G the squared transfer function of the path times the ratio, smeared as the window does it. Slope, curve and cube
/// are common to all spectra, an offset is each one's own, and the depth of the zeros is common: they are fitted anew
/// for each ratio, from those of the ratio before. A power law in place of the polynomial lets low frequencies decide,
/// not the zeros.
class RatioFit {
 public:
  /// @param largest_ratio  of those to come
  RatioFit(const std::vector<MotionSpectrum>& spectra, double largest_ratio);

  /// Half of the sum of squared residuals over their variance, by window, at a ratio (0: no blur at all): a negative
  /// log likelihood.
  std::vector<double> costs(double ratio);

 private:
  static constexpr int kCommon = 4;  // slope, curve, cube, depth
  using Vector = Eigen::Matrix<float, kCommon, 1>;

  /// |H|^2 of a path by frequency, linear between its entries.
  class Transfer {
   public:
    Transfer(const std::array<float, kPathInstants>& path, double last_frequency);
    float at(float frequency) const;

   private:
    std::vector<float> squared_;
    float per_wave_;
  };
  struct Point {
    float x, frequency, log_power, noise, weight;
    float log_gain;  ///< at the newest ratio
  };
  struct Spectrum {
    int window;
    Transfer transfer;
    std::vector<Point> points;
    float offset;
  };
  void apply(float ratio);
  void step();

  std::vector<Spectrum> spectra_;
  Vector common_;
  int windows_ = 0;
  bool began_ = false;
};

}  // namespace gyro_deblur
