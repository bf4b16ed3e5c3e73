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

/// Sums of one offset.
struct Correlated {
  Eigen::Matrix3d moment = Eigen::Matrix3d::Zero();  ///< sum of weight * image rate * gyroscope's rate^T, less means
  double image_energy = 0, gyro_energy = 0;

  double correlation() const {
    const double energy = image_energy * gyro_energy;
    return energy > 0 ? std::max(0.0, wahba_trace(moment) / std::sqrt(energy)) : 0;
  }
};

TimeRange shifted(const ImageRate& rate, TimeNs offset_ns) {
  return {rate.begin_ns + offset_ns, rate.end_ns + offset_ns};
}

/// Rates above all of the gyroscope's are wrong; their weight falls with their square.
std::vector<double> prior_weights(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, TimeNs offset_ns) {
  std::vector<double> weights, speeds;
  for (const ImageRate& rate : rates) speeds.push_back(gyro.mean_rate(shifted(rate, offset_ns)).norm());
  const auto fast = speeds.begin() + static_cast<std::ptrdiff_t>(speeds.size() * 19 / 20);
  std::nth_element(speeds.begin(), fast, speeds.end());
  const double limit_rad_s = *fast + kLeastMovingRadS;
  for (const ImageRate& rate : rates) {
    const double excess = std::max(1.0, rate.rate_rad_s.norm() / limit_rad_s);
    weights.push_back(1 / (excess * excess * (kFloorRadS * kFloorRadS + rate.stddev_rad_s * rate.stddev_rad_s)));
  }
  return weights;
}

