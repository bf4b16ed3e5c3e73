// The motions that the simulator offers.
#include "sim/motion.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <locale>
#include <sstream>
#include <utility>

#include "base/require_range.hpp"
#include "gyro_deblur/options.hpp"

namespace gyro_deblur::sim {
namespace {

// Step of the integration of a recorded gyroscope. Its error a second is dt^2 |w x dw/dt| / 12, below 1e-5 rad for
// 10 rad/s and 300 rad/s^2.
constexpr double kTraceStepS = 2e-4;

Eigen::Quaterniond exp_rotation(const Eigen::Vector3d& v) {
  const double angle = v.norm();
  if (angle == 0) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, v / angle));
}

Eigen::Vector3d log_rotation(const Eigen::Quaterniond& q) {
  const Eigen::AngleAxisd aa(q.w() < 0 ? Eigen::Quaterniond(-q.coeffs()) : q);
  return aa.angle() * aa.axis();
}

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

// For R = Exp(v(t)), the body rate is right_jacobian(v) dv/dt.
Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& v) {
  const double a2 = v.squaredNorm();
  const Eigen::Matrix3d k = cross_matrix(v);
  if (a2 < 1e-8) return Eigen::Matrix3d::Identity() - 0.5 * k + k * k / 6;  // next term below 1e-12
  const double a = std::sqrt(a2);
  return Eigen::Matrix3d::Identity() - (1 - std::cos(a)) / a2 * k + (a - std::sin(a)) / (a2 * a) * k * k;
}

// Index of the interval [times[i], times[i + 1]] that holds t.
std::size_t interval(const std::vector<double>& times, double t) {
  const auto it = std::upper_bound(times.begin(), times.end(), t);
  const std::size_t above = static_cast<std::size_t>(it - times.begin());
  return std::min(above == 0 ? 0 : above - 1, times.size() - 2);
}

// Natural cubic spline of a 3-vector: twice continuously differentiable. Needs two times or more, strictly increasing.
class CubicSpline {
 public:
  CubicSpline(std::vector<double> times_s, std::vector<Eigen::Vector3d> values)
      : times_(std::move(times_s)), values_(std::move(values)), curvatures_(times_.size(), Eigen::Vector3d::Zero()) {
    // Tridiagonal system of the second derivatives, zero at both ends (Thomas algorithm).
    const std::size_t n = times_.size();
    std::vector<double> upper(n, 0.0);
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double before = times_[i] - times_[i - 1], after = times_[i + 1] - times_[i];
      const double pivot = 2 * (before + after) - before * upper[i - 1];
      upper[i] = after / pivot;
      const Eigen::Vector3d slope_change =
          (values_[i + 1] - values_[i]) / after - (values_[i] - values_[i - 1]) / before;
      curvatures_[i] = (6 * slope_change - before * curvatures_[i - 1]) / pivot;
    }
    for (std::size_t i = n - 1; i-- > 1;) curvatures_[i] -= upper[i] * curvatures_[i + 1];
  }

  Eigen::Vector3d evaluate(double t, int derivative) const {
    const std::size_t i = interval(times_, t);
    const double h = times_[i + 1] - times_[i], b = (t - times_[i]) / h, a = 1 - b;
    const Eigen::Vector3d &y0 = values_[i], &y1 = values_[i + 1], &c0 = curvatures_[i], &c1 = curvatures_[i + 1];
    if (derivative == 0) return a * y0 + b * y1 + h * h / 6 * ((a * a * a - a) * c0 + (b * b * b - b) * c1);
    if (derivative == 1) return (y1 - y0) / h + h / 6 * ((1 - 3 * a * a) * c0 + (3 * b * b - 1) * c1);
    return a * c0 + b * c1;
  }

 private:
  std::vector<double> times_;
  std::vector<Eigen::Vector3d> values_, curvatures_;
};

class CurveMotion : public Motion {
 public:
  CurveMotion(VectorCurve rotation, VectorCurve position)
      : rotation_(std::move(rotation)), position_(std::move(position)) {}

  Pose pose(double t) const override { return {exp_rotation(rotation_.evaluate(t, 0)), position_.evaluate(t, 0)}; }
  Eigen::Vector3d rate(double t) const override {
    return right_jacobian(rotation_.evaluate(t, 0)) * rotation_.evaluate(t, 1);
  }
  Eigen::Vector3d acceleration(double t) const override { return position_.evaluate(t, 2); }

