// Fits the ratio of true to assumed path length to power spectra.
#include "blur/ratio_fit.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

#include <Eigen/Cholesky>
#include <opencv2/core.hpp>

#include "blur/path_1d.hpp"
#include "blur/squared_transfer.hpp"

namespace gyro_deblur {
namespace {

// What the window mixes, and paths that are not quite the predicted ones, between the lobes.
constexpr float kLeft = 0.003F;
// Variance of a logarithm by which a block's texture departs from a smooth function.
constexpr float kOwnTexture = 0.05F;
// Residuals beyond so many standard deviations count less (Huber).
constexpr float kOutlier = 2.5F;

/// Natural logarithm to 1e-5, of normal x > 0: between powers of two by a polynomial through Chebyshev's points. The
/// library's does not vectorise.
inline float fast_log(float x) {
  std::int32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  const std::int32_t exponent = (bits >> 23) - 127;
  bits = (bits & 0x7fffff) | 0x3f800000;
  float m;
  std::memcpy(&m, &bits, sizeof m);
  constexpr float kLog2 = 0.69314718F;
  return kLog2 * static_cast<float>(exponent) - 1.93675974F +
         m * (3.5140873F + m * (-2.44002976F + m * (1.11609003F + m * (-0.28382685F + m * 0.030449F))));
}

/// Exponential function to a share of 1e-5, of x limited to -80 to 80.
inline float fast_exp(float x) {
  constexpr float kLog2e = 1.442695041F, kFarthest = 80;
  const float limited = x < -kFarthest ? -kFarthest : x > kFarthest ? kFarthest : x;
  const float power = kLog2e * limited + 127;
  const auto whole = static_cast<std::int32_t>(power);
  const float rest = power - static_cast<float>(whole);
  const std::int32_t bits = static_cast<std::int32_t>(static_cast<std::uint32_t>(whole) << 23U);
  float scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return scale * (1.0000036F + rest * (0.69296955F + rest * (0.24162132F + rest * (0.05171774F + rest * 0.01368398F))));
}

// Between entries transfer functions are straight lines: next to a zero that is 1e-4 too much.
constexpr double kStraightCycles = 1.0 / 48;

/// |H|^2 of a straight path of uniform speed and one wave's length, by kStraightCycles.
std::shared_ptr<const std::vector<float>> straight_transfer() {
  constexpr double kLastCycles = 400;  // as far as any path leads
  static const auto kSquared = [] {
    auto squared = std::make_shared<std::vector<float>>(static_cast<std::size_t>(kLastCycles / kStraightCycles));
    (*squared)[0] = 1;
    for (std::size_t i = 1; i < squared->size(); ++i) {
      const double phase = CV_PI * kStraightCycles * static_cast<double>(i);
      (*squared)[i] = static_cast<float>(std::pow(std::sin(phase) / phase, 2));
    }
    return std::shared_ptr<const std::vector<float>>(std::move(squared));
  }();
  return kSquared;
}

bool is_straight(const std::array<float, kPathInstants>& path) {
  constexpr float kOff = 0.01F;  // of its length
  const float length = path.back() - path.front();
  for (int k = 0; k < kPathInstants; ++k) {
    const float even = path.front() + length * static_cast<float>(k) / (kPathInstants - 1);
    if (std::abs(path[k] - even) > kOff * std::abs(length)) return false;
  }
  return true;
}

}  // namespace

RatioFit::Transfer::Transfer(const std::array<float, kPathInstants>& path, double last_frequency) {
  const double extent = std::max(extent_of(path), 1e-4);
  if (is_straight(path)) {
    squared_ = straight_transfer();
    per_wave_ = static_cast<float>(extent / kStraightCycles);
    return;
  }
  constexpr double kRest = 1e-5;  // [windows]
  constexpr double kStepCycles = 1.0 / 24;
  const double step = std::min(0.5, kStepCycles / extent);
  per_wave_ = static_cast<float>(1 / step);
  std::vector<float> squared(static_cast<std::size_t>(std::ceil(last_frequency / step)) + 2);
  squared_transfer(path, step, kRest, &squared);
  squared_ = std::make_shared<const std::vector<float>>(std::move(squared));
}

inline float RatioFit::Transfer::at(float frequency) const {
  const std::vector<float>& squared = *squared_;
  const float place = std::min(std::abs(frequency) * per_wave_, static_cast<float>(squared.size()) - 1.5F);
  const auto i = static_cast<std::size_t>(place);
  return squared[i] + (place - static_cast<float>(i)) * (squared[i + 1] - squared[i]);
}

RatioFit::RatioFit(const std::vector<MotionSpectrum>& spectra, double largest_ratio) {
  constexpr float kMiddleWave = 12;
  // Of Hann's window, whose amplitudes are 1/2, 1, 1/2, and of the bins of one wave.
  constexpr float kAdjacent = 1.0F / 6 + 1.0F / 24;
  // Blur that varies within the window smears as the window does: their variances add up. It does not shift the mean,
  // as the texture's slope within the window does.
  const auto reach_of = [](const SpectrumPoint& p) {
    return std::sqrt(1 + std::pow(p.frequency * p.spread, 2.0F) / (2 * kAdjacent));
  };
  common_ << 0, 0, 0, 1;
  for (const MotionSpectrum& spectrum : spectra) {
    const double last = largest_ratio * (spectrum.points.back().frequency + reach_of(spectrum.points.back()));
    const auto begin = static_cast<int>(points_.x.size());
    float sum = 0, weights = 0;
    for (const SpectrumPoint& p : spectrum.points) {
      const float x = std::log(p.frequency / kMiddleWave), weight = 1 / (p.log_variance + kOwnTexture);
      const float reach = reach_of(p);
      const float before = kAdjacent * std::exp(p.tilt / reach), behind = kAdjacent * std::exp(-p.tilt / reach),
                  all = 1 - 2 * kAdjacent + before + behind;
      points_.x.push_back(x);
      points_.x2.push_back(x * x);
      points_.x3.push_back(x * x * x);
      points_.frequency.push_back(p.frequency);
      points_.before.push_back(before / all);
      points_.behind.push_back(behind / all);
      points_.reach.push_back(reach);
      points_.log_power.push_back(std::log(p.power));
      points_.noise.push_back(p.noise);
      points_.weight.push_back(weight);
      points_.root_weight.push_back(std::sqrt(weight));
      sum += weight * std::log(std::max(p.power - p.noise, 0.1F * p.power));
      weights += weight;
    }
    spectra_.push_back(
        {spectrum.window, begin, static_cast<int>(points_.x.size()), Transfer(spectrum.path, last), sum / weights});
    windows_ = std::max(windows_, spectrum.window + 1);
  }
  for (std::vector<float>* values : {&points_.gain, &points_.share, &points_.error, &points_.robust}) {
    values->resize(points_.x.size());
  }
}

void RatioFit::apply(float ratio) {
  Points& p = points_;
  for (const Spectrum& s : spectra_) {
    for (int i = s.begin; i < s.end; ++i) {
      const float f = ratio * p.frequency[i], reach = ratio * p.reach[i];
      p.gain[i] = (1 - p.before[i] - p.behind[i]) * s.transfer.at(f) + p.before[i] * s.transfer.at(f - reach) +
                  p.behind[i] * s.transfer.at(f + reach) + kLeft;
    }
  }
  float* const gain = p.gain.data();
  const auto count = static_cast<int>(p.gain.size());
#pragma omp simd
  for (int i = 0; i < count; ++i) gain[i] = fast_log(gain[i]);
}

/// Residuals, and the weights of their squares.
void RatioFit::evaluate() {
  constexpr float kTiny = 1e-6F;
  const float slope = common_[0], curve = common_[1], cube = common_[2], depth = common_[3];
  const Points& p = points_;
  const float *x = p.x.data(), *x2 = p.x2.data(), *x3 = p.x3.data(), *gain = p.gain.data(), *noise = p.noise.data(),
              *log_power = p.log_power.data(), *weight = p.weight.data(), *root_weight = p.root_weight.data();
  float *share = points_.share.data(), *error = points_.error.data(), *robust = points_.robust.data();
  for (const Spectrum& s : spectra_) {
    const float offset = s.offset;
#pragma omp simd
    for (int i = s.begin; i < s.end; ++i) {
      const float signal = fast_exp(offset + slope * x[i] + curve * x2[i] + cube * x3[i] + depth * gain[i]);
      const float both = signal + noise[i];
      share[i] = signal / both;
      error[i] = log_power[i] - fast_log(both);
      const float limit = kOutlier / (std::abs(error[i]) * root_weight[i] + kTiny);
      robust[i] = weight[i] * share[i] * (limit < 1 ? limit : 1);
    }
  }
}

/// @return the change of common_
RatioFit::Vector RatioFit::step() {
  using Matrix = Eigen::Matrix<float, kCommon, kCommon>;
  // Photographs depart from |f|^-2.5 by so much.
  const Vector expected(0, 0, 0, 1), precision(1, 4, 9, 11);
  Matrix information = precision.asDiagonal();
  Vector slope = precision.cwiseProduct(expected - common_);
  std::vector<Vector> with_offsets;  // by which the offsets follow
  with_offsets.reserve(spectra_.size());
  const Points& p = points_;
  for (Spectrum& s : spectra_) {
    float one = 1e-6F, residual = 0;
    Vector with_one = Vector::Zero();
    for (int i = s.begin; i < s.end; ++i) {
      const Vector x(p.x[i], p.x2[i], p.x3[i], p.gain[i]);
      const Vector weighted = p.robust[i] * p.share[i] * x;
      one += p.robust[i] * p.share[i];
      residual += p.robust[i] * p.error[i];
      with_one += weighted;
      information += weighted * x.transpose();
      slope += p.robust[i] * p.error[i] * x;
    }
    information -= with_one * with_one.transpose() / one;
    slope -= with_one * residual / one;
    s.shift = residual / one;
    with_offsets.push_back(with_one / one);
  }
  const Vector change = information.ldlt().solve(slope);
  common_ += change;
  constexpr float kLongestStep = 2;
  for (std::size_t j = 0; j < spectra_.size(); ++j) {
    Spectrum& s = spectra_[j];
    s.shift = std::clamp(s.shift - with_offsets[j].dot(change), -kLongestStep, kLongestStep);
    s.offset += s.shift;
  }
  return change;
}

std::vector<double> RatioFit::costs(double ratio, int steps) {
  apply(static_cast<float>(ratio));
  Vector change = Vector::Zero();
  for (int i = 0; i < steps; ++i) {
    evaluate();
    change = step();
  }
  std::vector<double> costs(windows_);
  const Points& p = points_;
  const float slope = change[0], curve = change[1], cube = change[2], depth = change[3];
  const float *x = p.x.data(), *x2 = p.x2.data(), *x3 = p.x3.data(), *gain = p.gain.data(), *share = p.share.data(),
              *error = p.error.data(), *root_weight = p.root_weight.data();
  for (const Spectrum& s : spectra_) {
    const float shift = s.shift;
    float sum = 0;
#pragma omp simd reduction(+ : sum)
    for (int i = s.begin; i < s.end; ++i) {
      const float changed = shift + slope * x[i] + curve * x2[i] + cube * x3[i] + depth * gain[i];
      const float stddevs = std::abs(error[i] - share[i] * changed) * root_weight[i];
      sum += stddevs > kOutlier ? kOutlier * (stddevs - 0.5F * kOutlier) : 0.5F * stddevs * stddevs;
    }
    costs[s.window] += sum;
  }
  return costs;
}

}  // namespace gyro_deblur