Correlated correlate(const std::vector<ImageRate>& rates, const std::vector<double>& weights, std::size_t stride,
                     const GyroIntegral& gyro, TimeNs offset_ns) {
  double sum = 0, image_squares = 0, gyro_squares = 0;
  Eigen::Vector3d image_sum = Eigen::Vector3d::Zero(), gyro_sum = Eigen::Vector3d::Zero();
  Correlated correlated;
  for (std::size_t i = 0; i < rates.size(); i += stride) {
    const Eigen::Vector3d rate_rad_s = gyro.mean_rate(shifted(rates[i], offset_ns));
    const Eigen::Vector3d weighted = weights[i] * rates[i].rate_rad_s;
    sum += weights[i];
    image_sum += weighted;
    gyro_sum += weights[i] * rate_rad_s;
    image_squares += weighted.dot(rates[i].rate_rad_s);
    gyro_squares += weights[i] * rate_rad_s.squaredNorm();
    correlated.moment += weighted * rate_rad_s.transpose();
  }
  correlated.moment -= image_sum * gyro_sum.transpose() / sum;
  correlated.image_energy = image_squares - image_sum.squaredNorm() / sum;
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

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// One step of Gauss-Newton, and its residual.
class Step {
 public:
  Step(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, const RateAlignment& at)
      : rates_(rates), predicted_(rates.size()), differences_(rates.size()) {
    constexpr TimeNs kHalfNs = 3'000'000;
    std::vector<double> lengths;
    std::vector<Eigen::Matrix<double, 3, kUnknowns>> derivatives(rates.size());
    const Eigen::Matrix3d scaled = at.scale * at.R_cam_imu;
    for (std::size_t i = 0; i < rates.size(); ++i) {
      const Eigen::Vector3d before = gyro.mean_rate(shifted(rates[i], at.offset_ns - kHalfNs));
      const Eigen::Vector3d after = gyro.mean_rate(shifted(rates[i], at.offset_ns + kHalfNs));
      const Eigen::Vector3d change = scaled * (after - before) / to_seconds(2 * kHalfNs);
      const Eigen::Vector3d by_rows = rates[i].by_rows * change;
      const Eigen::Vector3d rate_rad_s = scaled * (gyro.mean_rate(shifted(rates[i], at.offset_ns)) - at.bias_rad_s);
      predicted_[i] = rate_rad_s + at.readout_s * by_rows;
      differences_[i] = rates[i].rate_rad_s - predicted_[i];
      derivatives[i] << -cross_matrix(rate_rad_s), change, -scaled, rate_rad_s, by_rows;
      lengths.push_back(differences_[i].norm());
    }
    robust_ = cauchy_weights(lengths, kFloorRadS);
    double squares = 0, sum = 0, robust_sum = 0;
    normal_.fill(Normal::Zero());
    right_.fill(Unknowns::Zero());
    for (std::size_t i = 0; i < rates.size(); ++i) {
      const double weight = weight_of(i);
      const std::size_t part = i * kParts / rates.size();
      normal_[part] += weight * derivatives[i].transpose() * derivatives[i];
      right_[part] += weight * derivatives[i].transpose() * differences_[i];
      squares += weight * differences_[i].squaredNorm();
      sum += weight;
      robust_sum += robust_[i];
    }
    constexpr double kAxes = 3;
    variance_ = std::max(squares / std::max(kAxes * robust_sum - kUnknowns, 1.0), 1e-12);
    spread_rad_s_ = std::sqrt(squares / (kAxes * sum));
  }

  /// From `at` to where the squares are least.
  Unknowns solution() const { return solve(normal_sum(), right_sum()); }
  double weight_of(std::size_t i) const {
    return robust_[i] / (kFloorRadS * kFloorRadS + rates_[i].stddev_rad_s * rates_[i].stddev_rad_s);
  }
  double spread_rad_s() const { return spread_rad_s_; }
  const std::vector<Eigen::Vector3d>& predicted() const { return predicted_; }
  const std::vector<Eigen::Vector3d>& differences() const { return differences_; }

  /// The sum of two estimates: by the differences, and by leaving out parts.
  Normal covariance() const {
    const Normal normal = normal_sum();
    const Unknowns right = right_sum();
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
  Normal normal_sum() const {
    Normal sum = Normal::Zero();
    for (const Normal& part : normal_) sum += part;
    return sum;
  }
  Unknowns right_sum() const {
    Unknowns sum = Unknowns::Zero();
    for (const Unknowns& part : right_) sum += part;
    return sum;
  }
  Unknowns solve(const Normal& normal, const Unknowns& right) const {
    return (normal / variance_ + prior()).ldlt().solve(right / variance_);
  }

  const std::vector<ImageRate>& rates_;
  std::vector<Eigen::Vector3d> predicted_, differences_;
  std::vector<double> robust_;
  std::array<Normal, kParts> normal_;
  std::array<Unknowns, kParts> right_;
  double variance_ = 0, spread_rad_s_ = 0;
};

double worst_stddev(const Eigen::Matrix3d& covariance) {
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvalues()[2]);
}

/// How well it fits, and about which axes the camera has rotated.
void describe(const std::vector<ImageRate>& rates, const Step& step, RateAlignment* alignment) {
  const Normal covariance = step.covariance();
  alignment->rotation_stddev_rad = worst_stddev(covariance.topLeftCorner<3, 3>());
  alignment->offset_stddev_s = std::sqrt(covariance(kOffset, kOffset));
  alignment->readout_stddev_s = std::sqrt(covariance(kReadout, kReadout));
  alignment->bias_stddev_rad_s = worst_stddev(covariance.block<3, 3>(kBias, kBias));
  alignment->spread_rad_s = step.spread_rad_s();
  double sum = 0, differing = 0, squares = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), image_mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < rates.size(); ++i) {
    const double weight = step.weight_of(i);
    sum += weight;
    mean += weight * step.predicted()[i];
    image_mean += weight * rates[i].rate_rad_s;
  }
  mean /= sum;
  image_mean /= sum;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  double agreeing = 0, moving = 0;
  for (std::size_t i = 0; i < rates.size(); ++i) {
    const double weight = step.weight_of(i) / sum, off_rad_s = step.differences()[i].norm();
    const Eigen::Vector3d rotated = step.predicted()[i] - mean;
    scatter += weight * rotated * rotated.transpose();
    differing += weight * step.differences()[i].squaredNorm();
    squares += weight * (rates[i].rate_rad_s - image_mean).squaredNorm();
    // Indoors, translation changes a rate by a third.
    constexpr double kAgreeing = 0.4;
    const double speed_rad_s = std::max(rates[i].rate_rad_s.norm(), step.predicted()[i].norm());
    if (speed_rad_s < kLeastMovingRadS) continue;
    ++moving;
    if (off_rad_s < std::max(kAgreeing * speed_rad_s, kLeastMovingRadS)) ++agreeing;
  }
  alignment->agreeing = moving > 0 ? agreeing / moving : 0;
  alignment->correlation = squares > 0 ? std::sqrt(std::max(0.0, 1 - differing / squares)) : 0;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(scatter);
  alignment->main_axis = axes.eigenvectors().col(2);
  alignment->main_rad_s = std::sqrt(std::max(axes.eigenvalues()[2], 0.0));
  alignment->second_rad_s = std::sqrt(std::max(axes.eigenvalues()[1], 0.0));
}

}  // namespace

