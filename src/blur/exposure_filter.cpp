// Combines the exposure estimates of many images.
#include "blur/exposure_filter.hpp"

#include <algorithm>
#include <cmath>

namespace gyro_deblur {
namespace {

double squared(double x) { return x * x; }

/// Proportional to the density of a normal variable with mean 0.
double normal_density(double x, double variance) {
  return std::exp(-0.5 * squared(x) / variance) / std::sqrt(variance);
}

// However many estimates there are, some ten of them make the value: then changes of 1 % are not forgotten.
constexpr double kLeastStddev = 0.004;
// Estimates of consecutive images share their velocities, and with them part of their error.
constexpr double kSharedStddev = 0.008;
// Farther from the state than this many standard deviations, an estimate contradicts it.
constexpr double kGate = 3;
// Growth of the variance of a constant exposure: a deviation of 1 % after a second, a quarter after ten minutes.
constexpr double kRestVariancePerS = 1e-4;
// Growth of the variance of the speed of a changing exposure: 0.3 / s within a tenth of a second. Auto exposure changes
// by a factor of six within two seconds, and stops at once.
constexpr double kSpeedVariancePerS = 0.3 * 0.3 / 0.1;
// Without estimates a movement is extrapolated for so long: then it may have ended.
constexpr double kExtrapolatedS = 0.3;
// An estimate that contradicts the state is forgotten after this time.
constexpr TimeNs kCandidateNs = 1'000'000'000;
// The part of a change of brightness that may come from the exposure rather than the scene: one standard deviation.
constexpr double kExposureShare = 0.3;
// More than this standard deviation is not known.
constexpr double kUnknown = 0.25;

}  // namespace

/// At the last image, by what was known at the last update.
ExposureFilter::Value ExposureFilter::predicted() const {
  Value now = *value_;
  const double since_s = to_seconds(*stamp_ns_ - value_->stamp_ns);
  now.stamp_ns = *stamp_ns_;
  now.variance += kRestVariancePerS * since_s;
  if (!now.moves) return now;
  const double t_s = std::min(since_s, kExtrapolatedS);
  now.log_ns += now.per_s * t_s;
  now.variance += 2 * now.covariance * t_s + now.speed_variance * squared(t_s) +
                  kSpeedVariancePerS * squared(t_s) * t_s / 3 + squared(now.per_s * (since_s - t_s));
  now.covariance += now.speed_variance * t_s + kSpeedVariancePerS * squared(t_s) / 2;
  now.speed_variance += kSpeedVariancePerS * t_s;
  return now;
}

/// What contradiction and brightness add to the variance.
double ExposureFilter::extra_variance() const {
  const double contradicted = candidate_ ? 0.5 * (candidate_->log_ns - value_->log_ns) : 0;
  return squared(contradicted) + squared(kExposureShare * (brightest_ - darkest_));
}

bool ExposureFilter::follows_candidate(const Value& measured) const {
  if (!candidate_) return false;
  // Auto exposure that converges moves on by a share of what is left: libcamera's on a Raspberry Pi by a fifth at a
  // time (Agc::filterExposure in src/ipa/raspberrypi/controller/rpi/agc.cpp).
  constexpr double kMovesOn = 0.3;
  const double stddev = std::sqrt(candidate_->variance + measured.variance);
  const double apart = std::abs(measured.log_ns - candidate_->log_ns);
  if (!value_) return apart <= kGate * stddev;
  const double before = predicted().log_ns;
  const double from = candidate_->log_ns - before, to = measured.log_ns - before;
  return from * to > 0 && apart <= kGate * stddev + kMovesOn * std::abs(to);
}

void ExposureFilter::update(const Value& measured) {
  constexpr double kSlowPerS = 0.2;  // is not seen above the noise of estimates
  constexpr int kSlowUpdates = 4;
  constexpr double kByExposure = 0.1;  // changes of brightness that are not the scene's
  Value now = predicted();
  const double innovation = measured.log_ns - now.log_ns;
  // Two hypotheses: the scene has changed the brightness, or the exposure has, as one that moves does. The estimate
  // tells how likely each is, and the state becomes the mean and the variance of both.
  const double variance = now.variance, sum = variance + measured.variance;
  const double wide_variance = variance + extra_variance(), wide_sum = wide_variance + measured.variance;
  const double gain = variance / sum, wide_gain = wide_variance / wide_sum;
  const double scene = (1 - kByExposure) * normal_density(innovation, sum);
  const double wide_share = now.moves ? 1 : 1 / (1 + scene / (kByExposure * normal_density(innovation, wide_sum)));
  const double mean_gain = gain + wide_share * (wide_gain - gain);
  now.log_ns += mean_gain * innovation;
  now.per_s += now.covariance / wide_sum * innovation;
  now.speed_variance -= squared(now.covariance) / wide_sum;
  now.covariance *= 1 - wide_gain;
  now.variance = (1 - wide_share) * (1 - gain) * variance + wide_share * (1 - wide_gain) * wide_variance +
                 wide_share * (1 - wide_share) * squared((wide_gain - gain) * innovation);
  now.variance = std::max(now.variance, squared(kLeastStddev));
  now.slow_updates = std::abs(now.per_s) < kSlowPerS ? now.slow_updates + 1 : 0;
  if (now.moves && now.slow_updates >= kSlowUpdates) {
    now.moves = false;
    now.per_s = now.speed_variance = now.covariance = 0;
  }
  value_ = now;
}

/// From the candidate to what follows it.
void ExposureFilter::jump(const Value& from, const Value& measured) {
  const double moved = measured.log_ns - from.log_ns;
  const double since_s = to_seconds(measured.stamp_ns - from.stamp_ns);
  const double sum = from.variance + measured.variance;
  const bool first = !value_;
  value_ = measured;
  if (since_s > 0 && (!first || squared(moved) > 2 * sum)) {
    value_->moves = true;
    value_->per_s = moved / since_s;
    value_->covariance = measured.variance / since_s;
    value_->speed_variance = sum / squared(since_s);
    return;
  }
  value_->log_ns -= measured.variance / sum * moved;
  value_->variance = std::max(from.variance * measured.variance / sum, squared(kLeastStddev));
}

void ExposureFilter::add(TimeNs stamp_ns, TimeNs assumed_ns, const std::optional<ExposureEstimate>& estimate,
                         double mean_brightness) {
  if (stamp_ns_ && stamp_ns < *stamp_ns_) reset();
  const bool looked_at = wants_estimate(), first = !stamp_ns_;
  stamp_ns_ = stamp_ns;
  const double brightness = std::log(std::max(mean_brightness, 1.0));
  darkest_ = first ? brightness : std::min(darkest_, brightness);
  brightest_ = first ? brightness : std::max(brightest_, brightness);
  ++images_since_;
  images_since_look_ = looked_at ? 0 : images_since_look_ + 1;
  if (candidate_ && stamp_ns - candidate_->stamp_ns > kCandidateNs) candidate_.reset();
  if (!estimate) {
    in_vain_ += looked_at ? 1 : 0;
    return;
  }
  in_vain_ = 0;
  const Value measured{stamp_ns, std::log(static_cast<double>(assumed_ns)) + std::log(estimate->ratio),
                       squared(std::max(estimate->log_stddev, kLeastStddev))};
  const bool jumps = follows_candidate(measured);
  const std::optional<Value> candidate = candidate_;
  candidate_.reset();  // it does not widen the gate
  const std::optional<Value> now = value_ ? std::optional<Value>(predicted()) : std::nullopt;
  if (now && squared(measured.log_ns - now->log_ns) <=
                 squared(kGate) * (now->variance + extra_variance() + measured.variance)) {
    update(measured);
  } else if (jumps) {
    jump(*candidate, measured);
  } else {
    candidate_ = measured;
    return;
  }
  darkest_ = brightest_ = brightness;
  images_since_ = 0;
}

std::optional<ExposureFilter::State> ExposureFilter::state() const {
  if (!value_) return std::nullopt;
  const Value now = predicted();
  const double stddev = std::sqrt(now.variance + extra_variance() + squared(kSharedStddev));
  if (stddev > kUnknown) return std::nullopt;
  return State{static_cast<TimeNs>(std::llround(std::exp(now.log_ns))), stddev};
}

bool ExposureFilter::wants_estimate() const {
  // Images that are looked at in vain cost as much as others: less often, the longer that lasts.
  constexpr int kEvery = 6, kEveryUnknown = 3, kInVainPerWait = 4;
  constexpr double kWellKnown = 0.0175;
  if (candidate_) return true;
  const std::optional<State> now = state();
  const bool well_known = now && now->log_stddev <= kWellKnown && !value_->moves;
  if (well_known && images_since_ + 1 < kEvery) return false;
  return images_since_look_ + 1 >= std::min(1 + in_vain_ / kInVainPerWait, now ? kEvery : kEveryUnknown);
}

void ExposureFilter::reset() { *this = ExposureFilter(); }

}  // namespace gyro_deblur
