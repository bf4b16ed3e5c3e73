// Fits a rotation to residual velocities.
#include "features/residual_rotation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "base/median.hpp"
#include "features/corner_prediction.hpp"

namespace gyro_deblur {
namespace {

using Columns = Eigen::Matrix<double, 2, 3>;

/// How a velocity of the pixel depends on three parameters, and what it is.
struct Row {
  Columns columns;
  Eigen::Vector2d velocity_px_s;
  double weight;  // one over its variance
};

/// Geman-McClure with the scale of the residuals themselves.
Eigen::Vector3d robust_fit(const std::vector<Row>& rows) {
  constexpr int kIterations = 5;
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  std::vector<double> robust(rows.size(), 1.0), distances(rows.size());
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const double weight = robust[i] * rows[i].weight;
      normal += weight * rows[i].columns.transpose() * rows[i].columns;
      right += weight * rows[i].columns.transpose() * rows[i].velocity_px_s;
    }
    x = normal.ldlt().solve(right);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      distances[i] = (rows[i].velocity_px_s - rows[i].columns * x).norm();
    }
    const double scale = 3 * std::max(median(distances), 1e-6);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      robust[i] = std::pow(1 + distances[i] * distances[i] / (scale * scale), -2);
    }
  }
  return x;
}

double energy_less(const std::vector<Row>& rows, const Eigen::Vector3d& x) {
  double energy = 0, weights = 0;
  for (const Row& row : rows) {
    energy += row.weight * (row.velocity_px_s - row.columns * x).squaredNorm();
    weights += row.weight;
  }
  return energy / weights;
}

constexpr TimeNs kWatchedNs = 10'000'000'000, kLeastNs = 5'000'000'000;
/// After a longer break it is another recording.
constexpr TimeNs kLongestBreakNs = 1'000'000'000;
constexpr int kParts = 5;
constexpr std::size_t kLeastFrames = 5 * kParts;
/// In standard errors from kParts parts; Student's t with 4 degrees of freedom is beyond it once in 120 times for one
/// component.
constexpr double kSignificance = 5;
/// Below these it is less than a tenth of the blur that it adds to, or below 0.2 px.
constexpr double kLeastBiasRadS = 0.01, kLeastRotationRad = 0.02, kLeastOffsetS = 0.002;

/// Residual rates of the watched images and what they are explained with: e = bias + rotation x w + offset * dw/dt.
struct Watched {
  int part;
  Eigen::Vector3d rate_rad_s;
  std::array<Eigen::Matrix3d, 3> terms;  // for bias, rotation and offset, which is in the first column
};

using Unknowns = Eigen::Matrix<double, 9, 1>;  // the last two are always 0

Unknowns solve(const std::vector<Watched>& watched) {
  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  Unknowns right = Unknowns::Zero();
  for (const Watched& each : watched) {
    Eigen::Matrix<double, 3, 9> row;
    row << each.terms[0], each.terms[1], each.terms[2];
    normal += row.transpose() * row;
    right += row.transpose() * each.rate_rad_s;
  }
  // Slow motion is no evidence of extrinsic and clock: a rate of 0.01 rad/s counts as none.
  normal.bottomRightCorner<6, 6>().diagonal().array() += 1e-4 * static_cast<double>(watched.size());
  return normal.ldlt().solve(right);
}

/// Whether one term, found over all, stands out from what the parts find, the other terms given, and explains most.
bool stands_out(const std::vector<Watched>& watched, const Unknowns& unknowns, int term, double least) {
  const Eigen::Vector3d value = unknowns.segment<3>(3 * term);
  if (value.norm() < least) return false;
  std::array<Eigen::Matrix3d, kParts> normal;
  std::array<Eigen::Vector3d, kParts> right;
  normal.fill(1e-9 * Eigen::Matrix3d::Identity());
  right.fill(Eigen::Vector3d::Zero());
  double energy = 0, unexplained = 0;
  for (const Watched& each : watched) {
    Eigen::Vector3d others = Eigen::Vector3d::Zero();
    for (int k = 0; k < 3; ++k) {
      if (k != term) others += each.terms[k] * unknowns.segment<3>(3 * k);
    }
    const Eigen::Matrix3d& own = each.terms[term];
    normal[each.part] += own.transpose() * own;
    right[each.part] += own.transpose() * (each.rate_rad_s - others);
    energy += each.rate_rad_s.squaredNorm();
    unexplained += (each.rate_rad_s - own * value).squaredNorm();
  }
  if (2 * unexplained > energy) return false;
  double squares = 0;
  for (int part = 0; part < kParts; ++part) {
    squares += (normal[part].ldlt().solve(right[part]) - value).squaredNorm();
  }
  return value.norm() > kSignificance * std::sqrt(squares / (kParts * (kParts - 1)));
}

}  // namespace

