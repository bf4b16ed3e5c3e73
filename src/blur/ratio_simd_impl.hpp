// Body of the loops that the estimate of the exposure spends its time in, once per instruction set (see
// base/vectors_impl.hpp).
#include "base/logarithms_impl.hpp"
#include "blur/ratio_simd.hpp"

namespace gyro_deblur::GYRO_DEBLUR_ISA {
namespace {

static_assert(kFitLanes % kLanes == 0, "");

// What the window mixes, and paths that are not quite the predicted ones, between the lobes.
constexpr float kLeft = 0.003f;
// Residuals beyond so many standard deviations count less (Huber).
constexpr float kOutlier = 2.5f;

inline Vector absolute(Vector v) { return v < 0 ? -v : v; }

inline Vector within(Vector v, float most) {
  const Vector limit = Vector{} + most;
  v = v < -limit ? -limit : v;
  return v > limit ? limit : v;
}

/// The squared transfer functions of spectra `lane` and following at these frequencies.
inline Vector transfer_at(const FitSpectra& spectra, int lane, Vector frequency) {
  const Vector last = load(spectra.last_place + lane);
  Vector place = absolute(frequency) * load(spectra.entries_per_wave + lane);
  place = place < last ? place : last;
  const IntVector before = __builtin_convertvector(place, IntVector);
  Vector low, high;
  for (int k = 0; k < kLanes; ++k) {
    const float* at = spectra.transfer[lane + k] + before[k];
    low[k] = at[0];
    high[k] = at[1];
  }
  return low + (place - __builtin_convertvector(before, Vector)) * (high - low);
}

void apply(const FitSpectra& spectra, float ratio, FitPoint* points) {
  for (int i = 0; i < spectra.points; ++i) {
    FitPoint& p = points[i];
    for (int lane = 0; lane < kFitLanes; lane += kLanes) {
      const Vector f = ratio * load(p.frequency + lane), reach = ratio * load(p.reach + lane),
                   before = load(p.before + lane), behind = load(p.behind + lane);
      const Vector gain = (1 - before - behind) * transfer_at(spectra, lane, f) +
                          before * transfer_at(spectra, lane, f - reach) +
                          behind * transfer_at(spectra, lane, f + reach) + kLeft;
      store(p.gain + lane, log_of(gain));
    }
  }
}

void evaluate(const FitSpectra& spectra, const float* common, FitPoint* points, FitSums* sums) {
  constexpr float kTiny = 1e-6f, kLargestLog = 80;  // a fit that goes astray stays finite
  const float slope = common[0], curve = common[1], cube = common[2], depth = common[3];
  for (int lane = 0; lane < kFitLanes; lane += kLanes) {
    const Vector offset = load(spectra.offset + lane);
    Vector of_x[2 * kFitPowers - 1] = {}, of_x_gain[kFitPowers] = {}, of_gain2 = {}, of_x_error[kFitPowers] = {},
                                 of_gain_error = {};
    for (int i = 0; i < spectra.points; ++i) {
      FitPoint& p = points[i];
      const Vector x = load(p.x + lane), gain = load(p.gain + lane);
      const Vector log_signal = offset + x * (slope + x * (curve + x * cube)) + depth * gain;
      const Vector signal = exp_of(within(log_signal, kLargestLog));
      const Vector both = signal + load(p.noise + lane), share = signal / both;
      const Vector error = load(p.log_power + lane) - log_of(both);
      const Vector limit = kOutlier / (absolute(error) * load(p.root_weight + lane) + kTiny);
      const Vector robust = load(p.weight + lane) * share * (limit < 1 ? limit : Vector{} + 1);
      store(p.share + lane, share);
      store(p.error + lane, error);
      Vector weight = robust * share, weighted_gain = weight * gain, weighted_error = robust * error;
      of_gain2 += weighted_gain * gain;
      of_gain_error += weighted_error * gain;
      for (int k = 0; k < 2 * kFitPowers - 1; ++k) {
        of_x[k] += weight;
        weight *= x;
        if (k >= kFitPowers) continue;
        of_x_gain[k] += weighted_gain;
        of_x_error[k] += weighted_error;
        weighted_gain *= x;
        weighted_error *= x;
      }
    }
    for (int k = 0; k < 2 * kFitPowers - 1; ++k) store(sums->x[k] + lane, of_x[k]);
    for (int k = 0; k < kFitPowers; ++k) {
      store(sums->x_gain[k] + lane, of_x_gain[k]);
      store(sums->x_error[k] + lane, of_x_error[k]);
    }
    store(sums->gain2 + lane, of_gain2);
    store(sums->gain_error + lane, of_gain_error);
  }
}

void costs(const FitSpectra& spectra, const FitPoint* points, const float* change, float* costs) {
  const float slope = change[0], curve = change[1], cube = change[2], depth = change[3];
  for (int lane = 0; lane < kFitLanes; lane += kLanes) {
    const Vector shift = load(spectra.shift + lane);
    Vector sum = {};
    for (int i = 0; i < spectra.points; ++i) {
      const FitPoint& p = points[i];
      const Vector x = load(p.x + lane);
      const Vector changed = shift + x * (slope + x * (curve + x * cube)) + depth * load(p.gain + lane);
      const Vector stddevs =
          absolute(load(p.error + lane) - load(p.share + lane) * changed) * load(p.root_weight + lane);
      sum += stddevs > kOutlier ? kOutlier * (stddevs - 0.5f * kOutlier) : 0.5f * stddevs * stddevs;
    }
    store(costs + lane, sum);
  }
}

}  // namespace

extern const RatioSimd kRatioSimd;
const RatioSimd kRatioSimd = {GYRO_DEBLUR_ISA_NAME, apply, evaluate, costs};

}  // namespace gyro_deblur::GYRO_DEBLUR_ISA
