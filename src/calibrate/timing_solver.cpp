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

void TimingSolver::update_priors(const TimingState& state) {
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
  if (count > 0) priors_.speed_per_s = std::max(std::sqrt(squares / count), kLeastSpeed);
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
  for (const ReducedEquations& one : equations) H += one.H;
  constexpr std::size_t kMostLags = 10;
  const std::size_t lags = std::min(kMostLags, equations.size() / 4);
  Eigen::MatrixXd alone, scatter = Eigen::MatrixXd::Zero(values, values);
  for (std::size_t lag = 0; lag <= lags; ++lag) {
    Eigen::MatrixXd products = Eigen::MatrixXd::Zero(values, values);
    for (std::size_t i = lag; i < equations.size(); ++i) {
      products += equations[i].gradient * equations[i - lag].gradient.transpose();
    }
    const double weight = 1 - static_cast<double>(lag) / static_cast<double>(lags + 1);
    if (lag == 0) alone = products;
    scatter += lag == 0 ? products : Eigen::MatrixXd(weight * (products + products.transpose()));
  }
  const Eigen::FullPivLU<Eigen::MatrixXd> lu(H);
  if (!lu.isInvertible()) {
    throw TimingError("the recording does not determine the values: there is too little motion");
  }
  const Eigen::MatrixXd inverse = lu.inverse();
  return (inverse * scatter * inverse.transpose())
      .diagonal()
      .cwiseMax((inverse * alone * inverse.transpose()).diagonal());
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
  priors_ = {std::max(median(lengths) / kRayleighMedian, kLeastNoisePx), 1};
  double damping = 1e-3;
  constexpr int kMaxIterations = 30;
  constexpr double kDone = 0.01;  // of the steps of differentiation
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const double length = improve(state, &damping);
    update_priors(*state);
    if (length < kDone) break;
  }
  fit_all(*state, &structures_);
  variances_ = variances_of(linearise(*state));
}

}  // namespace gyro_deblur
