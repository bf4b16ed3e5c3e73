// Searches the time offset by correlation, then refines offset, rotation and bias by least squares.
#include "calibrate/rate_alignment.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

#include "base/median.hpp"
#include "calibrate/aligned_rotation.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

constexpr TimeNs kCoarseStepNs = 10'000'000, kFineStepNs = 2'000'000;
/// Number of rates that the coarse search uses at most.
constexpr std::size_t kMostCoarse = 300;
/// Error of a rate from images, in addition to its own standard deviation [rad/s].
constexpr double kFloorRadS = 0.01;
/// Agreement is measured on rates above this.
constexpr double kLeastMovingRadS = 0.04;

TimeRange shifted(const TimeRange& range, TimeNs offset_ns) {
  return {range.begin_ns + offset_ns, range.end_ns + offset_ns};
}
TimeRange shifted(const ImageRate& rate, TimeNs offset_ns) {
  return shifted(TimeRange{rate.begin_ns, rate.end_ns}, offset_ns);
}

/// Whether no image is missing between two rates.
bool follows(const TimeRange& before, const TimeRange& range) {
  constexpr TimeNs kLongestGapNs = 10'000'000;
  return std::abs(range.begin_ns - before.end_ns) <= kLongestGapNs;
}

/// A rate of the images; where the lens is not known its change since the one before, which has little of a
/// translation: that of a drone, or of a walk, is slow against its rotations. (A lever arm turns with the camera.)
struct Measured {
  TimeRange range;
  std::optional<TimeRange> before;  ///< of a change
  Eigen::Vector3d rate_rad_s;
  double stddev_rad_s;

  bool lens_known() const { return !before; }
  double variance() const { return kFloorRadS * kFloorRadS + stddev_rad_s * stddev_rad_s; }
  /// The same of the gyroscope, in its axes.
  Eigen::Vector3d by_gyro(const GyroIntegral& gyro, TimeNs offset_ns) const {
    const Eigen::Vector3d rate = gyro.mean_rate(shifted(range, offset_ns));
    return before ? Eigen::Vector3d(rate - gyro.mean_rate(shifted(*before, offset_ns))) : rate;
  }
};

std::vector<Measured> measured_in(const std::vector<ImageRate>& rates) {
  std::vector<Measured> measured;
  for (std::size_t i = 0; i < rates.size(); ++i) {
    const TimeRange range = shifted(rates[i], 0);
    if (rates[i].lens_known) {
      measured.push_back({range, {}, rates[i].rate_rad_s, rates[i].stddev_rad_s});
    } else if (i > 0 && follows(shifted(rates[i - 1], 0), range)) {
      measured.push_back({range, shifted(rates[i - 1], 0), rates[i].rate_rad_s - rates[i - 1].rate_rad_s,
                          std::hypot(rates[i].stddev_rad_s, rates[i - 1].stddev_rad_s)});
    }
  }
  return measured;
}

/// Sums of one offset, of rates, or of their changes where the lens is not known.
struct Correlated {
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();  ///< sum of weight * image rate * gyroscope's rate^T, less means
  Eigen::Vector3d image_energies = Eigen::Vector3d::Zero();  ///< of the camera's axes
  double gyro_energy = 0;

  /// @param focal_length  of an unknown lens; 1: of a known one
  double correlation(double focal_length) const {
    const Eigen::Vector3d scale(1 / focal_length, 1 / focal_length, 1);
    const double energy = image_energies.dot(scale.cwiseAbs2()) * gyro_energy;
    return energy > 0 ? std::max(0.0, wahba_trace(scale.asDiagonal() * moment) / std::sqrt(energy)) : 0;
  }
};

/// The focal length of which most is correlated, in coarse steps.
double coarse_focal_length(const Correlated& correlated, bool lens_known) {
  if (lens_known) return 1;
  double best = 1;
  for (const double focal_length : {0.3, 0.42, 0.6, 0.84, 1.2, 1.7, 2.4, 3.4}) {
    if (correlated.correlation(focal_length) > correlated.correlation(best)) best = focal_length;
  }
  return best;
}

