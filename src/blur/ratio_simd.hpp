// The loops that the estimate of the exposure spends its time in: one interface, compiled once per instruction set.
#pragma once

#include <cstdint>

#include "base/instruction_sets.hpp"

namespace gyro_deblur {

/// Spectra that are fitted together: lanes of the widest vector. Each has a lane, so that no sum goes across lanes.
constexpr int kFitLanes = 16;
using FitLanes = float[kFitLanes];

/// One point of each spectrum. Spectra that have fewer points have weights of 0 there.
struct FitPoint {
  FitLanes x;          ///< logarithm of the frequency
  FitLanes frequency;  ///< [waves a window]
  FitLanes before, behind, reach;
  FitLanes log_power, noise, weight, root_weight;
  FitLanes gain;          ///< logarithm of the squared transfer function, smeared by the window
  FitLanes share, error;  ///< of the signal in the power; of log_power
};

/// What the points of a spectrum have in common.
struct FitSpectra {
  int points;
  const float* transfer[kFitLanes];  ///< tables of the squared transfer functions, straight between entries
  FitLanes entries_per_wave, last_place;
  FitLanes offset;
  FitLanes shift;  ///< of the offset, by the newest step
};

/// slope, curve, cube and depth of the model, which all spectra have in common.
constexpr int kFitCommon = 4;
/// Powers of x in the model: the offset's, and those of slope, curve and cube.
constexpr int kFitPowers = 4;

/// Weighted sums over a spectrum's points for a step of Newton's method. g is the gain.
struct FitSums {
  FitLanes x[2 * kFitPowers - 1];  ///< of x^k
  FitLanes x_gain[kFitPowers];     ///< of x^k g
  FitLanes gain2;                  ///< of g^2
  FitLanes x_error[kFitPowers];    ///< of x^k times the error
  FitLanes gain_error;             ///< of g times the error
};

/// The functions of one instruction set.
struct RatioSimd {
  const char* name;
  /// Gains of the paths times `ratio`.
  void (*apply)(const FitSpectra& spectra, float ratio, FitPoint* points);
  /// Shares and errors of the model, and their sums.
  /// @param common  kFitCommon values
  void (*evaluate)(const FitSpectra& spectra, const float* common, FitPoint* points, FitSums* sums);
  /// Half of the sums of squared residuals over their variance, Huber's, once the model has changed.
  /// @param change  of the kFitCommon values
  void (*costs)(const FitSpectra& spectra, const FitPoint* points, const float* change, float* costs);
};

GYRO_DEBLUR_SIMD_KERNELS(RatioSimd)

}  // namespace gyro_deblur
