#include "calibrate/timing_calibration.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <string>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include "base/median.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

constexpr std::size_t kMinPairs = 10;
constexpr std::size_t kMinPointsOfPair = 8;
constexpr double kMinCorrelation = 0.5;
constexpr TimeNs kSearchStepNs = 1'000'000;
/// Offset and readout move by no more than this after the search.
constexpr TimeNs kMarginNs = 30'000'000;
constexpr TimeNs kLongestReadoutNs = 1'000'000'000;

Eigen::Vector3d log_rotation(const Eigen::Matrix3d& R) {
  const Eigen::AngleAxisd rotation(R);
  return rotation.angle() * rotation.axis();
}

/// The rotation R that minimises sum of weight |b - R a|^2 (Wahba's problem; Markley's SVD solution).
/// @param moment  sum of weight * b a^T
Eigen::Matrix3d solve_wahba(const Eigen::Matrix3d& moment) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = svd.matrixU().determinant() * svd.matrixV().determinant();
  return svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
}

/// A point with its rays; what does not change during the estimation.
struct Point {
  std::size_t pair;
  double from_row_px, to_row_px;
  Eigen::Vector3d from_ray;
  Eigen::Vector2d from_px, to_px;
};

struct State {
  double time_offset_s, readout_s;
  Eigen::Vector3d bias_rad_s;
  Eigen::Matrix3d R_cam_imu;
};

/// The residuals near a state, robustly weighted.
struct Linearisation {
  Eigen::MatrixXd J;        ///< zero where a residual cannot be used
  Eigen::VectorXd weights;  ///< of Cauchy's loss; 0 where a residual cannot be used
  Eigen::MatrixXd H;        ///< J^T weights J

  Eigen::VectorXd weighted(const Eigen::VectorXd& r) const {
    return (weights.array() > 0).select(weights.array() * r.array(), 0.0).matrix();
  }
};

/// Everything about one recording.
class Problem {
 public:
  Problem(const Camera& camera, const std::vector<FramePair>& pairs, const std::vector<GyroSample>& samples,
          const TimingOptions& options)
      : camera_(camera), pairs_(pairs), samples_(samples), options_(options) {}

  TimingEstimate solve();

 private:
  RotationTrack track(const State& state) const {
    GyroOptions gyro;
    gyro.bias_rad_s = state.bias_rad_s;
    gyro.time_offset_ns = to_ns(state.time_offset_s);
    gyro.max_gap_ns = options_.max_gap_ns;
    gyro.range_rad_s = options_.gyro_range_rad_s;
    return {samples_, gyro, state.R_cam_imu};
  }

  /// Middle of the exposure of a row of a frame, camera clock.
  TimeNs time_of(const FrameTime& frame, double row_px, double readout_s) const {
    ShutterTiming timing;
    timing.exposure_ns = std::max<TimeNs>(frame.exposure_ns, 1);
    timing.readout_ns = to_ns(readout_s);
    timing.stamp_row = options_.stamp_row;
    timing.stamp_phase = options_.stamp_phase;
    return RowExposure(frame.stamp_ns, camera_.calibration().height_px, timing).middle(row_px);
  }
  TimeNs middle_of(const FrameTime& frame, double readout_s) const {
    return time_of(frame, 0.5 * (camera_.calibration().height_px - 1), readout_s);
  }

  void select_points();
  void estimate_image_rates();
  void search_offset(State& state);
  void estimate_rotation(State& state);
  void keep_covered_pairs(const State& state);
  /// Found less predicted [px], two rows a point; NaN where the prediction is behind the camera.
  Eigen::VectorXd residuals(const State& state) const;
  State moved(const State& state, const Eigen::VectorXd& step) const;
  Eigen::MatrixXd jacobian(const State& state) const;
  bool estimates_rotation() const { return !options_.R_cam_imu || options_.refine_rotation; }
  void choose_steps();
  /// @param scale_px  of the loss
  Linearisation linearise(const State& state, const Eigen::VectorXd& r, double scale_px) const;
  /// One step of Levenberg and Marquardt. Returns its length in steps of differentiation; 0 when nothing costs less.
  /// @param r  residuals of the state
  double improve(State& state, Eigen::VectorXd& r, double& damping) const;
  /// Variances of the values by the sandwich formula, with the pairs of frames as units. What is not modelled,
  /// translation, lasts for several of them: neighbours count as correlated, with Bartlett's weights (Newey and West,
  /// 1987), where that does not make the variance smaller.
  Eigen::VectorXd variances(const Linearisation& linear, const Eigen::VectorXd& r) const;
  void refine(State& state, TimingEstimate& estimate);