double best_correlation(const Correlated& correlated, bool lens_known) {
  return correlated.correlation(coarse_focal_length(correlated, lens_known));
}

/// Rates above all of the gyroscope's are wrong; the farther above, the less they count altogether.
std::vector<double> prior_weights(const std::vector<Measured>& measured, const GyroIntegral& gyro, TimeNs offset_ns) {
  std::vector<double> weights, gyro_speeds, image_speeds;
  for (const Measured& each : measured) {
    gyro_speeds.push_back(each.by_gyro(gyro, offset_ns).norm());
    image_speeds.push_back(each.rate_rad_s.norm());
  }
  const double focal_length =
      measured.front().lens_known() ? 1 : median(image_speeds) / std::max(median(gyro_speeds), kLeastMovingRadS);
  const auto fast = gyro_speeds.begin() + static_cast<std::ptrdiff_t>(gyro_speeds.size() * 19 / 20);
  std::nth_element(gyro_speeds.begin(), fast, gyro_speeds.end());
  const double limit_rad_s = focal_length * *fast + kLeastMovingRadS;
  for (std::size_t i = 0; i < measured.size(); ++i) {
    const double excess = std::max(1.0, image_speeds[i] / limit_rad_s);
    weights.push_back(1 / (std::pow(excess, 4) * measured[i].variance()));
  }
  return weights;
}

Correlated correlate(const std::vector<Measured>& measured, const std::vector<double>& weights, std::size_t stride,
                     const GyroIntegral& gyro, TimeNs offset_ns) {
  double sum = 0, gyro_squares = 0;
  Eigen::Vector3d image_sum = Eigen::Vector3d::Zero(), gyro_sum = Eigen::Vector3d::Zero();
  Eigen::Vector3d image_squares = Eigen::Vector3d::Zero();
  Correlated correlated;
  for (std::size_t i = 0; i < measured.size(); i += stride) {
    const Eigen::Vector3d rate_rad_s = measured[i].by_gyro(gyro, offset_ns);
    const Eigen::Vector3d weighted = weights[i] * measured[i].rate_rad_s;
    sum += weights[i];
    image_sum += weighted;
    gyro_sum += weights[i] * rate_rad_s;
    image_squares += weighted.cwiseProduct(measured[i].rate_rad_s);
    gyro_squares += weights[i] * rate_rad_s.squaredNorm();
    correlated.moment += weighted * rate_rad_s.transpose();
  }
  correlated.moment -= image_sum * gyro_sum.transpose() / sum;
  correlated.image_energies = image_squares - image_sum.cwiseAbs2() / sum;
  correlated.gyro_energy = gyro_squares - gyro_sum.squaredNorm() / sum;
  return correlated;
}

/// The largest value beyond the valleys on both sides of the peak; its index, or that of the peak.
std::size_t second_peak(const std::vector<double>& values, std::size_t peak) {
  std::size_t left = peak, right = peak, second = peak;
  while (left > 0 && values[left - 1] <= values[left]) --left;
  while (right + 1 < values.size() && values[right + 1] <= values[right]) ++right;
  double largest = -1;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if ((i >= left && i <= right) || values[i] <= largest) continue;
    largest = values[i];
    second = i;
  }
  return second;
}

/// Rows of the normal equations: rotation, offset, bias, logarithm of the scale, readout.
constexpr int kUnknowns = 9;
constexpr int kOffset = 3, kBias = 4, kScale = 7, kReadout = 8;
using Normal = Eigen::Matrix<double, kUnknowns, kUnknowns>;
using Unknowns = Eigen::Matrix<double, kUnknowns, 1>;

/// Parts of the time that the jackknife leaves out one after the other.
constexpr std::size_t kParts = 8;
constexpr std::size_t kFewestRates = 3 * kParts;

/// Standard deviations before any measurement: 1 rad, 1 s, 0.5 rad/s, a factor of 1.6, 30 ms.
Normal prior() {
  Unknowns stddev;
  stddev << 1, 1, 1, 1, 0.5, 0.5, 0.5, 0.5, 0.03;
  return stddev.cwiseAbs2().cwiseInverse().asDiagonal();
}