 private:
  VectorCurve rotation_, position_;
};

class ConstantRateMotion : public Motion {
 public:
  ConstantRateMotion(const Eigen::Quaterniond& R_world_cam_0, const Eigen::Vector3d& rate, VectorCurve position)
      : R_world_cam_0_(R_world_cam_0), rate_(rate), position_(std::move(position)) {}

  Pose pose(double t) const override { return {R_world_cam_0_ * exp_rotation(rate_ * t), position_.evaluate(t, 0)}; }
  Eigen::Vector3d rate(double) const override { return rate_; }
  Eigen::Vector3d acceleration(double t) const override { return position_.evaluate(t, 2); }

 private:
  Eigen::Quaterniond R_world_cam_0_;
  Eigen::Vector3d rate_;
  VectorCurve position_;
};

class GyroTraceMotion final : public Motion {
 public:
  GyroTraceMotion(const std::vector<TraceSample>& samples, double start_s, double scale,
                  const Eigen::Matrix3d& R_cam_imu, const Eigen::Quaterniond& R_world_cam_0, VectorCurve position)
      : position_(std::move(position)) {
    for (const TraceSample& s : samples) {
      times_.push_back(s.t_s - start_s);
      rates_.push_back(scale * (R_cam_imu * s.rate_rad_s));
    }
    const std::size_t steps = static_cast<std::size_t>(std::max(0.0, times_.back()) / kTraceStepS);
    knots_.reserve(steps + 1);
    knots_.push_back(R_world_cam_0.normalized());
    for (std::size_t i = 0; i < steps; ++i) {
      const double t = kTraceStepS * static_cast<double>(i);
      knots_.push_back((knots_.back() * step(t, kTraceStepS)).normalized());
    }
  }

  Span span() const override { return {0, times_.back()}; }
  Pose pose(double t) const override {
    const std::size_t i = std::min(static_cast<std::size_t>(std::max(0.0, t / kTraceStepS)), knots_.size() - 1);
    const double t0 = kTraceStepS * static_cast<double>(i);
    return {knots_[i] * step(t0, t - t0), position_.evaluate(t, 0)};
  }
  Eigen::Vector3d rate(double t) const override {
    const std::size_t i = interval(times_, t);
    const double a = (t - times_[i]) / (times_[i + 1] - times_[i]);
    return (1 - a) * rates_[i] + a * rates_[i + 1];
  }
  Eigen::Vector3d acceleration(double t) const override { return position_.evaluate(t, 2); }

 private:
  Eigen::Quaterniond step(double t, double dt) const { return exp_rotation(rate(t + dt / 2) * dt); }

  std::vector<double> times_;
  std::vector<Eigen::Vector3d> rates_;     // camera frame
  std::vector<Eigen::Quaterniond> knots_;  // R_world_cam every kTraceStepS from scene time 0
  VectorCurve position_;
};

class TrajectoryMotion : public Motion {
 public:
  TrajectoryMotion(const std::vector<TrajectorySample>& samples, double start_s)
      : position_(positions(samples, start_s)) {
    const std::size_t n = samples.size();
    std::vector<Eigen::Vector3d> mean_rate(n - 1);  // of each interval
    for (std::size_t i = 0; i < n; ++i) {
      times_.push_back(samples[i].t_s - start_s);
      R_world_cam_.push_back(samples[i].pose.R_world_cam.normalized());
    }
    for (std::size_t i = 0; i + 1 < n; ++i) {
      rotation_.push_back(log_rotation(R_world_cam_[i].conjugate() * R_world_cam_[i + 1]));
      mean_rate[i] = rotation_[i] / (times_[i + 1] - times_[i]);
    }
    rates_.push_back(mean_rate.front());
    for (std::size_t i = 1; i + 1 < n; ++i) {
      const double before = times_[i] - times_[i - 1], after = times_[i + 1] - times_[i];
      rates_.push_back((after * mean_rate[i - 1] + before * mean_rate[i]) / (before + after));
    }
    rates_.push_back(mean_rate.back());
  }

  Span span() const override { return {times_.front(), times_.back()}; }
  Pose pose(double t) const override {
    const std::size_t i = interval(times_, t);
    return {R_world_cam_[i] * exp_rotation(local(i, t, 0)), position_.evaluate(t, 0)};
  }
  Eigen::Vector3d rate(double t) const override {
    const std::size_t i = interval(times_, t);
    return right_jacobian(local(i, t, 0)) * local(i, t, 1);
  }
  Eigen::Vector3d acceleration(double t) const override { return position_.evaluate(t, 2); }