  const Camera& camera_;
  const std::vector<FramePair>& pairs_;
  const std::vector<GyroSample>& samples_;
  const TimingOptions& options_;

  std::vector<Point> points_;                    // ordered by pair
  std::vector<std::size_t> used_;                // pairs that have points
  std::vector<Eigen::Vector3d> image_rotation_;  // one for each of used_: rotation vector of the camera [rad]
  double correlation_ = 0;
  std::vector<double> steps_;  // of numeric differentiation, one for each estimated value
};

void Problem::select_points() {
  for (std::size_t p = 0; p < pairs_.size(); ++p) {
    const std::size_t before = points_.size();
    for (const PointPair& pair : pairs_[p].points) {
      const Eigen::Vector3d ray = camera_.ray(pair.from_px);
      if (!ray.allFinite() || !camera_.ray(pair.to_px).allFinite()) continue;
      points_.push_back({p, pair.from_px.y(), pair.to_px.y(), ray, pair.from_px, pair.to_px});
    }
    if (points_.size() - before < kMinPointsOfPair) {
      points_.resize(before);
    } else {
      used_.push_back(p);
    }
  }
  if (used_.size() < kMinPairs) {
    throw TimingError(std::to_string(used_.size()) + " of " + std::to_string(pairs_.size()) + " pairs of frames have " +
                      std::to_string(kMinPointsOfPair) + " tracked points or more; " + std::to_string(kMinPairs) +
                      " are needed");
  }
}

void Problem::estimate_image_rates() {
  // As if all rows were exposed at once; the weights keep what disagrees from counting.
  constexpr int kIterations = 5;
  auto first = points_.begin();
  for (const std::size_t p : used_) {
    const auto last = std::find_if(first, points_.end(), [p](const Point& point) { return point.pair != p; });
    Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
    std::vector<double> weights(static_cast<std::size_t>(last - first), 1.0);
    for (int iteration = 0; iteration < kIterations; ++iteration) {
      Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();
      std::vector<double> errors;
      auto weight = weights.begin();
      for (auto point = first; point != last; ++point) {
        const Eigen::Vector3d to = camera_.ray(point->to_px).normalized();
        moment += *weight++ * to * point->from_ray.normalized().transpose();
      }
      R = solve_wahba(moment);
      for (auto point = first; point != last; ++point) {
        errors.push_back((camera_.ray(point->to_px).normalized() - R * point->from_ray.normalized()).norm());
      }
      const double scale = std::max(2 * median(errors), 1e-6);
      std::transform(errors.begin(), errors.end(), weights.begin(),
                     [scale](double error) { return 1 / (1 + error * error / (scale * scale)); });
    }
    // Scene points move against the camera.
    image_rotation_.push_back(-log_rotation(R));
    first = last;
  }
}

void Problem::search_offset(State& state) {
  State plain = state;
  plain.time_offset_s = 0;
  plain.R_cam_imu.setIdentity();
  const RotationTrack gyro = track(plain);  // camera clock = IMU clock here
  const auto correlate = [&](TimeNs offset_ns) {
    double n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
    for (std::size_t i = 0; i < used_.size(); ++i) {
      const FramePair& pair = pairs_[used_[i]];
      const TimeNs from_ns = middle_of(pair.from, state.readout_s), to_ns = middle_of(pair.to, state.readout_s);
      const TimeRange range{from_ns + offset_ns, to_ns + offset_ns};
      if (!gyro.covers(range)) continue;
      const double dt_s = to_seconds(to_ns - from_ns);
      const double a = image_rotation_[i].norm() / dt_s;
      const double b = Eigen::AngleAxisd(gyro.homography(range.begin_ns, range.end_ns)).angle() / dt_s;
      n += 1, sa += a, sb += b, saa += a * a, sbb += b * b, sab += a * b;
    }
    if (n < static_cast<double>(kMinPairs)) return -1.0;
    const double variance_a = saa - sa * sa / n, variance_b = sbb - sb * sb / n;
    if (!(variance_a > 0) || !(variance_b > 0)) return -1.0;
    return (sab - sa * sb / n) / std::sqrt(variance_a * variance_b);
  };
  const TimeNs center_ns = to_ns(state.time_offset_s);
  TimeNs best_ns = center_ns;
  correlation_ = correlate(center_ns);
  for (TimeNs shift_ns = kSearchStepNs; shift_ns <= options_.search_ns; shift_ns += kSearchStepNs) {
    for (const TimeNs offset_ns : {center_ns - shift_ns, center_ns + shift_ns}) {
      const double value = correlate(offset_ns);
      if (value <= correlation_) continue;
      correlation_ = value;
      best_ns = offset_ns;
    }
  }
  state.time_offset_s = to_seconds(best_ns);
  if (correlation_ < kMinCorrelation) {
    std::ostringstream text;
    text.precision(2);
    text << "the angular speeds of image and gyroscope do not agree at any offset within "
         << to_seconds(options_.search_ns) << " s of " << to_seconds(center_ns) << " s: the best correlation is "
         << correlation_ << ", " << kMinCorrelation
         << " is needed; is there motion, do the recordings belong together, are the rates in rad/s?";
    throw TimingError(text.str());
  }
}

