#include "blur/ratio_fit.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>

#include <Eigen/Cholesky>
#include <opencv2/core.hpp>

namespace gyro_deblur {
namespace {

// What the window mixes, and paths that are not quite the predicted ones, between the lobes.
constexpr float kLeft = 0.003F;
// Variance of a logarithm by which a block's texture departs from a smooth function.
constexpr float kOwnTexture = 0.05F;
// Residuals beyond so many standard deviations count less (Huber).
constexpr float kOutlier = 2.5F;

}  // namespace

RatioFit::Transfer::Transfer(const std::array<float, kPathInstants>& path, double last_frequency) {
  // The integral of exp(-i w p) over a segment from a to b is (exp(-i w a) - exp(-i w b)) / (i w (b - a)).
  constexpr double kRest = 1e-5;  // a segment that does not move [windows]
  constexpr double kStepCycles = 1.0 / 12;
  const auto [lowest, highest] = std::minmax_element(path.begin(), path.end());
  const double step = std::min(0.5, kStepCycles / std::max(static_cast<double>(*highest) - *lowest, 1e-4));
  per_wave_ = static_cast<float>(1 / step);
  std::array<std::complex<double>, kPathInstants> phase, turn;
  for (int k = 0; k < kPathInstants; ++k) {
    phase[k] = 1;
    turn[k] = std::polar(1.0, -2 * CV_PI * step * path[k]);
  }
  squared_.resize(static_cast<std::size_t>(std::ceil(last_frequency / step)) + 2);
  squared_[0] = 1;
  for (std::size_t i = 1; i < squared_.size(); ++i) {
    for (int k = 0; k < kPathInstants; ++k) phase[k] *= turn[k];
    std::complex<double> sum = 0;
    for (int k = 0; k + 1 < kPathInstants; ++k) {
      const double moved = path[k + 1] - path[k];
      const std::complex<double> middle = 0.5 * (phase[k] + phase[k + 1]), end = phase[k] - phase[k + 1];
      sum += std::abs(moved) < kRest
                 ? middle
                 : std::complex<double>(end.imag(), -end.real()) / (2 * CV_PI * step * static_cast<double>(i) * moved);
    }
    squared_[i] = static_cast<float>(std::norm(sum) / ((kPathInstants - 1.0) * (kPathInstants - 1.0)));
  }
}

inline float RatioFit::Transfer::at(float frequency) const {
  const float place = std::min(std::abs(frequency) * per_wave_, static_cast<float>(squared_.size()) - 1.5F);
  const auto i = static_cast<std::size_t>(place);
  return squared_[i] + (place - static_cast<float>(i)) * (squared_[i + 1] - squared_[i]);
}

RatioFit::RatioFit(const std::vector<MotionSpectrum>& spectra, double largest_ratio) {
  constexpr float kMiddleWave = 12;
  common_ << 0, 0, 0, 1;
  for (const MotionSpectrum& spectrum : spectra) {
    const double last = largest_ratio * (spectrum.points.back().frequency + 1);
    Spectrum& s = spectra_.emplace_back(Spectrum{spectrum.window, Transfer(spectrum.path, last), {}, 0});
    windows_ = std::max(windows_, spectrum.window + 1);
    float weights = 0;
    for (const SpectrumPoint& p : spectrum.points) {
      const Point point{std::log(p.frequency / kMiddleWave),
                        p.frequency,
                        std::log(p.power),
                        p.noise,
                        1 / (p.log_variance + kOwnTexture),
                        0};
      s.points.push_back(point);
      s.offset += point.weight * std::log(std::max(p.power - p.noise, 0.1F * p.power));
      weights += point.weight;
    }
    s.offset /= weights;
  }
}

void RatioFit::apply(float ratio) {
  // Of Hann's window, whose amplitudes are 1/2, 1, 1/2, and of the bins of one wave.
  constexpr float kBeside = 1.0F / 6 + 1.0F / 24;
  for (Spectrum& s : spectra_) {
    for (Point& p : s.points) {
      const float f = ratio * p.frequency;
      p.log_gain = std::log((1 - 2 * kBeside) * s.transfer.at(f) +
                            kBeside * (s.transfer.at(f - ratio) + s.transfer.at(f + ratio)) + kLeft);
    }
  }
}

void RatioFit::step() {
  using Matrix = Eigen::Matrix<float, kCommon, kCommon>;
  // Photographs depart from |f|^-2.5 by so much.
  const Vector expected(0, 0, 0, 1), precision(1, 4, 9, 11);
  Matrix information = precision.asDiagonal();
  Vector slope = precision.cwiseProduct(expected - common_);
  std::vector<std::pair<float, Vector>> of_spectra;  // to find the offsets by
  of_spectra.reserve(spectra_.size());
  for (const Spectrum& s : spectra_) {
    float one = 1e-6F, residual = 0;
    Vector with_one = Vector::Zero();
    for (const Point& p : s.points) {
      const Vector x(p.x, p.x * p.x, p.x * p.x * p.x, p.log_gain);
      const float signal = std::exp(s.offset + common_.dot(x)), both = signal + p.noise;
      const float share = signal / both, error = p.log_power - std::log(both);
      const float stddevs = std::abs(error) * std::sqrt(p.weight);
      const float weight = p.weight * share * (stddevs > kOutlier ? kOutlier / stddevs : 1);
      one += weight * share;
      residual += weight * error;
      with_one += weight * share * x;
      information += weight * share * x * x.transpose();
      slope += weight * error * x;
    }
    information -= with_one * with_one.transpose() / one;
    slope -= with_one * residual / one;
    of_spectra.emplace_back(residual / one, with_one / one);
  }
  const Vector change = information.ldlt().solve(slope);
  common_ += change;
  constexpr float kLongestStep = 2;
  for (std::size_t j = 0; j < spectra_.size(); ++j) {
    spectra_[j].offset +=
        std::clamp(of_spectra[j].first - of_spectra[j].second.dot(change), -kLongestStep, kLongestStep);
  }
}

std::vector<double> RatioFit::costs(double ratio) {
  apply(static_cast<float>(ratio));
  const int steps = began_ ? 2 : 5;
  began_ = true;
  for (int i = 0; i < steps; ++i) step();
  std::vector<double> costs(windows_);
  for (const Spectrum& s : spectra_) {
    for (const Point& p : s.points) {
      const Vector x(p.x, p.x * p.x, p.x * p.x * p.x, p.log_gain);
      const float error = p.log_power - std::log(std::exp(s.offset + common_.dot(x)) + p.noise);
      const float stddevs = std::abs(error) * std::sqrt(p.weight);
      costs[s.window] += stddevs > kOutlier ? kOutlier * (stddevs - 0.5F * kOutlier) : 0.5F * stddevs * stddevs;
    }
  }
  return costs;
}

}  // namespace gyro_deblur