/// What an image says of the motion, and its derivatives.
struct Row {
  TimeRange range;
  Eigen::Vector3d measured, predicted;
  double stddev_rad_s;
  Eigen::Matrix<double, 3, kUnknowns> derivatives;

  Eigen::Vector3d difference() const { return measured - predicted; }
};

std::vector<Row> changes(const std::vector<Row>& rows) {
  std::vector<Row> result;
  for (std::size_t i = 1; i < rows.size(); ++i) {
    const Row &before = rows[i - 1], &row = rows[i];
    if (!follows(before.range, row.range)) continue;
    result.push_back({row.range, row.measured - before.measured, row.predicted - before.predicted,
                      std::hypot(before.stddev_rad_s, row.stddev_rad_s), row.derivatives - before.derivatives});
  }
  return result;
}

/// One step of Gauss-Newton, and its residual.
class Step {
 public:
  Step(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, const RateAlignment& at) {
    constexpr TimeNs kHalfNs = 3'000'000;
    const bool lens_known = rates.front().lens_known;
    const Eigen::DiagonalMatrix<double, 3> scale(at.scale, at.scale, lens_known ? at.scale : 1);
    const Eigen::Matrix3d scaled = scale * at.R_cam_imu;
    for (const ImageRate& rate : rates) {
      const Eigen::Vector3d before = gyro.mean_rate(shifted(rate, at.offset_ns - kHalfNs));
      const Eigen::Vector3d after = gyro.mean_rate(shifted(rate, at.offset_ns + kHalfNs));
      const Eigen::Vector3d change = scaled * (after - before) / to_seconds(2 * kHalfNs);
      const Eigen::Vector3d by_rows = rate.by_rows * change;
      const Eigen::Vector3d rate_rad_s = at.R_cam_imu * (gyro.mean_rate(shifted(rate, at.offset_ns)) - at.bias_rad_s);
      const Eigen::Vector3d by_scale =
          at.scale * Eigen::Vector3d(rate_rad_s.x(), rate_rad_s.y(), lens_known ? rate_rad_s.z() : 0);
      Row row{shifted(rate, 0), rate.rate_rad_s, scale * rate_rad_s + at.readout_s * by_rows, rate.stddev_rad_s, {}};
      row.derivatives << scale * -cross_matrix(rate_rad_s), change, -scaled, by_scale, by_rows;
      rows_.push_back(row);
    }
    if (!lens_known) rows_ = changes(rows_);
    std::vector<double> lengths;
    for (const Row& row : rows_) lengths.push_back(row.difference().norm());
    robust_ = cauchy_weights(lengths, kFloorRadS);
    double squares = 0, sum = 0, robust_sum = 0;
    normal_.fill(Normal::Zero());
    right_.fill(Unknowns::Zero());
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      const Row& row = rows_[i];
      const double weight = weight_of(i);
      const std::size_t part = i * kParts / rows_.size();
      normal_[part] += weight * row.derivatives.transpose() * row.derivatives;
      right_[part] += weight * row.derivatives.transpose() * row.difference();
      squares += weight * row.difference().squaredNorm();
      sum += weight;
      robust_sum += robust_[i];
    }
    constexpr double kAxes = 3;
    variance_ = std::max(squares / std::max(kAxes * robust_sum - kUnknowns, 1.0), 1e-12);
    spread_rad_s_ = std::sqrt(squares / (kAxes * sum));
  }

  /// From `at` to where the squares are least.
  Unknowns solution() const { return solve(sum_of(normal_), sum_of(right_)); }
  double weight_of(std::size_t i) const {
    return robust_[i] / (kFloorRadS * kFloorRadS + rows_[i].stddev_rad_s * rows_[i].stddev_rad_s);
  }
  double spread_rad_s() const { return spread_rad_s_; }
  const std::vector<Row>& rows() const { return rows_; }

  /// The sum of two estimates: by the differences, and by leaving out parts.
  Normal covariance() const {
    const Normal normal = sum_of(normal_);
    const Unknowns right = sum_of(right_);
    const Normal formal = (normal / variance_ + prior()).inverse();
    std::array<Unknowns, kParts> without;
    Unknowns mean = Unknowns::Zero();
    for (std::size_t part = 0; part < kParts; ++part) {
      without[part] = solve(normal - normal_[part], right - right_[part]);
      mean += without[part] / kParts;
    }
    Normal jackknife = Normal::Zero();
    for (const Unknowns& each : without) {
      jackknife += (kParts - 1.0) / kParts * (each - mean) * (each - mean).transpose();
    }
    return formal + jackknife;
  }

 private:
  template <typename Part>
  static Part sum_of(const std::array<Part, kParts>& parts) {
    Part sum = Part::Zero();
    for (const Part& part : parts) sum += part;
    return sum;
  }
  Unknowns solve(const Normal& normal, const Unknowns& right) const {
    return (normal / variance_ + prior()).ldlt().solve(right / variance_);
  }

  std::vector<Row> rows_;
  std::vector<double> robust_;
  std::array<Normal, kParts> normal_;
  std::array<Unknowns, kParts> right_;
  double variance_ = 0, spread_rad_s_ = 0;
};

