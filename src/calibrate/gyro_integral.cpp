// Integrates gyroscope samples.
#include "calibrate/gyro_integral.hpp"

#include <algorithm>
#include <iterator>

namespace gyro_deblur {
namespace {

/// Distance of the integrals that are kept of a fast gyroscope: a hand's rate changes by at most 0.25 rad/s within it.
constexpr TimeNs kKnotStepNs = 2'500'000;
constexpr TimeNs kLongestGapNs = 50'000'000;
constexpr TimeNs kJumpNs = 1'000'000'000;

}  // namespace

void GyroIntegral::add(const GyroSample& sample) {
  if (!sample.rate_rad_s.allFinite()) return;
  if (!knots_.empty() && sample.t_ns < newest_.t_ns - kJumpNs) clear();
  if (knots_.empty()) {
    newest_ = {sample.t_ns, Eigen::Vector3d::Zero(), sample.rate_rad_s, sample.t_ns};
    knots_.push_back(newest_);
    return;
  }
  const TimeNs step_ns = sample.t_ns - newest_.t_ns;
  if (step_ns <= 0) return;
  const bool hole = step_ns > kLongestGapNs;
  newest_ = {sample.t_ns, newest_.integral_rad + 0.5 * to_seconds(step_ns) * (newest_.rate_rad_s + sample.rate_rad_s),
             sample.rate_rad_s, hole ? sample.t_ns : newest_.whole_since_ns};
  if (!hole && newest_.t_ns - knots_.back().t_ns < kKnotStepNs) return;
  knots_.push_back(newest_);
  while (newest_.t_ns - knots_.front().t_ns > kept_ns_) knots_.pop_front();
}

TimeRange GyroIntegral::available() const {
  return knots_.empty() ? TimeRange{} : TimeRange{knots_.front().t_ns, knots_.back().t_ns};
}

std::deque<GyroIntegral::Knot>::const_iterator GyroIntegral::first_from(TimeNs t_ns) const {
  return std::lower_bound(knots_.begin(), knots_.end(), t_ns, [](const Knot& knot, TimeNs t) { return knot.t_ns < t; });
}

bool GyroIntegral::covers(const TimeRange& range) const {
  return available().contains(range) && first_from(range.end_ns)->whole_since_ns <= range.begin_ns;
}

Eigen::Vector3d GyroIntegral::integral_at(TimeNs t_ns) const {
  const auto after = first_from(t_ns);
  if (after->t_ns == t_ns) return after->integral_rad;
  const auto before = std::prev(after);
  // Cubic: integrals and rates of both ends.
  const double step_s = to_seconds(after->t_ns - before->t_ns), u = to_seconds(t_ns - before->t_ns) / step_s;
  const double v = 1 - u;
  return v * v * (1 + 2 * u) * before->integral_rad + u * u * (3 - 2 * u) * after->integral_rad +
         step_s * u * v * (v * before->rate_rad_s - u * after->rate_rad_s);
}

Eigen::Vector3d GyroIntegral::mean_rate(const TimeRange& range) const {
  return (integral_at(range.end_ns) - integral_at(range.begin_ns)) / to_seconds(range.end_ns - range.begin_ns);
}

}  // namespace gyro_deblur
