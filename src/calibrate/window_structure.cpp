// Eliminates the depths of a window and solves for the rest.
#include "calibrate/window_structure.hpp"

#include <cmath>
#include <utility>

#include <Eigen/Cholesky>

namespace gyro_deblur {
namespace {

/// Inverse depths scatter by half of their mean: a room, a street. It determines the scale, and with it how long a path
/// that is not seen may be; points that are seen to move outweigh it by far.
constexpr double kInverseDepthScatter = 0.5;

/// A point that left the image's range costs as much as a gross error.
constexpr double kGrossPx = 1e3;

/// Cauchy's scale has 95 % efficiency for Gaussian residuals at this many standard deviations.
constexpr double kCauchyScale = 2.385;

using ProjectionDerivative = Eigen::Matrix<double, 2, 3>;

/// Derivative of the pixel by the ray.
/// @param px  of the ray
ProjectionDerivative derivative_of_projection(const Camera& camera, const Eigen::Vector3d& ray,
                                              const Eigen::Vector2d& px) {
  const double step = 1e-6 * ray.norm();
  ProjectionDerivative J;
  for (int k = 0; k < 2; ++k) J.col(k) = (camera.project(ray + step * Eigen::Vector3d::Unit(k)) - px) / step;
  // The ray's length does not matter.
  J.col(2) = -(J.col(0) * ray.x() + J.col(1) * ray.y()) / ray.z();
  return J;
}

/// Weight of a prior with this standard deviation, where a square of pixels costs 1.
double prior_weight(double noise_px, double stddev) { return noise_px * noise_px / (stddev * stddev); }

}  // namespace

/// Of timing and positions, in this order, and inverse depths, each of which affects only its own point's sightings.
struct WindowFit::Equations {
  struct Depth {
    double h = 0, gradient = 0;
    Eigen::VectorXd coupling;
  };
  Eigen::MatrixXd H;
  Eigen::VectorXd gradient;
  std::vector<Depth> depths;

  /// Without the depths. @param damping  of Levenberg and Marquardt
  std::pair<Eigen::MatrixXd, Eigen::VectorXd> without_depths(double damping) const {
    Eigen::MatrixXd S = H;
    Eigen::VectorXd g = gradient;
    S.diagonal() *= 1 + damping;
    for (const Depth& depth : depths) {
      const double inverse = 1 / (depth.h * (1 + damping));
      S.noalias() -= inverse * depth.coupling.lazyProduct(depth.coupling.transpose());
      g -= depth.coupling * (depth.gradient * inverse);
    }
    return {S, g};
  }
};

WindowFit::WindowFit(const Camera& camera, const WindowPoints& points, std::vector<Eigen::Vector3d> rotated_rays,
                     std::vector<Passage> passages, Eigen::VectorXd frames_s)
    : camera_(camera),
      points_(points),
      rotated_rays_(std::move(rotated_rays)),
      passages_(std::move(passages)),
      frames_s_(std::move(frames_s)) {}

WindowStructure WindowFit::at_rest() const {
  return {Eigen::VectorXd::Zero(3 * frames_s_.size()),
          Eigen::VectorXd::Ones(static_cast<Eigen::Index>(points_.anchors.size()))};
}

Eigen::Vector3d WindowFit::displacement(std::size_t sighting, const WindowStructure& structure) const {
  const Passage& passage = passages_[sighting];
  return passage.R_to_reference *
         (Eigen::Map<const Eigen::Matrix3Xd>(structure.positions.data(), 3, frames_s_.size()) * passage.shares);
}

Eigen::Vector3d WindowFit::ray(std::size_t sighting, const WindowStructure& structure) const {
  const double inverse_depth = structure.inverse_depths[static_cast<Eigen::Index>(points_.sightings[sighting].anchor)];
  return rotated_rays_[sighting] - inverse_depth * displacement(sighting, structure);
}

std::vector<Eigen::Vector2d> WindowFit::residuals(const WindowStructure& structure) const {
  std::vector<Eigen::Vector2d> result;
  result.reserve(points_.sightings.size());
  for (std::size_t i = 0; i < points_.sightings.size(); ++i) {
    result.emplace_back(points_.sightings[i].px - camera_.project(ray(i, structure)));
  }
  return result;
}

double WindowFit::cost(const WindowStructure& structure, const StructurePriors& priors) const {
  const double scale_px = kCauchyScale * priors.noise_px;
  double cost = 0;
  for (const Eigen::Vector2d& residual : residuals(structure)) {
    const double length_px = residual.allFinite() ? std::min(residual.norm(), kGrossPx) : kGrossPx;
    cost += scale_px * scale_px * std::log1p(length_px * length_px / (scale_px * scale_px));
  }
  cost += prior_weight(priors.noise_px, kInverseDepthScatter) * (structure.inverse_depths.array() - 1).square().sum();
  for (Eigen::Index k = 0; k < frames_s_.size(); ++k) {
    cost += prior_weight(priors.noise_px, priors.speed_per_s * frames_s_[k]) *
            structure.positions.segment<3>(3 * k).squaredNorm();
  }
  return cost;
}

WindowFit::Equations WindowFit::linearise(const WindowStructure& structure, const StructurePriors& priors,
                                          const std::vector<Eigen::Matrix3Xd>* derivatives) const {
  const Eigen::Index timings = derivatives == nullptr || derivatives->empty() ? 0 : derivatives->front().cols();
  const Eigen::Index size = timings + 3 * frames_s_.size();
  const double depth_weight = prior_weight(priors.noise_px, kInverseDepthScatter);
  const double scale_px = kCauchyScale * priors.noise_px;
  Equations equations{Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size), {}};
  for (Eigen::Index i = 0; i < structure.inverse_depths.size(); ++i) {
    equations.depths.push_back(
        {depth_weight, depth_weight * (structure.inverse_depths[i] - 1), Eigen::VectorXd::Zero(size)});
  }
  for (Eigen::Index k = 0; k < frames_s_.size(); ++k) {
    const double weight = prior_weight(priors.noise_px, priors.speed_per_s * frames_s_[k]);
    equations.H.diagonal().segment<3>(timings + 3 * k).setConstant(weight);
    equations.gradient.segment<3>(timings + 3 * k) = weight * structure.positions.segment<3>(3 * k);
  }
  Eigen::Matrix2Xd J(2, size);
  for (std::size_t i = 0; i < points_.sightings.size(); ++i) {
    const Sighting& sighting = points_.sightings[i];
    const Passage& passage = passages_[i];
    const Eigen::Vector3d seen = ray(i, structure);
    const Eigen::Vector2d predicted = camera_.project(seen), residual = sighting.px - predicted;
    const ProjectionDerivative projection = derivative_of_projection(camera_, seen, predicted);
    if (!residual.allFinite() || !projection.allFinite()) continue;
    if (timings > 0) J.leftCols(timings) = -projection * (*derivatives)[i];
    if (!J.leftCols(timings).allFinite()) continue;
    const ProjectionDerivative by_displacement =
        structure.inverse_depths[static_cast<Eigen::Index>(sighting.anchor)] * projection * passage.R_to_reference;
    for (Eigen::Index k = 0; k < frames_s_.size(); ++k) {
      J.middleCols<3>(timings + 3 * k) = passage.shares[k] * by_displacement;
    }
    const Eigen::Vector2d by_depth = projection * displacement(i, structure);
    const double weight = 1 / (1 + residual.squaredNorm() / (scale_px * scale_px));
    Equations::Depth& depth = equations.depths[sighting.anchor];
    equations.H.noalias() += weight * J.transpose().lazyProduct(J);
    equations.gradient.noalias() += weight * J.transpose().lazyProduct(residual);
    depth.h += weight * by_depth.squaredNorm();
    depth.gradient += weight * by_depth.dot(residual);
    depth.coupling.noalias() += weight * J.transpose().lazyProduct(by_depth);
  }
  return equations;
}