 private:
  static CubicSpline positions(const std::vector<TrajectorySample>& samples, double start_s) {
    std::vector<double> times;
    std::vector<Eigen::Vector3d> values;
    for (const TrajectorySample& s : samples) {
      times.push_back(s.t_s - start_s);
      values.push_back(s.pose.p_world_m);
    }
    return CubicSpline(std::move(times), std::move(values));
  }

  // Rotation vector from sample i, or its derivative: cubic Hermite from 0 to rotation_[i] with both samples' rates.
  Eigen::Vector3d local(std::size_t i, double t, int derivative) const {
    const double h = times_[i + 1] - times_[i], s = (t - times_[i]) / h;
    const Eigen::Vector3d v0 = h * rates_[i];
    const Eigen::Vector3d v1 = h * (right_jacobian(rotation_[i]).inverse() * rates_[i + 1]);
    if (derivative == 0) return s * (1 - s) * ((1 - s) * v0 - s * v1) + s * s * (3 - 2 * s) * rotation_[i];
    return ((1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1 + 6 * s * (1 - s) * rotation_[i]) / h;
  }

  std::vector<double> times_;
  std::vector<Eigen::Quaterniond> R_world_cam_;
  std::vector<Eigen::Vector3d> rotation_;  // rotation vector from sample i to i + 1
  std::vector<Eigen::Vector3d> rates_;     // body rate at sample i
  CubicSpline position_;
};

class OrbitMotion : public Motion {
 public:
  explicit OrbitMotion(const Orbit& orbit) : orbit_(orbit) {}

  Pose pose(double t) const override {
    const Eigen::Quaterniond R(Eigen::AngleAxisd(angle(t, 0), orbit_.axis));
    return {R, orbit_.center_m + R * Eigen::Vector3d(0, 0, -orbit_.radius_m)};
  }
  // The axis is fixed both in the world and in the camera: the camera rotates about it.
  Eigen::Vector3d rate(double t) const override { return angle(t, 1) * orbit_.axis; }
  Eigen::Vector3d acceleration(double t) const override {
    const Eigen::Vector3d arm = pose(t).p_world_m - orbit_.center_m;
    const double w = angle(t, 1);
    return angle(t, 2) * orbit_.axis.cross(arm) + w * w * orbit_.axis.cross(orbit_.axis.cross(arm));
  }

 private:
  double angle(double t, int derivative) const {
    const double w = 2 * M_PI * orbit_.frequency_hz;
    if (derivative == 0) return orbit_.rate_rad_s * t + orbit_.amplitude_rad * std::sin(w * t);
    if (derivative == 1) return orbit_.rate_rad_s + orbit_.amplitude_rad * w * std::cos(w * t);
    return -orbit_.amplitude_rad * w * w * std::sin(w * t);
  }

  Orbit orbit_;
};

// The numbers of each line that is not a comment, with FILE:LINE for messages.
struct NumberLine {
  std::string where;
  std::vector<double> numbers;
};

std::vector<NumberLine> read_number_lines(const std::string& path, std::size_t min_columns, const char* columns) {
  std::ifstream file(path);
  if (!file) throw OptionError(path + ": cannot be read");
  std::vector<NumberLine> lines;
  std::string text;
  for (int number = 1; std::getline(file, text); ++number) {
    std::replace_if(
        text.begin(), text.end(), [](char c) { return c == ',' || c == '\r'; }, ' ');
    const std::size_t first = text.find_first_not_of(" \t");
    if (first == std::string::npos || text[first] == '#') continue;
    NumberLine line;
    line.where = path + ":" + std::to_string(number) + ": ";
    std::istringstream words(text);
    std::string word;
    while (words >> word) {
      std::istringstream stream(word);
      stream.imbue(std::locale::classic());
      double value = 0;
      if (!(stream >> value) || !stream.eof() || !std::isfinite(value)) {
        throw OptionError(line.where + "'" + word + "' is not a finite number");
      }
      line.numbers.push_back(value);
    }
    if (line.numbers.size() < min_columns) {
      throw OptionError(line.where + std::to_string(line.numbers.size()) + " columns, expected at least " +
                        std::to_string(min_columns) + ": " + columns);
    }
    lines.push_back(std::move(line));
  }
  if (lines.size() < 2) {
    throw OptionError(path + ": " + std::to_string(lines.size()) + " lines of numbers, expected at least 2");
  }
  for (std::size_t i = 1; i < lines.size(); ++i) {
    if (!(lines[i].numbers[0] > lines[i - 1].numbers[0])) {
      throw OptionError(lines[i].where + "time is not later than that of the line before");
    }
  }
  return lines;
}

}  // namespace

