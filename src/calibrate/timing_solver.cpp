// Solves for timing, translation and depths by robust least squares.
#include "calibrate/timing_solver.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "base/median.hpp"

namespace gyro_deblur {
namespace {

/// Standard deviation of a coordinate over the median length of a residual (Rayleigh's distribution).
constexpr double kRayleighMedian = 1.1774;
constexpr double kLeastNoisePx = 0.02;

ReducedEquations sum_of_equations(const std::vector<ReducedEquations>& equations, Eigen::Index values) {
  ReducedEquations sum{Eigen::MatrixXd::Zero(values, values), Eigen::VectorXd::Zero(values)};
  for (const ReducedEquations& one : equations) {
    sum.H += one.H;
    sum.gradient += one.gradient;
  }
  return sum;
}

}  // namespace

TimingSolver::TimingSolver(const TimingModel& model, const std::vector<WindowPoints>& windows, const TimingState& start)
    : model_(model), windows_(windows), state_(start), fits_(fits_of(start)) {
  for (const WindowFit& fit : fits_) structures_.push_back(fit.at_rest());
}

std::vector<WindowFit> TimingSolver::fits_of(const TimingState& state) const {
  const RotationTrack gyro = model_.track(state);
  std::vector<WindowFit> fits;
  fits.reserve(windows_.size());
  for (const WindowPoints& points : windows_) {
    fits.emplace_back(model_.camera(), points, model_.rotated_rays(points, gyro, state),
                      model_.passages(points, gyro, state), model_.frame_times_s(points, state));
  }
  return fits;
}

double TimingSolver::fit(const std::vector<WindowFit>& fits, std::vector<WindowStructure>* structures) const {
  double cost = 0;
  for (std::size_t i = 0; i < fits.size(); ++i) cost += fits[i].improve(&(*structures)[i], priors_);
  return cost;
}

std::vector<ReducedEquations> TimingSolver::linearise() const {
  const TimingDerivatives derivatives(model_, state_);
  std::vector<ReducedEquations> result;
  result.reserve(fits_.size());
  for (std::size_t i = 0; i < fits_.size(); ++i) {
    result.push_back(fits_[i].reduce(structures_[i], priors_, derivatives.of(windows_[i], fits_[i].rotated_rays())));
  }
  return result;
}

double TimingSolver::median_residual_px() const {
  std::vector<double> lengths;
  for (std::size_t i = 0; i < fits_.size(); ++i) {
    for (const Eigen::Vector2d& residual : residuals(i)) {
      if (residual.allFinite()) lengths.push_back(residual.norm());
    }
  }
  return median(lengths);
}

void TimingSolver::update_priors(bool translates) {
  double squares = 0, speeds = 0, depths = 0, coordinates = 0;
  for (std::size_t i = 0; i < fits_.size(); ++i) {
    depths += fits_[i].add_speeds(structures_[i], priors_, &squares, &speeds);
    coordinates += 2 * static_cast<double>(windows_[i].sightings.size());
  }
  // What was fitted has taken its part of the noise.
  constexpr double kLeastFreedom = 0.1, kLeastSpeedPerS = 1e-5;
  const double freedom = std::max(kLeastFreedom, 1 - (depths + speeds) / coordinates);
  priors_.noise_px = std::max(median_residual_px() / kRayleighMedian / std::sqrt(freedom), kLeastNoisePx);
  if (translates && speeds > 0) priors_.speed_per_s = std::max(std::sqrt(squares / speeds), kLeastSpeedPerS);
}

double TimingSolver::improve(double* damping) {
  const std::vector<double> steps = model_.steps_of_differentiation();
  const double cost = fit(fits_, &structures_);
  const auto [H, gradient] = sum_of_equations(linearise(), model_.values());
  constexpr int kMaxAttempts = 10;
  for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
    Eigen::MatrixXd damped = H;
    damped.diagonal() *= 1 + *damping;
    const Eigen::VectorXd step = -damped.ldlt().solve(gradient);
    *damping *= 10;
    if (!step.allFinite()) continue;
    const TimingState next = model_.moved(state_, step);
    // Gyroscope and shutter take up to 1, and the derivatives are taken a little beyond.
    constexpr double kLongestReadoutS = 0.99, kLargestBias = 0.99;
    if (std::abs(next.readout_s) > kLongestReadoutS || next.bias_rad_s.cwiseAbs().maxCoeff() > kLargestBias) continue;
    std::vector<WindowFit> fits = fits_of(next);
    std::vector<WindowStructure> structures = structures_;
    if (!(fit(fits, &structures) < cost)) continue;
    state_ = next;
    fits_ = std::move(fits);
    structures_ = std::move(structures);
    *damping /= 100;
    return (step.array().abs() / Eigen::Map<const Eigen::ArrayXd>(steps.data(), step.size())).maxCoeff();
  }
  return 0;
}

Eigen::VectorXd TimingSolver::variances_of(const std::vector<ReducedEquations>& equations) const {
  const Eigen::Index values = model_.values();
  const auto [H, gradient] = sum_of_equations(equations, values);
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
  // Tracking has the same error of some hundredths of a pixel in all frames, which does not show in the scatter: over
  // the flights of doc/reports/timing.md errors are 1.9 times as large as that says.
  constexpr double kErrorOverScatter = 2;
  return kErrorOverScatter * kErrorOverScatter * static_cast<double>(blocks - 1) / static_cast<double>(blocks) *
         variances;
}

void TimingSolver::descend(bool translates) {
  double damping = 1e-3;
  constexpr int kMaxIterations = 30;
  constexpr double kDone = 0.01;  // of the steps of differentiation
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const double length = improve(&damping);
    update_priors(translates);
    if (length < kDone) break;
  }
}

TimingState TimingSolver::solve() {
  // Without translation a constant velocity and a bias look nearly the same, and errors of tracking and noise of the
  // gyroscope look like a small velocity. So the camera has none unless a velocity explains much more than that.
  constexpr double kAtRestPerS = 1e-6, kFirstSpeedPerS = 1, kWorthIt = 0.5;
  priors_ = {std::max(median_residual_px() / kRayleighMedian, kLeastNoisePx), kAtRestPerS};
  descend(false);
  const TimingState state_at_rest = state_;
  const StructurePriors priors_at_rest = priors_;
  const std::vector<WindowStructure> structures_at_rest = structures_;
  priors_.speed_per_s = kFirstSpeedPerS;
  descend(true);
  if (priors_.noise_px > kWorthIt * priors_at_rest.noise_px) {
    state_ = state_at_rest;
    priors_ = priors_at_rest;
    structures_ = structures_at_rest;
    fits_ = fits_of(state_);
  }
  fit(fits_, &structures_);
  variances_ = variances_of(linearise());
  return state_;
}

}  // namespace gyro_deblur
