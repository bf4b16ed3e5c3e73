#include "gyro_deblur/translation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <sstream>
#include <stdexcept>
#include <utility>

namespace gyro_deblur {
namespace {

/// Samples that an extrapolation is drawn through: long enough to average the noise of a fast odometry, short against
/// the swings of a hand or a vehicle.
constexpr TimeNs kSlopeWindowNs = 100'000'000;

/// The same with an accelerometer, which leaves only gravity and its bias to be found.
constexpr TimeNs kGravityWindowNs = 1'000'000'000;
/// Shorter, and noise of the velocities would be taken for gravity: 0.02 m/s over 0.2 s is 0.1 m/s^2.
constexpr TimeNs kMinGravitySpanNs = 200'000'000;
/// Longer holes between readings are not integrated across.
constexpr TimeNs kMaxForceGapNs = 50'000'000;
/// Gravity and bias together are within this of 9.81 m/s^2, or it is no accelerometer, or in other units.
constexpr double kGravity_m_s2 = 9.81, kGravityTolerance_m_s2 = 3;

/// Scatter of a good odometry [m/s]: a smaller step is no jump, however short its time.
constexpr double kVelocityNoise_m_s = 0.1;

/// A velocity in fixed axes.
struct FixedVelocity {
  TimeNs t_ns;
  Eigen::Vector3d velocity_m_s;
};

/// Integral of the specific force from the first reading on, in fixed axes; linear in between.
class ForceIntegral {
 public:
  ForceIntegral(const std::vector<ForceSample>& forces, const RotationTrack& rotation,
                const Eigen::Matrix3d& R_cam_body, TimeNs axes_ns) {
    for (const ForceSample& force : forces) {
      if (!rotation.covers({std::min(force.t_ns, axes_ns), std::max(force.t_ns, axes_ns)})) continue;
      Knot knot{force.t_ns, rotation.homography(force.t_ns, axes_ns) * (R_cam_body * force.force_m_s2),
                Eigen::Vector3d::Zero()};
      if (!knots_.empty()) {
        const Knot& before = knots_.back();
        if (knot.t_ns - before.t_ns > kMaxForceGapNs) {
          knots_.clear();  // what lies before a hole says nothing about what lies behind it
        } else {
          knot.velocity_m_s =
              before.velocity_m_s + 0.5 * to_seconds(knot.t_ns - before.t_ns) * (before.force_m_s2 + knot.force_m_s2);
        }
      }
      knots_.push_back(knot);
    }
  }

  bool covers(TimeNs t_ns) const {
    return knots_.size() >= 2 && knots_.front().t_ns <= t_ns && t_ns <= knots_.back().t_ns;
  }
  /// Precondition of both: covers(t_ns).
  Eigen::Vector3d velocity_m_s(TimeNs t_ns) const {
    const auto [before, part] = find(t_ns);
    const Eigen::Vector3d force_m_s2 = (1 - 0.5 * part) * before->force_m_s2 + 0.5 * part * (before + 1)->force_m_s2;
    return before->velocity_m_s + to_seconds(t_ns - before->t_ns) * force_m_s2;
  }
  Eigen::Vector3d force_m_s2(TimeNs t_ns) const {
    const auto [before, part] = find(t_ns);
    return (1 - part) * before->force_m_s2 + part * (before + 1)->force_m_s2;
  }