double worst_stddev(const Eigen::Matrix3d& covariance) {
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvalues()[2]);
}

/// How well it fits, and about which axes the camera has rotated.
void describe(const Step& step, RateAlignment* alignment) {
  const Normal covariance = step.covariance();
  alignment->rotation_stddev_rad = worst_stddev(covariance.topLeftCorner<3, 3>());
  alignment->offset_stddev_s = std::sqrt(covariance(kOffset, kOffset));
  alignment->readout_stddev_s = std::sqrt(covariance(kReadout, kReadout));
  alignment->bias_stddev_rad_s = worst_stddev(covariance.block<3, 3>(kBias, kBias));
  alignment->scale_stddev = alignment->scale * std::sqrt(covariance(kScale, kScale));
  alignment->spread_rad_s = step.spread_rad_s();
  const std::vector<Row>& rows = step.rows();
  double sum = 0, differing = 0, squares = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), image_mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const double weight = step.weight_of(i);
    sum += weight;
    mean += weight * rows[i].predicted;
    image_mean += weight * rows[i].measured;
  }
  mean /= sum;
  image_mean /= sum;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  double agreeing = 0, moving = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Row& row = rows[i];
    const double weight = step.weight_of(i) / sum, off_rad_s = row.difference().norm();
    const Eigen::Vector3d rotated = row.predicted - mean;
    scatter += weight * rotated * rotated.transpose();
    differing += weight * off_rad_s * off_rad_s;
    squares += weight * (row.measured - image_mean).squaredNorm();
    // Indoors, translation changes a rate by a third.
    constexpr double kAgreeing = 0.4;
    const double speed_rad_s = std::max(row.measured.norm(), row.predicted.norm());
    if (speed_rad_s < kLeastMovingRadS) continue;
    ++moving;
    if (off_rad_s < std::max(kAgreeing * speed_rad_s, kLeastMovingRadS)) ++agreeing;
  }
  alignment->agreeing = moving > 0 ? agreeing / moving : 0;
  alignment->correlation = squares > 0 ? std::sqrt(std::max(0.0, 1 - differing / squares)) : 0;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(scatter);
  alignment->main_axis = axes.eigenvectors().col(2);
  alignment->second_rad_s = std::sqrt(std::max(axes.eigenvalues()[1], 0.0));
}

}  // namespace

