// How well power spectra fit the blur of paths that are longer or shorter than assumed.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <vector>

#include <Eigen/Core>

#include "blur/motion_spectrum.hpp"
#include "blur/ratio_simd.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Fits spectra at one ratio of true to assumed path after the other. The model of the power at a frequency f is
///   exp(offset + slope x + curve x^2 + cube x^3) G^depth + noise, x = log f,
/// G the squared transfer function of the path times the ratio, smeared by the window. Each spectrum has its own
/// offset; slope, curve, cube and depth are common. Each fit starts from that of the ratio before
/// (doc/design/exposure.md).
class RatioFit {
 public:
  /// @param largest_ratio  of those to come
  RatioFit(const std::vector<MotionSpectrum>& spectra, double largest_ratio);

  /// Half of the sum of squared residuals over their variance, by window, at a ratio (0: no blur at all): a negative
  /// log likelihood.
  /// @param steps  of Newton's method from the fit before, the last one's residuals by their slopes; one is enough from
  ///               ratio to ratio
  std::vector<double> costs(double ratio, int steps = 1);

  /// Depth of the spectrum's zeros at the newest ratio: 1 as deep as the path predicts, 0 none.
  double depth() const { return common_[kFitCommon - 1]; }

 private:
  using Vector = Eigen::Matrix<float, kFitCommon, 1>;  // slope, curve, cube, depth

  /// |H|^2 of a path by frequency, linear between its entries.
  struct Transfer {
    Transfer(const std::array<float, kPathInstants>& path, double last_frequency);

    std::shared_ptr<const std::vector<float>> squared;
    float entries_per_wave;
  };
  /// Up to kFitLanes spectra, one in each lane.
  struct Group {
    FitSpectra spectra;
    std::vector<FitPoint> points;
    std::vector<Transfer> transfers;
    std::vector<int> windows;
  };
  void add(const std::vector<MotionSpectrum>& spectra, std::size_t first, double largest_ratio);
  /// @return the change of common_
  Vector step();

  std::vector<Group> groups_;
  Vector common_;
  int windows_ = 0;
};

}  // namespace gyro_deblur
