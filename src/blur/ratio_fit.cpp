// Fits the ratio of true to assumed path length to power spectra.
#include "blur/ratio_fit.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include <Eigen/Cholesky>
#include <opencv2/core.hpp>

#include "blur/path_1d.hpp"
#include "blur/squared_transfer.hpp"

namespace gyro_deblur {
namespace {

// Variance of a logarithm by which a block's texture departs from a smooth function.
constexpr float kOwnTexture = 0.05F;
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

const RatioSimd& ratio_simd() {
  static const RatioSimd& simd = select_for_cpu<RatioSimd>();
  return simd;
}

// Of Hann's window, whose amplitudes are 1/2, 1, 1/2, and of the bins of one wave.
constexpr float kAdjacent = 1.0F / 6 + 1.0F / 24;

/// How far the frequencies are apart that the window mixes. Blur that varies within the window smears as the window
/// does: their variances add up. It does not shift the mean, as the texture's slope within the window does.
float reach_of(const SpectrumPoint& p) {
  const float varied = p.frequency * p.spread;
  return std::sqrt(1 + varied * varied / (2 * kAdjacent));
}

/// Puts a point into its lane.
void set_point(const SpectrumPoint& from, int lane, FitPoint* to) {
  constexpr float kMiddleWave = 12;
  const float reach = reach_of(from), weight = 1 / (from.log_variance + kOwnTexture);
  const float before = kAdjacent * std::exp(from.tilt / reach), behind = kAdjacent * std::exp(-from.tilt / reach),
              all = 1 - 2 * kAdjacent + before + behind;
  to->x[lane] = std::log(from.frequency / kMiddleWave);
  to->frequency[lane] = from.frequency;
  to->before[lane] = before / all;
  to->behind[lane] = behind / all;
  to->reach[lane] = reach;
  to->log_power[lane] = std::log(from.power);
  to->noise[lane] = from.noise;
  to->weight[lane] = weight;
  to->root_weight[lane] = std::sqrt(weight);
}

}  // namespace

RatioFit::Transfer::Transfer(const std::array<float, kPathInstants>& path, double last_frequency) {
  const double extent = std::max(extent_of(path), 1e-4);
  if (is_straight(path)) {
    squared = straight_transfer();
    entries_per_wave = static_cast<float>(extent / kStraightCycles);
    return;
  }
  constexpr double kRest = 1e-5;  // [windows]
  constexpr double kStepCycles = 1.0 / 24;
  const double step = std::min(0.5, kStepCycles / extent);
  entries_per_wave = static_cast<float>(1 / step);
  std::vector<float> table(static_cast<std::size_t>(std::ceil(last_frequency / step)) + 2);
  squared_transfer(path, step, kRest, &table);
  squared = std::make_shared<const std::vector<float>>(std::move(table));
}

RatioFit::RatioFit(const std::vector<MotionSpectrum>& spectra, double largest_ratio) {
  common_ << 0, 0, 0, 1;
  for (std::size_t first = 0; first < spectra.size(); first += kFitLanes) add(spectra, first, largest_ratio);
}

void RatioFit::add(const std::vector<MotionSpectrum>& spectra, std::size_t first, double largest_ratio) {
  Group& group = groups_.emplace_back();
  const auto end = spectra.begin() + static_cast<std::ptrdiff_t>(std::min(first + kFitLanes, spectra.size()));
  std::size_t most = 0;
  for (auto s = spectra.begin() + static_cast<std::ptrdiff_t>(first); s != end; ++s)
    most = std::max(most, s->points.size());
  FitPoint none{};
  // A power of 1 that is noise alone; without weight.
  for (int lane = 0; lane < kFitLanes; ++lane) none.noise[lane] = none.reach[lane] = 1;
  group.points.assign(most, none);
  FitSpectra& of = group.spectra;
  of = {};
  of.points = static_cast<int>(most);
  for (const float*& transfer : of.transfer) transfer = straight_transfer()->data();
  int lane = 0;
  for (auto s = spectra.begin() + static_cast<std::ptrdiff_t>(first); s != end; ++s, ++lane) {
    const SpectrumPoint& last = s->points.back();
    const Transfer& transfer = group.transfers.emplace_back(s->path, largest_ratio * (last.frequency + reach_of(last)));
    of.transfer[lane] = transfer.squared->data();
    of.entries_per_wave[lane] = transfer.entries_per_wave;
    of.last_place[lane] = static_cast<float>(transfer.squared->size()) - 1.5F;
    float sum = 0, weights = 0;
    for (std::size_t i = 0; i < s->points.size(); ++i) {
      const SpectrumPoint& p = s->points[i];
      set_point(p, lane, &group.points[i]);
      const float weight = group.points[i].weight[lane];
      sum += weight * std::log(std::max(p.power - p.noise, 0.1F * p.power));
      weights += weight;
    }
    of.offset[lane] = sum / weights;
    group.windows.push_back(s->window);
    windows_ = std::max(windows_, s->window + 1);
  }
}

RatioFit::Vector RatioFit::step() {
  using Matrix = Eigen::Matrix<float, kFitCommon, kFitCommon>;
  // Photographs depart from |f|^-2.5 by so much.
  const Vector expected(0, 0, 0, 1), precision(1, 4, 9, 11);
  Matrix information = precision.asDiagonal();
  Vector slope = precision.cwiseProduct(expected - common_);
  std::vector<Vector> with_offsets;  // by which the offsets follow
  for (Group& group : groups_) {
    FitSums s;
    ratio_simd().evaluate(group.spectra, common_.data(), group.points.data(), &s);
    for (int i = 0; i < static_cast<int>(group.windows.size()); ++i) {
      const float one = s.x[0][i] + 1e-6F, residual = s.x_error[0][i];
      const Vector with_one(s.x[1][i], s.x[2][i], s.x[3][i], s.x_gain[0][i]), with_offset = with_one / one;
      Matrix own;
      own << s.x[2][i], s.x[3][i], s.x[4][i], s.x_gain[1][i],  //
          s.x[3][i], s.x[4][i], s.x[5][i], s.x_gain[2][i],     //
          s.x[4][i], s.x[5][i], s.x[6][i], s.x_gain[3][i],     //
          s.x_gain[1][i], s.x_gain[2][i], s.x_gain[3][i], s.gain2[i];
      information += own - with_one * with_offset.transpose();
      slope += Vector(s.x_error[1][i], s.x_error[2][i], s.x_error[3][i], s.gain_error[i]) - with_offset * residual;
      group.spectra.shift[i] = residual / one;
      with_offsets.push_back(with_offset);
    }
  }
  const Vector change = information.ldlt().solve(slope);
  common_ += change;
  constexpr float kLongestStep = 2;
  auto with_offset = with_offsets.begin();
  for (Group& group : groups_) {
    for (std::size_t i = 0; i < group.windows.size(); ++i) {
      float& shift = group.spectra.shift[i];
      shift = std::clamp(shift - (with_offset++)->dot(change), -kLongestStep, kLongestStep);
      group.spectra.offset[i] += shift;
    }
  }
  return change;
}

std::vector<double> RatioFit::costs(double ratio, int steps) {
  for (Group& group : groups_) ratio_simd().apply(group.spectra, static_cast<float>(ratio), group.points.data());
  Vector change = Vector::Zero();
  for (int i = 0; i < steps; ++i) change = step();
  std::vector<double> costs(windows_);
  for (const Group& group : groups_) {
    FitLanes of_spectra;
    ratio_simd().costs(group.spectra, group.points.data(), change.data(), of_spectra);
    for (std::size_t i = 0; i < group.windows.size(); ++i) costs[group.windows[i]] += of_spectra[i];
  }
  return costs;
}

}  // namespace gyro_deblur
