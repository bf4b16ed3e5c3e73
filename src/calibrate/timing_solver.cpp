#include "calibrate/timing_solver.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "base/median.hpp"

namespace gyro_deblur {
namespace {

/// Standard deviation of a coordinate over the median length of a residual (Rayleigh's distribution).
constexpr double kRayleighMedian = 1.1774;
constexpr double kLeastNoisePx = 0.02;

}  // namespace

TimingSolver::TimingSolver(const TimingModel& model, const std::vector<WindowPoints>& windows)
    : model_(model), windows_(windows) {}

WindowFit TimingSolver::fit_of(const TimingState& state, const RotationTrack& gyro, std::size_t window) const {
  const WindowPoints& points = windows_[window];
  return {model_.camera(), points, model_.turned_rays(points, gyro, state), model_.passages(points, gyro, state),
          model_.frame_times_s(points, state)};
}

std::vector<Eigen::Vector2d> TimingSolver::residuals(const TimingState& state, std::size_t window) const {
  return fit_of(state, model_.track(state), window).residuals(structures_[window]);
}

double TimingSolver::fit_all(const TimingState& state, std::vector<WindowStructure>* structures) const {
  const RotationTrack gyro = model_.track(state);
  double cost = 0;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    cost += fit_of(state, gyro, i).improve(&(*structures)[i], priors_);
  }
  return cost;
}

std::vector<ReducedEquations> TimingSolver::linearise(const TimingState& state) const {
  const TimingDerivatives derivatives(model_, state);
  const RotationTrack gyro = model_.track(state);
  std::vector<ReducedEquations> result;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const WindowFit fit = fit_of(state, gyro, i);
    result.push_back(fit.reduce(structures_[i], priors_, derivatives.of(windows_[i], fit.turned_rays())));
  }
  return result;
}

void TimingSolver::update_priors(const TimingState& state, bool translates) {
  const RotationTrack gyro = model_.track(state);
  std::vector<double> lengths;
  double squares = 0, count = 0, unknowns = 0;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const WindowFit fit = fit_of(state, gyro, i);
    for (const Eigen::Vector2d& residual : fit.residuals(structures_[i])) {
      if (residual.allFinite()) lengths.push_back(residual.norm());
    }
    unknowns += fit.add_speeds(structures_[i], priors_, &squares, &count);
  }
  // What was fitted has taken its part of the noise.
  constexpr double kLeastFreedom = 0.1;
  const double freedom =
      std::max(kLeastFreedom, 1 - (unknowns + count) / (2 * std::max(1.0, static_cast<double>(lengths.size()))));
  constexpr double kLeastSpeed = 1e-5;
  priors_.noise_px = std::max(median(lengths) / kRayleighMedian / std::sqrt(freedom), kLeastNoisePx);
  if (translates && count > 0) priors_.speed_per_s = std::max(std::sqrt(squares / count), kLeastSpeed);
}

double TimingSolver::improve(TimingState* state, double* damping) {
  const std::vector<double> steps = model_.steps_of_differentiation();
  const double cost = fit_all(*state, &structures_);
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(model_.values(), model_.values());
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(model_.values());
  for (const ReducedEquations& equations : linearise(*state)) {
    H += equations.H;
    gradient += equations.gradient;
  }
  constexpr int kMaxAttempts = 10;
  for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
    Eigen::MatrixXd damped = H;
    damped.diagonal() *= 1 + *damping;
    const Eigen::VectorXd step = -damped.ldlt().solve(gradient);
    *damping *= 10;
    if (!step.allFinite()) continue;
    const TimingState next = model_.moved(*state, step);
    constexpr double kLongestReadoutS = 1, kLargestBias = 1;
    if (std::abs(next.readout_s) > kLongestReadoutS || next.bias_rad_s.cwiseAbs().maxCoeff() > kLargestBias) continue;
    std::vector<WindowStructure> structures = structures_;
    if (!(fit_all(next, &structures) < cost)) continue;
    *state = next;
    structures_ = std::move(structures);
    *damping /= 100;
    double length = 0;
    for (std::size_t k = 0; k < steps.size(); ++k) {
      length = std::max(length, std::abs(step[static_cast<Eigen::Index>(k)]) / steps[k]);
    }
    return length;
  }
  return 0;
}

