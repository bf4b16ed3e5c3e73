#include "gyro_deblur/exposure_filter.hpp"

#include <algorithm>
#include <cmath>

namespace gyro_deblur {
namespace {

double squared(double x) { return x * x; }

// Estimates of consecutive images share their texture, and with it part of their error: more of them do not tell more.
constexpr double kLeastStddev = 0.007;
// Farther from the state than this many standard deviations, an estimate contradicts it.
constexpr double kGate = 3;
// Of an exposure at rest: 1 % after a second, a quarter after ten minutes.
constexpr double kRestVariancePerS = 1e-4;
// An estimate that contradicts the state is forgotten after this time.
constexpr TimeNs kCandidateNs = 1'000'000'000;
// The part of a change of brightness that may come from the exposure rather than the scene: one standard deviation.
constexpr double kExposureShare = 0.3;
// More than this standard deviation is not known.
constexpr double kUnknown = 0.25;

}  // namespace

double ExposureFilter::variance_now() const {
  const double since_s = to_seconds(*stamp_ns_ - value_->stamp_ns);
  const double contradicted = candidate_ ? 0.5 * (candidate_->log_ns - value_->log_ns) : 0;
  return value_->variance + kRestVariancePerS * since_s + squared(speed_per_s_ * since_s) + squared(contradicted) +
         squared(kExposureShare * (brightest_ - darkest_));
}

bool ExposureFilter::follows_candidate(const Value& measured) const {
  if (!candidate_) return false;
  // Auto exposure that converges moves on by a share of what is left: libcamera's by a
  // fifth at a time (filterExposure in src/ipa/ipu3/algorithms/agc.cpp).
  constexpr double kMovesOn = 0.3;
  const double stddev = std::sqrt(candidate_->variance + measured.variance);
  const double apart = std::abs(measured.log_ns - candidate_->log_ns);
  if (!value_) return apart <= kGate * stddev;
  const double from = candidate_->log_ns - value_->log_ns, to = measured.log_ns - value_->log_ns;
  return from * to > 0 && apart <= kGate * stddev + kMovesOn * std::abs(to);
}

void ExposureFilter::update(const Value& measured) {
  constexpr double kMoves = 2;          // standard deviations, of an exposure that is not at rest
  constexpr double kSlowsDown = 0.7;    // from estimate to estimate that shows no movement
  constexpr double kAtRestPerS = 0.02;  // is not seen above the noise of estimates
  const double predicted = variance_now(), innovation = measured.log_ns - value_->log_ns;
  const double gain = predicted / (predicted + measured.variance);
  const double since_s = to_seconds(measured.stamp_ns - value_->stamp_ns);
  speed_per_s_ *= kSlowsDown;
  if (squared(innovation) > squared(kMoves) * (value_->variance + measured.variance) && since_s > 0) {
    speed_per_s_ = std::max(speed_per_s_, std::abs(innovation) / since_s);
  }
  if (speed_per_s_ < kAtRestPerS) speed_per_s_ = 0;
  value_ = Value{value_->log_ns + gain * innovation, std::max((1 - gain) * predicted, squared(kLeastStddev)),
                 measured.stamp_ns};
}

void ExposureFilter::jump(const Value& measured) {
  const double moved = measured.log_ns - candidate_->log_ns;
  const double since_s = to_seconds(measured.stamp_ns - candidate_->stamp_ns);
  const bool moving = squared(moved) > candidate_->variance + measured.variance && value_ && since_s > 0;
  speed_per_s_ = moving ? std::abs(moved) / since_s : 0;
  const double before = candidate_->variance + squared(moved), sum = before + measured.variance;
  value_ = Value{measured.log_ns - measured.variance / sum * moved,
                 std::max(before * measured.variance / sum, squared(kLeastStddev)), measured.stamp_ns};
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
  if (candidate_ && stamp_ns - candidate_->stamp_ns > kCandidateNs) candidate_.reset();
  if (!estimate) {
    in_vain_ += looked_at ? 1 : 0;
    return;
  }
  in_vain_ = 0;
  const Value measured{std::log(static_cast<double>(assumed_ns)) + std::log(estimate->ratio),
                       squared(std::max(estimate->log_stddev, kLeastStddev)), stamp_ns};
  const std::optional<Value> candidate = candidate_;
  const bool jumps = follows_candidate(measured);
  candidate_.reset();  // it does not widen the gate
  const double apart = value_ ? measured.log_ns - value_->log_ns : 0;
  if (value_ && squared(apart) <= squared(kGate) * (variance_now() + measured.variance)) {
    update(measured);
  } else if (jumps) {
    candidate_ = candidate;
    jump(measured);
    candidate_.reset();
  } else {
    candidate_ = measured;
    return;
  }
  darkest_ = brightest_ = brightness;
  images_since_ = 0;
}

std::optional<ExposureFilter::State> ExposureFilter::state() const {
  if (!value_) return std::nullopt;
  const double stddev = std::sqrt(variance_now());
  if (stddev > kUnknown) return std::nullopt;
  return State{static_cast<TimeNs>(std::llround(std::exp(value_->log_ns))), stddev};
}

bool ExposureFilter::wants_estimate() const {
  // Images that are looked at in vain cost as much as others: less often, the longer that lasts.
  constexpr int kEvery = 8, kEveryUnknown = 3, kInVainPerWait = 4;
  constexpr double kWellKnown = 0.02;
  const std::optional<State> now = state();
  const int longest = now ? kEvery : kEveryUnknown;
  const bool well_known = now && now->log_stddev <= kWellKnown && speed_per_s_ == 0;
  const int every = well_known ? kEvery : std::min(1 + in_vain_ / kInVainPerWait, longest);
  return candidate_ || (images_since_ + 1) % every == 0;
}

void ExposureFilter::reset() { *this = ExposureFilter(); }

}  // namespace gyro_deblur