void Problem::estimate_rotation(State& state) {
  State plain = state;
  plain.R_cam_imu.setIdentity();
  const RotationTrack gyro = track(plain);
  std::vector<Eigen::Vector3d> from, to;
  for (std::size_t i = 0; i < used_.size(); ++i) {
    const FramePair& pair = pairs_[used_[i]];
    const TimeRange range{middle_of(pair.from, state.readout_s), middle_of(pair.to, state.readout_s)};
    if (!gyro.covers(range)) continue;
    from.push_back(-log_rotation(gyro.homography(range.begin_ns, range.end_ns)));
    to.push_back(image_rotation_[i]);
  }
  std::vector<double> weights(from.size(), 1.0);
  constexpr int kIterations = 10;
  Eigen::Matrix3d moment;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    moment.setZero();
    for (std::size_t i = 0; i < from.size(); ++i) moment += weights[i] * to[i] * from[i].transpose();
    state.R_cam_imu = solve_wahba(moment);
    std::vector<double> errors;
    for (std::size_t i = 0; i < from.size(); ++i) errors.push_back((to[i] - state.R_cam_imu * from[i]).norm());
    const double scale = std::max(2 * median(errors), 1e-6);
    std::transform(errors.begin(), errors.end(), weights.begin(),
                   [scale](double error) { return 1 / (1 + error * error / (scale * scale)); });
  }
  // Turning about one axis only leaves the turn about it open.
  const Eigen::Vector3d spread = Eigen::JacobiSVD<Eigen::Matrix3d>(moment).singularValues();
  constexpr double kLeastSpread = 0.02;
  if (spread[1] < kLeastSpread * spread[0]) {
    throw TimingError(
        "the rotation between IMU and camera is not determined: the recording turns about one axis only; turn it about "
        "others too, or give R_cam_imu");
  }
}

void Problem::keep_covered_pairs(const State& state) {
  const RotationTrack gyro = track(state);
  std::vector<bool> keep(pairs_.size(), false);
  for (const std::size_t p : used_) {
    const double last_row = camera_.calibration().height_px - 1;
    TimeRange range{std::numeric_limits<TimeNs>::max(), std::numeric_limits<TimeNs>::min()};
    for (const FrameTime* frame : {&pairs_[p].from, &pairs_[p].to}) {
      for (const double row : {0.0, last_row}) {
        const TimeNs t_ns = time_of(*frame, row, state.readout_s);
        range.begin_ns = std::min(range.begin_ns, t_ns - kMarginNs);
        range.end_ns = std::max(range.end_ns, t_ns + kMarginNs);
      }
    }
    // A readout that is not known yet can make the last row later or earlier by up to the time between frames.
    if (options_.estimate_readout && state.readout_s == 0) {
      const TimeNs period_ns = pairs_[p].to.stamp_ns - pairs_[p].from.stamp_ns;
      range.begin_ns -= period_ns;
      range.end_ns += period_ns;
    }
    keep[p] = gyro.covers(range);
  }
  points_.erase(std::remove_if(points_.begin(), points_.end(), [&](const Point& point) { return !keep[point.pair]; }),
                points_.end());
  used_.erase(std::remove_if(used_.begin(), used_.end(), [&](std::size_t p) { return !keep[p]; }), used_.end());
  if (used_.size() < kMinPairs) {
    throw TimingError("gyroscope samples cover " + std::to_string(used_.size()) + " pairs of frames; " +
                      std::to_string(kMinPairs) + " are needed");
  }
}