 private:
  struct Knot {
    TimeNs t_ns;
    Eigen::Vector3d force_m_s2, velocity_m_s;
  };
  std::pair<std::vector<Knot>::const_iterator, double> find(TimeNs t_ns) const {
    auto after = std::partition_point(knots_.begin() + 1, knots_.end() - 1,
                                      [t_ns](const Knot& knot) { return knot.t_ns < t_ns; });
    const auto before = std::prev(after);
    return {before, static_cast<double>(t_ns - before->t_ns) / static_cast<double>(after->t_ns - before->t_ns)};
  }
  std::vector<Knot> knots_;
};

template <typename... Parts>
std::string line(const Parts&... parts) {
  std::ostringstream text;
  text.precision(4);
  (text << ... << parts);
  return text.str();
}

/// Least-squares line. Precondition: at least two samples with different times.
template <typename Iterator>
BodyVelocity line_through(Iterator begin, Iterator end) {
  const auto count = static_cast<double>(std::distance(begin, end));
  const TimeNs origin_ns = begin->t_ns;
  double mean_s = 0;
  Eigen::Vector3d mean_m_s = Eigen::Vector3d::Zero();
  for (auto it = begin; it != end; ++it) {
    mean_s += to_seconds(it->t_ns - origin_ns) / count;
    mean_m_s += it->velocity_m_s / count;
  }
  double variance_s2 = 0;
  Eigen::Vector3d covariance = Eigen::Vector3d::Zero();
  for (auto it = begin; it != end; ++it) {
    const double offset_s = to_seconds(it->t_ns - origin_ns) - mean_s;
    variance_s2 += offset_s * offset_s;
    covariance += offset_s * (it->velocity_m_s - mean_m_s);
  }
  BodyVelocity fitted;
  fitted.t_ns = origin_ns + to_ns(mean_s);
  fitted.velocity_m_s = mean_m_s;
  fitted.acceleration_m_s2 = covariance / variance_s2;
  return fitted;
}

using Velocities = std::vector<FixedVelocity>::const_iterator;

/// The newest velocities carried on to the middle of a frame by the accelerometer; nothing when it cannot.
std::optional<BodyVelocity> carried_on(Velocities begin, Velocities end, TimeNs middle_ns, const ForceIntegral& force) {
  if (!force.covers(middle_ns)) return std::nullopt;
  std::vector<FixedVelocity> remainders;  // initial velocity and what gravity and bias add
  for (auto it = begin; it != end; ++it) {
    if (it->t_ns < std::prev(end)->t_ns - kGravityWindowNs || !force.covers(it->t_ns)) continue;
    remainders.push_back({it->t_ns, it->velocity_m_s - force.velocity_m_s(it->t_ns)});
  }
  if (remainders.size() < 2 || remainders.back().t_ns - remainders.front().t_ns < kMinGravitySpanNs)
    return std::nullopt;
  const BodyVelocity remainder = line_through(remainders.begin(), remainders.end());
  if (!(std::abs(remainder.acceleration_m_s2.norm() - kGravity_m_s2) <= kGravityTolerance_m_s2)) return std::nullopt;
  BodyVelocity velocity;
  velocity.t_ns = middle_ns;
  velocity.velocity_m_s = remainder.at(middle_ns) + force.velocity_m_s(middle_ns);
  velocity.acceleration_m_s2 = remainder.acceleration_m_s2 + force.force_m_s2(middle_ns);
  return velocity;
}

/// Precondition: at least two velocities.
BodyVelocity at_middle(Velocities begin, Velocities end, TimeNs middle_ns, const ForceIntegral& force) {
  const Velocities after =
      std::partition_point(begin, end, [middle_ns](const FixedVelocity& v) { return v.t_ns < middle_ns; });
  if (after == begin) return line_through(begin, begin + 2);  // all come later: a recording that starts with the frame
  if (after != end) return line_through(std::prev(after), std::next(after));
  if (const std::optional<BodyVelocity> velocity = carried_on(begin, end, middle_ns, force)) return *velocity;
  const Velocities in_window = std::partition_point(
      begin, end, [end](const FixedVelocity& v) { return v.t_ns < std::prev(end)->t_ns - kSlopeWindowNs; });
  return line_through(std::min(in_window, end - 2), end);
}

}  // namespace

Eigen::Vector3d BodyVelocity::at(TimeNs time_ns) const {
  return velocity_m_s + to_seconds(time_ns - t_ns) * acceleration_m_s2;
}

Eigen::Vector3d BodyVelocity::displacement(TimeNs from_ns, TimeNs to_ns) const {
  // Exact: the velocity is linear in time.
  return 0.5 * to_seconds(to_ns - from_ns) * (at(from_ns) + at(to_ns));
}

TimeNs velocity_reach_ns(const TranslationOptions& options) {
  return std::max(2 * options.max_age_ns, options.max_age_ns + kGravityWindowNs);
}

std::optional<BodyVelocity> fit_velocity(const std::vector<VelocitySample>& samples,
                                         const std::vector<ForceSample>& forces, const RotationTrack& rotation,
                                         const Eigen::Matrix3d& R_cam_body, const TimeRange& frame,
                                         const TranslationOptions& options, std::string* reason) {
  const TimeNs middle_ns = frame.begin_ns + (frame.end_ns - frame.begin_ns) / 2;
  const auto refuse = [reason](const std::string& text) -> std::optional<BodyVelocity> {
    *reason = text;
    return std::nullopt;
  };
  if (samples.empty()) return refuse("no odometry");
  if (!rotation.covers(frame)) return refuse("gyroscope samples do not cover the frame");

  // Usable samples in fixed axes, as far back as a second one may be.
  std::vector<FixedVelocity> velocities;
  double worst_stddev_m_s = 0;
  TimeNs nearest_ns = samples.front().t_ns;
  for (const VelocitySample& sample : samples) {
    if (std::abs(sample.t_ns - middle_ns) < std::abs(nearest_ns - middle_ns)) nearest_ns = sample.t_ns;
    if (std::abs(sample.t_ns - middle_ns) > velocity_reach_ns(options)) continue;
    if (!(sample.stddev_m_s <= options.max_stddev_m_s)) {
      worst_stddev_m_s = sample.stddev_m_s;
      continue;
    }
    if (!rotation.covers({std::min(sample.t_ns, frame.begin_ns), std::max(sample.t_ns, frame.end_ns)})) continue;
    velocities.push_back(
        {sample.t_ns, rotation.homography(sample.t_ns, middle_ns) * (R_cam_body * sample.velocity_m_s)});
  }
  if (std::abs(nearest_ns - middle_ns) > options.max_age_ns) {
    return refuse(line("odometry is ", to_seconds(std::abs(middle_ns - nearest_ns)),
                       " s away from the exposure, odometry_max_age = ", to_seconds(options.max_age_ns), " s"));
  }

  // Of two that contradict each other nobody knows which is right: what comes after a jump has to agree once.
  auto begin = velocities.cbegin();
  double jump_m_s = 0;
  for (auto it = begin; it != velocities.cend(); ++it) {
    if (it == velocities.cbegin()) continue;
    const auto before = std::prev(it);
    const double step_m_s = (it->velocity_m_s - before->velocity_m_s).norm();
    if (!(step_m_s <= kVelocityNoise_m_s + options.max_acceleration_m_s2 * to_seconds(it->t_ns - before->t_ns))) {
      jump_m_s = step_m_s;
      begin = it;
    }
  }
  const bool near = std::any_of(begin, velocities.cend(), [&](const FixedVelocity& v) {
    return std::abs(v.t_ns - middle_ns) <= options.max_age_ns;
  });
  if (std::distance(begin, velocities.cend()) < 2 || !near) {
    if (worst_stddev_m_s != 0) {
      return refuse(line("odometry's velocity has a standard deviation of ", worst_stddev_m_s,
                         " m/s, odometry_max_stddev = ", options.max_stddev_m_s, " m/s"));
    }
    if (jump_m_s > 0) {
      return refuse(line("odometry's velocity jumps by ", jump_m_s,
                         " m/s, odometry_max_acceleration = ", options.max_acceleration_m_s2, " m/s^2"));
    }
    return refuse(line("fewer than two velocities of the odometry lie within ", to_seconds(velocity_reach_ns(options)),
                       " s of the exposure and of gyroscope samples without holes"));
  }

  BodyVelocity velocity =
      at_middle(begin, velocities.cend(), middle_ns, ForceIntegral(forces, rotation, R_cam_body, middle_ns));
  velocity.axes_ns = middle_ns;
  const double speed_m_s = velocity.at(middle_ns).norm();
  if (!(speed_m_s <= options.max_speed_m_s)) {
    return refuse(
        line("odometry's speed is ", speed_m_s, " m/s, odometry_max_speed = ", options.max_speed_m_s, " m/s"));
  }
  return velocity;
}

TranslatedMotion::TranslatedMotion(const RotationTrack& rotation, const BodyVelocity& velocity,
                                   const Eigen::Vector3d& p_cam_body_m, double depth_m)
    : rotation_(rotation), velocity_(velocity), p_cam_body_m_(p_cam_body_m), depth_m_(depth_m) {
  if (!(depth_m > 0) || !std::isfinite(depth_m)) {
    throw std::invalid_argument(line("the depth of the scene is ", depth_m, " m, it has to be above 0"));
  }
  if (!velocity.velocity_m_s.allFinite() || !velocity.acceleration_m_s2.allFinite() || !p_cam_body_m.allFinite()) {
    throw std::invalid_argument("the velocity, or the body's place, is not finite");
  }
}

bool TranslatedMotion::covers(const TimeRange& range) const {
  return !range.empty() && rotation_.covers({std::min(range.begin_ns, velocity_.axes_ns),  //
                                             std::max(range.end_ns, velocity_.axes_ns)});
}

Eigen::Matrix3d TranslatedMotion::homography(TimeNs from_ns, TimeNs to_ns) const {
  const Eigen::Matrix3d R_to_from = rotation_.homography(from_ns, to_ns);
  // Path of the camera's origin in the camera's axes at `from`: that of the body, and what turning about it adds.
  const Eigen::Vector3d body_m =
      rotation_.homography(velocity_.axes_ns, from_ns) * velocity_.displacement(from_ns, to_ns);
  const Eigen::Vector3d path_m = body_m + p_cam_body_m_ - R_to_from.transpose() * p_cam_body_m_;
  return R_to_from * (Eigen::Matrix3d::Identity() - path_m * Eigen::RowVector3d::UnitZ() / depth_m_);
}

}  // namespace gyro_deblur