Eigen::Vector3d Sine::evaluate(double t, int derivative) const {
  const double w = 2 * M_PI * frequency_hz, s = std::sin(w * t + phase_rad), c = std::cos(w * t + phase_rad);
  const double f[3] = {s, w * c, -w * w * s};
  if (!window) return f[derivative] * amplitude;
  if (t <= window->begin_s || t >= window->end_s) return Eigen::Vector3d::Zero();
  const double k = M_PI / (window->end_s - window->begin_s), x = k * (t - window->begin_s);
  const double sx = std::sin(x), cx = std::cos(x), s2 = sx * sx;
  const double g[3] = {s2 * s2, 4 * k * s2 * sx * cx, 4 * k * k * s2 * (3 * cx * cx - s2)};
  if (derivative == 0) return g[0] * f[0] * amplitude;
  if (derivative == 1) return (g[1] * f[0] + g[0] * f[1]) * amplitude;
  return (g[2] * f[0] + 2 * g[1] * f[1] + g[0] * f[2]) * amplitude;
}

Eigen::Vector3d VectorCurve::evaluate(double t, int derivative) const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  if (derivative == 0) sum = offset + rate * t;
  if (derivative == 1) sum = rate;
  for (const Sine& sine : sines) sum += sine.evaluate(t, derivative);
  return sum;
}

std::unique_ptr<Motion> make_curve_motion(const VectorCurve& rotation_rad, const VectorCurve& position_m) {
  return std::make_unique<CurveMotion>(rotation_rad, position_m);
}

std::unique_ptr<Motion> make_constant_rate_motion(const Eigen::Quaterniond& R_world_cam_0,
                                                  const Eigen::Vector3d& rate_rad_s, const VectorCurve& position_m) {
  return std::make_unique<ConstantRateMotion>(R_world_cam_0, rate_rad_s, position_m);
}

std::unique_ptr<Motion> make_gyro_trace_motion(const std::vector<TraceSample>& samples, double start_s, double scale,
                                               const Eigen::Matrix3d& R_cam_imu,
                                               const Eigen::Quaterniond& R_world_cam_0, const VectorCurve& position_m) {
  return std::make_unique<GyroTraceMotion>(samples, start_s, scale, R_cam_imu, R_world_cam_0, position_m);
}

std::unique_ptr<Motion> make_trajectory_motion(const std::vector<TrajectorySample>& samples, double start_s) {
  return std::make_unique<TrajectoryMotion>(samples, start_s);
}

std::unique_ptr<Motion> make_orbit_motion(const Orbit& orbit) { return std::make_unique<OrbitMotion>(orbit); }

std::vector<TraceSample> load_gyro_trace(const std::string& path) {
  const std::vector<NumberLine> lines = read_number_lines(path, 4, "t_ns wx wy wz");
  std::vector<TraceSample> samples;
  for (const NumberLine& line : lines) {
    const std::vector<double>& n = line.numbers;
    samples.push_back({(n[0] - lines.front().numbers[0]) * 1e-9, Eigen::Vector3d(n[1], n[2], n[3])});
  }
  return samples;
}

std::vector<TrajectorySample> load_trajectory(const std::string& path) {
  constexpr double kMaxNormError = 0.01;  // files are printed with few digits
  const std::vector<NumberLine> lines = read_number_lines(path, 8, "t x y z qx qy qz qw");
  std::vector<TrajectorySample> samples;
  for (const NumberLine& line : lines) {
    const std::vector<double>& n = line.numbers;
    TrajectorySample s;
    s.t_s = n[0] - lines.front().numbers[0];
    s.pose.p_world_m = Eigen::Vector3d(n[1], n[2], n[3]);
    s.pose.R_world_cam = Eigen::Quaterniond(n[7], n[4], n[5], n[6]);
    require_range((line.where + "length of the quaternion").c_str(), s.pose.R_world_cam.norm(), 1 - kMaxNormError,
                  1 + kMaxNormError);
    s.pose.R_world_cam.normalize();
    samples.push_back(s);
  }
  return samples;
}

}  // namespace gyro_deblur::sim