OffsetPeak search_rate_offset(const std::vector<ImageRate>& rates, const GyroIntegral& gyro, TimeNs center_ns,
                              TimeNs search_ns) {
  const std::vector<double> weights = prior_weights(rates, gyro, center_ns);
  const std::size_t stride = (rates.size() + kMostCoarse - 1) / kMostCoarse;
  std::vector<TimeNs> offsets_ns;
  std::vector<double> values;
  for (TimeNs shift_ns = -search_ns; shift_ns <= search_ns; shift_ns += kCoarseStepNs) {
    offsets_ns.push_back(center_ns + shift_ns);
    values.push_back(correlate(rates, weights, stride, gyro, offsets_ns.back()).correlation());
  }
  const auto best = static_cast<std::size_t>(std::max_element(values.begin(), values.end()) - values.begin());
  const std::size_t second = second_peak(values, best);
  OffsetPeak peak;
  peak.at_edge = best == 0 || best + 1 == values.size();
  peak.correlation = values[best];
  peak.second_ns = offsets_ns[second];
  peak.second = second == best ? 0 : values[second];
  // The offset is ambiguous unless the second peak leaves half as much again unexplained. Images' rates always leave
  // kNeverExplained.
  constexpr double kNeverExplained = 0.02, kFarWorse = 1.5;
  const auto unexplained = [](double correlation) { return 1 - correlation * correlation + kNeverExplained; };
  peak.is_ambiguous = unexplained(peak.second) < kFarWorse * unexplained(peak.correlation);

  peak.offset_ns = offsets_ns[best];
  double largest = -1;
  const TimeNs first_ns = std::max(center_ns - search_ns, offsets_ns[best] - kCoarseStepNs);
  const TimeNs last_ns = std::min(center_ns + search_ns, offsets_ns[best] + kCoarseStepNs);
  for (TimeNs offset_ns = first_ns; offset_ns <= last_ns; offset_ns += kFineStepNs) {
    const double value = correlate(rates, weights, stride, gyro, offset_ns).correlation();
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
  if (rates.size() < kFewestRates) return std::nullopt;
  const Correlated start = correlate(rates, prior_weights(rates, gyro, begin_ns), 1, gyro, begin_ns);
  if (!(start.gyro_energy > 0) || !(wahba_trace(start.moment) > 0)) return std::nullopt;
  RateAlignment alignment;
  alignment.offset_ns = begin_ns;
  alignment.R_cam_imu = solve_wahba(start.moment);
  alignment.scale = wahba_trace(start.moment) / start.gyro_energy;
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
  describe(rates, Step(rates, gyro, alignment), &alignment);
  return alignment;
}

}  // namespace gyro_deblur