OffsetPeak search_rate_offset(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, TimeNs center_ns,
                              TimeNs search_ns) {
  const std::vector<Measured> measured = measured_in(rates);
  if (measured.empty()) return {center_ns};
  const std::vector<double> weights = prior_weights(measured, gyro, center_ns);
  const std::size_t stride = (measured.size() + kMostCoarse - 1) / kMostCoarse;
  const bool lens_known = rates.front().lens_known;
  std::vector<TimeNs> offsets_ns;
  std::vector<double> values;
  for (TimeNs shift_ns = -search_ns; shift_ns <= search_ns; shift_ns += kCoarseStepNs) {
    offsets_ns.push_back(center_ns + shift_ns);
    values.push_back(best_correlation(correlate(measured, weights, stride, gyro, offsets_ns.back()), lens_known));
  }
  const auto best = static_cast<std::size_t>(std::max_element(values.begin(), values.end()) - values.begin());
  const std::size_t second = second_peak(values, best);
  OffsetPeak peak;
  peak.at_edge = best == 0 || best + 1 == values.size();
  peak.correlation = values[best];
  peak.second_ns = offsets_ns[second];
  const double second_correlation = second == best ? 0 : values[second];
  // The offset is ambiguous unless the second peak leaves half as much again unexplained. Images' rates always leave
  // kNeverExplained.
  constexpr double kNeverExplained = 0.02, kFarWorse = 1.5;
  const auto unexplained = [](double correlation) { return 1 - correlation * correlation + kNeverExplained; };
  peak.is_ambiguous = unexplained(second_correlation) < kFarWorse * unexplained(peak.correlation);

  peak.offset_ns = offsets_ns[best];
  double largest = -1;
  const TimeNs first_ns = std::max(center_ns - search_ns, offsets_ns[best] - kCoarseStepNs);
  const TimeNs last_ns = std::min(center_ns + search_ns, offsets_ns[best] + kCoarseStepNs);
  for (TimeNs offset_ns = first_ns; offset_ns <= last_ns; offset_ns += kFineStepNs) {
    const double value = best_correlation(correlate(measured, weights, stride, gyro, offset_ns), lens_known);
    if (value <= largest) continue;
    largest = value;
    peak.offset_ns = offset_ns;
  }
  return peak;
}

std::optional<RateAlignment> align_rates(const std::vector<ImageRate>& all, const GyroIntegral& gyro, TimeNs begin_ns) {
  constexpr TimeNs kRoomNs = 40'000'000;  // for the offset to move in
  std::vector<ImageRate> rates;
  for (const ImageRate& rate : all) {
    const TimeRange range = shifted(rate, begin_ns);
    if (gyro.covers({range.begin_ns - kRoomNs, range.end_ns + kRoomNs})) rates.push_back(rate);
  }
  const std::vector<Measured> measured = measured_in(rates);
  if (measured.size() < kFewestRates) return std::nullopt;
  const Correlated start = correlate(measured, prior_weights(measured, gyro, begin_ns), 1, gyro, begin_ns);
  const double focal_length = coarse_focal_length(start, rates.front().lens_known);
  const Eigen::Matrix3d moment = Eigen::Vector3d(1 / focal_length, 1 / focal_length, 1).asDiagonal() * start.moment;
  if (!(start.gyro_energy > 0) || !(wahba_trace(moment) > 0)) return std::nullopt;
  RateAlignment alignment;
  alignment.offset_ns = begin_ns;
  alignment.R_cam_imu = solve_wahba(moment);
  alignment.scale = rates.front().lens_known ? wahba_trace(moment) / start.gyro_energy : focal_length;
  std::vector<double> biases[3];
  for (const ImageRate& rate : rates) {
    const Eigen::Vector3d bias_rad_s =
        gyro.mean_rate(shifted(rate, begin_ns)) - alignment.R_cam_imu.transpose() * rate.rate_rad_s / alignment.scale;
    for (int axis = 0; axis < 3; ++axis) biases[axis].push_back(bias_rad_s[axis]);
  }
  for (int axis = 0; axis < 3; ++axis) alignment.bias_rad_s[axis] = median(biases[axis]);

  constexpr int kIterations = 6;
  constexpr TimeNs kInsideNs = kRoomNs - 5'000'000;  // room for the derivative
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const Unknowns step = Step(rates, gyro, alignment).solution();
    alignment.R_cam_imu = so3_exp(step.head<3>()).toRotationMatrix() * alignment.R_cam_imu;
    alignment.offset_ns =
        std::clamp(alignment.offset_ns + to_ns(step[kOffset]), begin_ns - kInsideNs, begin_ns + kInsideNs);
    alignment.bias_rad_s += step.segment<3>(kBias);
    alignment.scale *= std::exp(step[kScale]);
    alignment.readout_s += step[kReadout];
  }
  describe(Step(rates, gyro, alignment), &alignment);
  return alignment;
}

}  // namespace gyro_deblur
