// Integrates the gyroscope to rotations.
#include "gyro_deblur/rotation_track.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <string>

#include <Eigen/LU>
#include <Eigen/SVD>

#include "base/format.hpp"

namespace gyro_deblur {
namespace {

std::string describe(const TimeRange& range) {
  if (range.empty()) return "nothing";
  return format("[%.9f, %.9f] s", to_seconds(range.begin_ns), to_seconds(range.end_ns));
}

}  // namespace

Eigen::Quaterniond so3_exp(const Eigen::Vector3d& rotation_rad) {
  const double half2 = 0.25 * rotation_rad.squaredNorm();
  // Below this, which 20 rad/s reach from sample to sample at 200 Hz, the series are exact to double precision.
  constexpr double kSmall = 0.05 * 0.05;
  double sinc, cosine;  // sin(half) / half and cos(half)
  if (half2 < kSmall) {
    sinc = 1 - half2 * (1. / 6) * (1 - half2 * (1. / 20) * (1 - half2 * (1. / 42)));
    cosine = 1 - half2 * 0.5 * (1 - half2 * (1. / 12) * (1 - half2 * (1. / 30) * (1 - half2 * (1. / 56))));
  } else {
    const double half = std::sqrt(half2);
    sinc = std::sin(half) / half;
    cosine = std::cos(half);
  }
  const Eigen::Vector3d vector = 0.5 * sinc * rotation_rad;
  return {cosine, vector.x(), vector.y(), vector.z()};
}

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Quaterniond integrate_linear_rate(const Eigen::Vector3d& w0_rad_s, const Eigen::Vector3d& w1_rad_s,
                                         double dt_s) {
  // R' = R [w]x multiplies from the right, so the commutator term has the sign opposite to that of x' = A(t) x.
  return so3_exp(0.5 * dt_s * (w0_rad_s + w1_rad_s) + dt_s * dt_s / 12.0 * w0_rad_s.cross(w1_rad_s));
}

Eigen::Matrix3d require_rotation(const char* name, const Eigen::Matrix3d& R) {
  const double determinant = R.determinant();
  const char* reason = " and is not orthonormal to within 1e-3";
  if (R.allFinite()) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Matrix3d nearest = svd.matrixU() * svd.matrixV().transpose();
    if ((R - nearest).cwiseAbs().maxCoeff() <= 1e-3) {
      if (determinant > 0) return nearest;
      reason = ": it mirrors (an axis has the wrong sign, or two axes are swapped)";
    }
  }
  throw OptionError(format("%s has determinant %g%s; expected a rotation, determinant +1", name, determinant, reason));
}

bool is_saturated(const GyroSample& sample, const GyroOptions& options) {
  // Room for rounding, and for a clipped value of one count less than full scale (16 bit: 0.003 %).
  constexpr double kSaturatedPart = 0.999;
  return options.range_rad_s > 0 && sample.rate_rad_s.cwiseAbs().maxCoeff() >= kSaturatedPart * options.range_rad_s;
}

RotationTrack::RotationTrack(const std::vector<GyroSample>& samples, const GyroOptions& options,
                             const Eigen::Matrix3d& R_cam_imu, std::size_t origin) {
  if (origin > 0 && origin >= samples.size()) {
    throw std::invalid_argument("RotationTrack: the origin is sample " + std::to_string(origin) + " of " +
                                std::to_string(samples.size()));
  }
  options.validate();
  const Eigen::Matrix3d R = require_rotation("R_cam_imu", R_cam_imu);
  knots_.reserve(samples.size());
  bool previous_saturated = false;
  for (const GyroSample& sample : samples) {
    if (!sample.rate_rad_s.allFinite()) {
      throw std::invalid_argument("RotationTrack: the gyroscope sample at " + std::to_string(sample.t_ns) +
                                  " ns is not finite");
    }
    // Rates in camera axes give the rotation of the camera: R Exp(v) R^T = Exp(R v).
    const Eigen::Vector3d rate_rad_s = R * (sample.rate_rad_s - options.bias_rad_s);
    const bool saturated = is_saturated(sample, options);
    // 16 g is the widest range of common IMUs (BMI085, ICM-20948); more is an error.
    constexpr double kMostForce_m_s2 = 160;
    Knot knot{sample.t_ns - options.time_offset_ns, Eigen::Quaterniond::Identity(), rate_rad_s,
              R * sample.specific_force_m_s2, false};
    if (!(knot.specific_force_m_s2.cwiseAbs().maxCoeff() <= kMostForce_m_s2)) {
      knot.specific_force_m_s2.setConstant(std::numeric_limits<double>::quiet_NaN());
    }
    if (!knots_.empty()) {
      const Knot& previous = knots_.back();
      if (knot.t_ns <= previous.t_ns) {
        throw std::invalid_argument("RotationTrack: gyroscope samples must increase in time, but " +
                                    std::to_string(sample.t_ns) + " ns follows " +
                                    std::to_string(previous.t_ns + options.time_offset_ns) + " ns");
      }
      if (knot.t_ns - previous.t_ns > options.max_gap_ns || saturated || previous_saturated) {
        holes_.push_back({previous.t_ns, knot.t_ns});
        knot.follows_hole = true;
      }
    }
    knots_.push_back(knot);
    previous_saturated = saturated;
  }
  if (knots_.empty()) return;
  // Nobody may ask across a hole, so only orientations relative to each other on one side of it matter.
  const auto rotation_between = [](const Knot& from, const Knot& to) {
    return integrate_linear_rate(from.rate_rad_s, to.rate_rad_s, to_seconds(to.t_ns - from.t_ns));
  };
  for (std::size_t i = origin + 1; i < knots_.size(); ++i) {
    const Knot& before = knots_[i - 1];
    Knot& knot = knots_[i];
    knot.R_0_cam = knot.follows_hole ? before.R_0_cam : (before.R_0_cam * rotation_between(before, knot)).normalized();
  }
  for (std::size_t i = origin; i > 0; --i) {
    Knot& knot = knots_[i - 1];
    const Knot& after = knots_[i];
    knot.R_0_cam =
        after.follows_hole ? after.R_0_cam : (after.R_0_cam * rotation_between(knot, after).conjugate()).normalized();
  }
}