Eigen::VectorXd Problem::residuals(const State& state) const {
  const RotationTrack gyro = track(state);
  Eigen::VectorXd result(2 * static_cast<Eigen::Index>(points_.size()));
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const Point& point = points_[i];
    const FramePair& pair = pairs_[point.pair];
    const TimeNs from_ns = time_of(pair.from, point.from_row_px, state.readout_s);
    const TimeNs to_ns = time_of(pair.to, point.to_row_px, state.readout_s);
    Eigen::Vector2d predicted = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    if (gyro.covers({std::min(from_ns, to_ns), std::max(from_ns, to_ns)})) {
      predicted = camera_.project(gyro.homography(from_ns, to_ns) * point.from_ray);
    }
    result.segment<2>(2 * static_cast<Eigen::Index>(i)) = point.to_px - predicted;
  }
  return result;
}

/// The order of the values in a step; those that are not estimated are left out.
State Problem::moved(const State& state, const Eigen::VectorXd& step) const {
  State result = state;
  Eigen::Index next = 0;
  result.time_offset_s += step[next++];
  if (options_.estimate_readout) result.readout_s += step[next++];
  if (options_.estimate_bias) {
    result.bias_rad_s += step.segment<3>(next);
    next += 3;
  }
  if (estimates_rotation()) {
    result.R_cam_imu =
        (so3_exp(step.segment<3>(next)) * Eigen::Quaterniond(state.R_cam_imu)).normalized().toRotationMatrix();
  }
  return result;
}

Eigen::MatrixXd Problem::jacobian(const State& state) const {
  const auto values = static_cast<Eigen::Index>(steps_.size());
  Eigen::MatrixXd J(2 * static_cast<Eigen::Index>(points_.size()), values);
  for (Eigen::Index k = 0; k < values; ++k) {
    Eigen::VectorXd step = Eigen::VectorXd::Zero(values);
    step[k] = steps_[static_cast<std::size_t>(k)];
    J.col(k) = (residuals(moved(state, step)) - residuals(moved(state, -step))) / (2 * step[k]);
  }
  return J;
}

/// Squared length of the residual of point i; infinite where there is none.
double squared_length(const Eigen::VectorXd& r, Eigen::Index i) {
  const double value = r.segment<2>(2 * i).squaredNorm();
  return std::isfinite(value) ? value : std::numeric_limits<double>::infinity();
}

std::vector<double> lengths(const Eigen::VectorXd& r) {
  std::vector<double> result;
  for (Eigen::Index i = 0; i < r.size() / 2; ++i) result.push_back(std::sqrt(squared_length(r, i)));
  return result;
}

/// Scale of Cauchy's loss, which follows the residuals. 2.385 gives 95 % efficiency for Gaussian ones, and the median
/// length of a two-dimensional Gaussian residual is 1.1774 of its standard deviation.
double scale_of(const Eigen::VectorXd& r) {
  constexpr double kCauchy = 2.385, kRayleighMedian = 1.1774, kLeastScalePx = 0.02;
  return kCauchy * std::max(median(lengths(r)) / kRayleighMedian, kLeastScalePx);
}

double cost_of(const Eigen::VectorXd& r, double scale_px) {
  double cost = 0;
  for (Eigen::Index i = 0; i < r.size() / 2; ++i) {
    // A point that left the image's range costs as much as a gross error.
    constexpr double kGrossPx = 1e3;
    cost += std::log1p(std::min(squared_length(r, i), kGrossPx * kGrossPx) / (scale_px * scale_px));
  }
  return cost;
}

void Problem::choose_steps() {
  constexpr double kTimeStepS = 2e-4, kBiasStepRadS = 1e-4, kRotationStepRad = 1e-4;
  steps_.assign(1, kTimeStepS);
  if (options_.estimate_readout) steps_.push_back(kTimeStepS);
  if (options_.estimate_bias) steps_.insert(steps_.end(), 3, kBiasStepRadS);
  if (estimates_rotation()) steps_.insert(steps_.end(), 3, kRotationStepRad);
}