std::optional<ResidualRotation> fit_residual_rotation(const ResidualField& residuals, const BlockGrid& grid,
                                                      const Camera& camera, const CameraMotion& motion,
                                                      const RowExposure& exposure) {
  const double middle_row = 0.5 * (grid.height_px() - 1);
  const TimeRange exposed{exposure.start(middle_row), exposure.end(middle_row)};
  if (residuals.empty() || !motion.covers(exposed)) return std::nullopt;
  // Neighbouring blocks have their velocities from the same corners: a regular part of many blocks knows as much.
  constexpr double kEnoughBlocks = 96;
  const int step = std::max(1, static_cast<int>(std::sqrt(grid.size() / kEnoughBlocks)));
  std::vector<Row> rotated, moved;
  std::size_t looked_at = 0;
  for (std::size_t i = 0; i < residuals.size(); ++i) {
    const int row = static_cast<int>(i) / grid.cols(), col = static_cast<int>(i) % grid.cols();
    if (row % step != 0 || col % step != 0) continue;
    ++looked_at;
    if (!residuals[i]) continue;
    const Eigen::Vector3d ray = camera.ray(grid.center(static_cast<int>(i)));
    if (!ray.allFinite()) continue;
    const Columns jacobian = projection_jacobian(camera, ray);
    if (!jacobian.allFinite()) continue;
    const double weight = 1 / (residuals[i]->stddev_px_s * residuals[i]->stddev_px_s);
    // In a camera that rotates by w and moves by t, the direction r at depth d moves by -w x r and -t / d.
    rotated.push_back({jacobian * cross_matrix(ray), residuals[i]->velocity_px_s, weight});
    moved.push_back({-jacobian, residuals[i]->velocity_px_s, weight});
  }
  if (rotated.empty() || 2 * rotated.size() < looked_at) return std::nullopt;
  ResidualRotation rotation;
  rotation.rate_rad_s = robust_fit(rotated);
  // Directions rotate in the opposite direction to the camera.
  const Eigen::AngleAxisd known(motion.rotation(exposed.begin_ns, exposed.end_ns));
  rotation.known_rad_s = -known.angle() / to_seconds(exposed.end_ns - exposed.begin_ns) * known.axis();
  rotation.energy_px2_s2 = energy_less(rotated, Eigen::Vector3d::Zero());
  rotation.energy_less_rotation_px2_s2 = energy_less(rotated, rotation.rate_rad_s);
  rotation.energy_less_translation_px2_s2 = energy_less(moved, robust_fit(moved));
  return rotation;
}

void GyroErrorWatch::add(TimeNs t_ns, const ResidualRotation& rotation) {
  if (!entries_.empty() && (t_ns <= entries_.back().t_ns || t_ns - entries_.back().t_ns > kLongestBreakNs)) clear();
  entries_.push_back({t_ns, rotation});
  while (t_ns - entries_.front().t_ns > kWatchedNs) entries_.pop_front();
}

std::optional<GyroError> GyroErrorWatch::find() const {
  if (entries_.size() < kLeastFrames) return std::nullopt;
  const TimeNs begin_ns = entries_.front().t_ns, span_ns = entries_.back().t_ns - begin_ns;
  if (span_ns < kLeastNs) return std::nullopt;
  double energy = 0, less_rotation = 0, less_translation = 0;
  std::vector<Watched> watched;
  for (std::size_t i = 1; i + 1 < entries_.size(); ++i) {
    const ResidualRotation& rotation = entries_[i].rotation;
    const Entry &before = entries_[i - 1], &after = entries_[i + 1];
    energy += rotation.energy_px2_s2;
    less_rotation += rotation.energy_less_rotation_px2_s2;
    less_translation += rotation.energy_less_translation_px2_s2;
    const auto part = static_cast<int>(kParts * (entries_[i].t_ns - begin_ns) / (span_ns + 1));
    Eigen::Matrix3d change = Eigen::Matrix3d::Zero();
    change.col(0) = (after.rotation.known_rad_s - before.rotation.known_rad_s) / to_seconds(after.t_ns - before.t_ns);
    watched.push_back(
        {part, rotation.rate_rad_s, {Eigen::Matrix3d::Identity(), -cross_matrix(rotation.known_rad_s), change}});
  }
  if (2 * less_rotation > energy || less_rotation > less_translation) return std::nullopt;
  const Unknowns unknowns = solve(watched);
  GyroError error;
  error.seconds = to_seconds(span_ns);
  if (stands_out(watched, unknowns, 0, kLeastBiasRadS)) {
    error.kind = GyroError::Kind::BIAS;
    error.vector = -unknowns.segment<3>(0);
  } else if (stands_out(watched, unknowns, 1, kLeastRotationRad)) {
    error.kind = GyroError::Kind::EXTRINSIC;
    error.vector = unknowns.segment<3>(3);
  } else if (stands_out(watched, unknowns, 2, kLeastOffsetS)) {
    error.kind = GyroError::Kind::TIME_OFFSET;
    error.time_offset_s = unknowns[6];
  } else {
    return std::nullopt;
  }
  return error;
}

}  // namespace gyro_deblur
