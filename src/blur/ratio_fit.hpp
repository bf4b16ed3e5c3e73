// How well power spectra fit the blur of paths that are longer or shorter than assumed.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include <Eigen/Core>

#include "blur/motion_spectrum.hpp"
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
  double depth() const { return common_[kCommon - 1]; }

 private:
  static constexpr int kCommon = 4;  // slope, curve, cube, depth
  using Vector = Eigen::Matrix<float, kCommon, 1>;

  /// |H|^2 of a path by frequency, linear between its entries.
  class Transfer {
   public:
    Transfer(const std::array<float, kPathInstants>& path, double last_frequency);
    float at(float frequency) const;

   private:
    std::shared_ptr<const std::vector<float>> squared_;
    float per_wave_;
  };
  struct Spectrum {
    int window;
    int begin, end;  ///< of its points
    Transfer transfer;
    float offset;
    float shift = 0;  ///< of the offset, by the newest step
  };
  /// One element for each point of all spectra, by which loops vectorise.
  struct Points {
    std::vector<float> x, x2, x3, gain;  ///< that slope, curve, cube and depth are multiplied with
    std::vector<float> frequency;
    std::vector<float> before, behind;  ///< shares of the frequencies that are `reach` away after windowing
    std::vector<float> reach;           ///< [waves], 1 where the extent is the same all over the window
    std::vector<float> log_power, noise, weight, root_weight;
    std::vector<float> share, error, robust;  ///< of the signal in the power; of log_power; weight times share
  };
  void apply(float ratio);
  void evaluate();
  Vector step();

  std::vector<Spectrum> spectra_;
  Points points_;
  Vector common_;
  int windows_ = 0;
};

}  // namespace gyro_deblur