Linearisation Problem::linearise(const State& state, const Eigen::VectorXd& r, double scale_px) const {
  Linearisation linear{jacobian(state), Eigen::VectorXd(r.size()), {}};
  for (Eigen::Index i = 0; i < r.size() / 2; ++i) {
    auto rows = linear.J.middleRows<2>(2 * i);
    const bool usable = std::isfinite(squared_length(r, i)) && rows.allFinite();
    linear.weights.segment<2>(2 * i).setConstant(usable ? 1 / (1 + squared_length(r, i) / (scale_px * scale_px)) : 0);
    if (!usable) rows.setZero();
  }
  linear.H = linear.J.transpose() * linear.weights.asDiagonal() * linear.J;
  return linear;
}

double Problem::improve(State& state, Eigen::VectorXd& r, double& damping) const {
  const double scale_px = scale_of(r);
  const Linearisation linear = linearise(state, r, scale_px);
  const Eigen::VectorXd gradient = linear.J.transpose() * linear.weighted(r);
  const double cost = cost_of(r, scale_px);
  constexpr int kMaxAttempts = 10;
  for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
    Eigen::MatrixXd damped = linear.H;
    damped.diagonal() *= 1 + damping;
    const Eigen::VectorXd step = -damped.ldlt().solve(gradient);
    damping *= 10;
    if (!step.allFinite()) continue;
    const State next = moved(state, step);
    constexpr double kLargestBias = 1.0;
    if (std::abs(next.readout_s) > to_seconds(kLongestReadoutNs) ||
        next.bias_rad_s.cwiseAbs().maxCoeff() > kLargestBias) {
      continue;
    }
    const Eigen::VectorXd next_r = residuals(next);
    if (!(cost_of(next_r, scale_px) < cost)) continue;
    state = next;
    r = next_r;
    damping /= 100;
    double length = 0;
    for (Eigen::Index k = 0; k < step.size(); ++k) {
      length = std::max(length, std::abs(step[k]) / steps_[static_cast<std::size_t>(k)]);
    }
    return length;
  }
  return 0;
}

Eigen::VectorXd Problem::variances(const Linearisation& linear, const Eigen::VectorXd& r) const {
  const auto values = static_cast<Eigen::Index>(steps_.size());
  const Eigen::VectorXd weighted = linear.weighted(r);
  std::vector<Eigen::VectorXd> scores;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (i == 0 || points_[i].pair != points_[i - 1].pair) scores.emplace_back(Eigen::VectorXd::Zero(values));
    const auto row = 2 * static_cast<Eigen::Index>(i);
    scores.back() += linear.J.middleRows<2>(row).transpose() * weighted.segment<2>(row);
  }
  constexpr std::size_t kMostLags = 10;
  const std::size_t lags = std::min(kMostLags, scores.size() / 4);
  Eigen::MatrixXd alone, scatter = Eigen::MatrixXd::Zero(values, values);
  for (std::size_t lag = 0; lag <= lags; ++lag) {
    Eigen::MatrixXd products = Eigen::MatrixXd::Zero(values, values);
    for (std::size_t i = lag; i < scores.size(); ++i) products += scores[i] * scores[i - lag].transpose();
    const double weight = 1 - static_cast<double>(lag) / static_cast<double>(lags + 1);
    if (lag == 0) alone = products;
    scatter += lag == 0 ? products : Eigen::MatrixXd(weight * (products + products.transpose()));
  }
  const Eigen::FullPivLU<Eigen::MatrixXd> lu(linear.H);
  if (!lu.isInvertible()) {
    throw TimingError("the recording does not determine the values: there is too little motion");
  }
  const Eigen::MatrixXd inverse = lu.inverse();
  return (inverse * scatter * inverse.transpose())
      .diagonal()
      .cwiseMax((inverse * alone * inverse.transpose()).diagonal());
}