Eigen::VectorXd TimingSolver::variances_of(const std::vector<ReducedEquations>& equations) const {
  const Eigen::Index values = model_.values();
  Eigen::MatrixXd H = Eigen::MatrixXd::Zero(values, values);
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(values);
  for (const ReducedEquations& one : equations) {
    H += one.H;
    gradient += one.gradient;
  }
  const auto require_determined = [](const Eigen::FullPivLU<Eigen::MatrixXd>& lu) {
    if (lu.isInvertible()) return;
    throw TimingError("the recording does not determine the values: there is too little motion");
  };
  require_determined(Eigen::FullPivLU<Eigen::MatrixXd>(H));
  constexpr std::size_t kBlockWindows = 20, kFewestBlocks = 10;
  const std::size_t blocks = std::max(kFewestBlocks, equations.size() / kBlockWindows);
  Eigen::VectorXd variances = Eigen::VectorXd::Zero(values);
  for (std::size_t block = 0; block < blocks; ++block) {
    Eigen::MatrixXd others_H = H;
    Eigen::VectorXd others_gradient = gradient;
    for (std::size_t i = block * equations.size() / blocks; i < (block + 1) * equations.size() / blocks; ++i) {
      others_H -= equations[i].H;
      others_gradient -= equations[i].gradient;
    }
    const Eigen::FullPivLU<Eigen::MatrixXd> lu(others_H);
    require_determined(lu);
    variances += lu.solve(others_gradient).cwiseAbs2();
  }
  // Tracking errs by some hundredths of a pixel alike in all frames, which does not show in the scatter: over the flights
  // of doc/reports/timing.md errors are 1.6 times as large as that says.
  constexpr double kErrorOverScatter = 2;
  return kErrorOverScatter * kErrorOverScatter * static_cast<double>(blocks - 1) / static_cast<double>(blocks) *
         variances;
}

void TimingSolver::descend(bool translates, TimingState* state) {
  double damping = 1e-3;
  constexpr int kMaxIterations = 30;
  constexpr double kDone = 0.01;  // of the steps of differentiation
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const double length = improve(state, &damping);
    update_priors(*state, translates);
    if (length < kDone) break;
  }
}

void TimingSolver::solve(TimingState* state) {
  const RotationTrack gyro = model_.track(*state);
  structures_.clear();
  std::vector<double> lengths;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const WindowFit fit = fit_of(*state, gyro, i);
    structures_.push_back(fit.at_rest());
    for (const Eigen::Vector2d& residual : fit.residuals(structures_[i])) {
      if (residual.allFinite()) lengths.push_back(residual.norm());
    }
  }
  // On the spot a steady way and a bias look all but alike, and errors of tracking and the gyroscope's noise pass for a
  // small one. So the camera is at rest unless a way explains much more than that.
  constexpr double kAtRestPerS = 1e-6, kFirstSpeedPerS = 1, kWorthIt = 0.5;
  priors_ = {std::max(median(lengths) / kRayleighMedian, kLeastNoisePx), kAtRestPerS};
  descend(false, state);
  const TimingState at_rest = *state;
  const StructurePriors priors_at_rest = priors_;
  const std::vector<WindowStructure> structures_at_rest = structures_;
  priors_.speed_per_s = kFirstSpeedPerS;
  descend(true, state);
  if (priors_.noise_px > kWorthIt * priors_at_rest.noise_px) {
    *state = at_rest;
    priors_ = priors_at_rest;
    structures_ = structures_at_rest;
  }
  fit_all(*state, &structures_);
  variances_ = variances_of(linearise(*state));
}

}  // namespace gyro_deblur