TimeRange RotationTrack::available() const {
  if (knots_.empty()) return {};
  return {knots_.front().t_ns, knots_.back().t_ns};
}

bool RotationTrack::covers(const TimeRange& range) const {
  if (!available().contains(range)) return false;
  // A hole ends at samples, which do not belong to it.
  const auto hole = std::partition_point(holes_.begin(), holes_.end(),
                                         [&](const TimeRange& h) { return h.end_ns <= range.begin_ns; });
  return hole == holes_.end() || range.end_ns <= hole->begin_ns;
}

void RotationTrack::require_covered(const TimeRange& range) const {
  if (covers(range)) return;
  std::string message = "gyroscope: " + describe(range) + " was asked for, " + describe(available()) + " is available";
  for (const TimeRange& hole : holes_) {
    if (hole.begin_ns < range.end_ns && hole.end_ns > range.begin_ns) message += ", less the hole " + describe(hole);
  }
  throw std::out_of_range(message);
}

Eigen::Quaterniond RotationTrack::interpolate(TimeNs t_ns) const {
  const auto after =
      std::lower_bound(knots_.begin(), knots_.end(), t_ns, [](const Knot& knot, TimeNs t) { return knot.t_ns < t; });
  if (after->t_ns == t_ns) return after->R_0_cam;
  const auto before = std::prev(after);
  const double fraction = static_cast<double>(t_ns - before->t_ns) / static_cast<double>(after->t_ns - before->t_ns);
  const Eigen::Vector3d rate_rad_s = before->rate_rad_s + fraction * (after->rate_rad_s - before->rate_rad_s);
  return before->R_0_cam * integrate_linear_rate(before->rate_rad_s, rate_rad_s, to_seconds(t_ns - before->t_ns));
}

Eigen::Matrix3d RotationTrack::rotation(TimeNs from_ns, TimeNs to_ns) const {
  require_covered({std::min(from_ns, to_ns), std::max(from_ns, to_ns)});
  return (interpolate(to_ns).conjugate() * interpolate(from_ns)).toRotationMatrix();
}

std::optional<VelocityGain> RotationTrack::velocity_gain(TimeNs from_ns, TimeNs to_ns) const {
  if (from_ns >= to_ns || !covers({from_ns, to_ns})) return std::nullopt;
  const Eigen::Quaterniond R_end_0 = interpolate(to_ns).conjugate();
  auto next =
      std::upper_bound(knots_.begin(), knots_.end(), from_ns, [](TimeNs t, const Knot& knot) { return t < knot.t_ns; });
  const auto force_m_s2 = [&](TimeNs t_ns) -> Eigen::Vector3d {
    const Knot& before = *std::prev(next);
    const double part = static_cast<double>(t_ns - before.t_ns) / static_cast<double>(next->t_ns - before.t_ns);
    return R_end_0 * interpolate(t_ns) *
           (before.specific_force_m_s2 + part * (next->specific_force_m_s2 - before.specific_force_m_s2));
  };
  // From sample to sample by trapezoids; what is gained in one counts from its middle on.
  Eigen::Vector3d total_m_s = Eigen::Vector3d::Zero(), way_m = Eigen::Vector3d::Zero();
  for (TimeNs t_ns = from_ns; t_ns < to_ns; ++next) {
    const TimeNs end_ns = std::min(next->t_ns, to_ns);
    const Eigen::Vector3d gained_m_s = 0.5 * to_seconds(end_ns - t_ns) * (force_m_s2(t_ns) + force_m_s2(end_ns));
    total_m_s += gained_m_s;
    way_m += (to_seconds(to_ns - end_ns) + 0.5 * to_seconds(end_ns - t_ns)) * gained_m_s;
    t_ns = end_ns;
  }
  if (!total_m_s.allFinite()) return std::nullopt;
  return VelocityGain{total_m_s, way_m / to_seconds(to_ns - from_ns)};
}

}  // namespace gyro_deblur