void Problem::refine(State& state, TimingEstimate& estimate) {
  choose_steps();
  Eigen::VectorXd r = residuals(state);
  double damping = 1e-3;
  constexpr int kMaxIterations = 30;
  constexpr double kDone = 1e-3;  // of the steps of differentiation
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    if (improve(state, r, damping) < kDone) break;
  }

  const Eigen::VectorXd variance = variances(linearise(state, r, scale_of(r)), r);
  const auto stddev = [&variance](Eigen::Index k) { return std::sqrt(std::max(variance[k], 0.0)); };
  Eigen::Index next = 0;
  estimate.time_offset_s = {state.time_offset_s, stddev(next++)};
  estimate.readout_s = {state.readout_s, 0};
  if (options_.estimate_readout) estimate.readout_s.stddev = stddev(next++);
  for (int axis = 0; axis < 3; ++axis) {
    estimate.bias_rad_s[axis] = {state.bias_rad_s[axis], options_.estimate_bias ? stddev(next++) : 0};
  }
  estimate.R_cam_imu = state.R_cam_imu;
  if (estimates_rotation()) {
    for (int axis = 0; axis < 3; ++axis) estimate.rotation_stddev_rad[axis] = stddev(next++);
  }
}

TimingEstimate Problem::solve() {
  select_points();
  estimate_image_rates();
  State state{to_seconds(options_.time_offset_ns), to_seconds(options_.readout_ns), options_.bias_rad_s,
              options_.R_cam_imu ? require_rotation("R_cam_imu", *options_.R_cam_imu) : Eigen::Matrix3d::Identity()};
  search_offset(state);
  if (!options_.R_cam_imu) estimate_rotation(state);

  // The pairs' rates have to stay beside their pairs when some are left out.
  const std::vector<std::size_t> all = used_;
  keep_covered_pairs(state);
  std::vector<Eigen::Vector3d> kept;
  for (std::size_t i = 0, k = 0; i < all.size() && k < used_.size(); ++i) {
    if (all[i] != used_[k]) continue;
    kept.push_back(image_rotation_[i]);
    ++k;
  }
  image_rotation_ = kept;

  TimingEstimate estimate;
  const Eigen::VectorXd at_start = residuals(state);
  refine(state, estimate);
  const Eigen::VectorXd at_end = residuals(state);

  estimate.correlation = correlation_;
  estimate.pairs = used_.size();
  estimate.points = points_.size();
  std::vector<double> without;
  for (std::size_t i = 0; i < points_.size(); ++i) {
    const Point& point = points_[i];
    const auto row = 2 * static_cast<Eigen::Index>(i);
    estimate.residuals.push_back(
        {point.to_row_px, point.to_px - point.from_px, at_start.segment<2>(row), at_end.segment<2>(row)});
    without.push_back((point.to_px - point.from_px).norm());
  }
  estimate.median_without_px = median(without);
  estimate.median_at_start_px = median(lengths(at_start));
  estimate.median_px = median(lengths(at_end));
  const RotationTrack gyro = track(state);
  for (std::size_t i = 0; i < used_.size(); ++i) {
    const FramePair& pair = pairs_[used_[i]];
    const TimeNs from_ns = middle_of(pair.from, state.readout_s), to_ns = middle_of(pair.to, state.readout_s);
    const double dt_s = to_seconds(to_ns - from_ns);
    estimate.rates.push_back({from_ns + (to_ns - from_ns) / 2, image_rotation_[i] / dt_s,
                              -log_rotation(gyro.homography(from_ns, to_ns)) / dt_s});
  }
  return estimate;
}

}  // namespace

void TimingOptions::validate() const {
  constexpr double kLongestOffsetS = 10, kLongestSearchS = 5;
  require_range("time_offset", to_seconds(time_offset_ns), -kLongestOffsetS, kLongestOffsetS, "s");
  require_range("search", to_seconds(search_ns), 0, kLongestSearchS, "s");
  require_range("readout_time", to_seconds(readout_ns), -1, 1, "s");
  GyroOptions gyro;
  gyro.bias_rad_s = bias_rad_s;
  gyro.max_gap_ns = max_gap_ns;
  gyro.range_rad_s = gyro_range_rad_s;
  gyro.validate();
  if (R_cam_imu) require_rotation("R_cam_imu", *R_cam_imu);
}

TimingEstimate estimate_timing(const Camera& camera, const std::vector<FramePair>& pairs,
                               const std::vector<GyroSample>& samples, const TimingOptions& options) {
  options.validate();
  if (samples.size() < 2) throw TimingError("there are " + std::to_string(samples.size()) + " gyroscope samples");
  return Problem(camera, pairs, samples, options).solve();
}

}  // namespace gyro_deblur