double WindowFit::improve(WindowStructure* structure, const StructurePriors& priors) const {
  constexpr int kMaxIterations = 30;
  constexpr double kDone = 1e-7, kMostDamping = 1e6;
  double least = cost(*structure, priors), damping = 1e-4;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const Equations equations = linearise(*structure, priors, nullptr);
    const double before = least;
    for (; damping < kMostDamping; damping *= 10) {
      const auto [S, g] = equations.without_depths(damping);
      const Eigen::VectorXd step = -S.ldlt().solve(g);
      WindowStructure next = *structure;
      next.positions += step;
      for (std::size_t i = 0; i < equations.depths.size(); ++i) {
        const Equations::Depth& depth = equations.depths[i];
        next.inverse_depths[static_cast<Eigen::Index>(i)] -=
            (depth.gradient + depth.coupling.dot(step)) / (depth.h * (1 + damping));
      }
      const double next_cost = cost(next, priors);
      if (!(next_cost < least)) continue;
      *structure = next;
      least = next_cost;
      damping /= 10;
      break;
    }
    if (!(before - least > kDone * before)) break;
  }
  return least;
}

ReducedEquations WindowFit::reduce(const WindowStructure& structure, const StructurePriors& priors,
                                   const std::vector<Eigen::Matrix3Xd>& derivatives) const {
  const auto [S, g] = linearise(structure, priors, &derivatives).without_depths(0);
  const Eigen::Index positions = structure.positions.size(), timings = g.size() - positions;
  const Eigen::LDLT<Eigen::MatrixXd> inner(S.bottomRightCorner(positions, positions));
  const Eigen::MatrixXd coupling = S.topRightCorner(timings, positions);
  return {S.topLeftCorner(timings, timings) - coupling * inner.solve(coupling.transpose()),
          g.head(timings) - coupling * inner.solve(g.tail(positions))};
}

double WindowFit::add_speeds(const WindowStructure& structure, const StructurePriors& priors, double* squares,
                             double* count) const {
  const Equations equations = linearise(structure, priors, nullptr);
  const Eigen::MatrixXd S = equations.without_depths(0).first;
  const Eigen::MatrixXd inverse = S.ldlt().solve(Eigen::MatrixXd::Identity(S.rows(), S.cols()));
  for (Eigen::Index k = 0; k < frames_s_.size(); ++k) {
    const double weight = prior_weight(priors.noise_px, priors.speed_per_s * frames_s_[k]);
    *squares += structure.positions.segment<3>(3 * k).squaredNorm() / (frames_s_[k] * frames_s_[k]);
    *count += 3 - weight * inverse.diagonal().segment<3>(3 * k).sum();
  }
  double depths = 0;
  for (const Equations::Depth& depth : equations.depths) {
    depths += 1 - prior_weight(priors.noise_px, kInverseDepthScatter) / depth.h;
  }
  return depths;
}

}  // namespace gyro_deblur
