// Robust least squares over all windows: timing, the camera's translation and the points' depths.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "calibrate/timing_model.hpp"
#include "calibrate/window_structure.hpp"

namespace gyro_deblur {

class TimingSolver {
 public:
  /// Keeps references to model and windows.
  /// @param start  of the search, with a camera that only rotates
  TimingSolver(const TimingModel& model, const std::vector<WindowPoints>& windows, const TimingState& start);

  /// Returns the state of the least cost. Throws TimingError when the recording does not determine it.
  TimingState solve();

  /// After solve: variances of the values, in their order.
  const Eigen::VectorXd& variances() const { return variances_; }
  /// The residuals of one window [px]: before solve() at the start, after it with the window's translation.
  std::vector<Eigen::Vector2d> residuals(std::size_t window) const {
    return fits_[window].residuals(structures_[window]);
  }
  /// After solve.
  const StructurePriors& priors() const { return priors_; }

 private:
  std::vector<WindowFit> fits_of(const TimingState& state) const;
  /// The least cost by the structures.
  double fit(const std::vector<WindowFit>& fits, std::vector<WindowStructure>* structures) const;
  std::vector<ReducedEquations> linearise() const;
  double median_residual_px() const;
  /// One step of Levenberg and Marquardt. Returns its length in steps of differentiation; 0 when nothing costs less.
  double improve(double* damping);
  /// To the least cost, with or without translation.
  void descend(bool translates);
  void update_priors(bool translates);
  /// By the jackknife: how the values change when a block of neighbouring windows is left out (Kuensch, 1989), each in
  /// one step. Its weight in the recording is allowed for, and what neighbours have in common.
  Eigen::VectorXd variances_of(const std::vector<ReducedEquations>& equations) const;

  const TimingModel& model_;
  const std::vector<WindowPoints>& windows_;
  TimingState state_;
  std::vector<WindowFit> fits_;  ///< of the state
  std::vector<WindowStructure> structures_;
  StructurePriors priors_;
  Eigen::VectorXd variances_;
};

}  // namespace gyro_deblur
