// Fits the translation between two images and rejects the points that contradict it.
#include "features/epipolar_check.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <utility>

#include <Eigen/Dense>
#include <opencv2/calib3d.hpp>

namespace gyro_deblur {
namespace {

/// The fundamental matrix has seven degrees of freedom; OpenCV's RANSAC wants eight points.
constexpr std::size_t kMinPoints = 8;

std::vector<Eigen::Vector3d> with_unit_depth(std::vector<Eigen::Vector3d> rays) {
  for (Eigen::Vector3d& ray : rays) ray /= ray.z();
  return rays;
}

/// Motion of points that the rotation does not explain.
class Translation {
 public:
  Translation(const std::vector<Eigen::Vector3d>& rotated, const std::vector<Eigen::Vector3d>& seen, double focal_px,
              double max_distance_px)
      : rotated_(rotated), seen_(seen), focal_px_(focal_px), max_px2_(max_distance_px * max_distance_px) {
    compare();
  }

  /// Whether each point is near its epipolar line.
  std::vector<char> agree(const Eigen::Vector3d& direction) const {
    std::vector<char> agrees;
    for (std::size_t i = 0; i < normals_.size(); ++i) agrees.push_back(distance_px2(i, direction) <= max_px2_);
    return agrees;
  }

  /// RANSAC: most points, and nearest.
  Eigen::Vector3d find() const {
    // Motion below the error of Lucas-Kanade has no usable direction.
    constexpr double kLeastPx = 0.3;
    constexpr int kSamples = 60;  // of two points: one of two right ones is among them, were half of all points wrong
    std::vector<std::size_t> moved;
    for (std::size_t i = 0; i < normals_.size(); ++i) {
      if (moved_px2_[i] > kLeastPx * kLeastPx) moved.push_back(i);
    }
    Eigen::Vector3d best = Eigen::Vector3d::UnitX();
    double least = cost(best, std::numeric_limits<double>::infinity());
    if (moved.size() < 2) return best;
    std::mt19937 random(1);
    for (int sample = 0; sample < kSamples; ++sample) {
      const std::size_t first = moved[random() % moved.size()], second = moved[random() % moved.size()];
      const Eigen::Vector3d direction = normals_[first].cross(normals_[second]);
      const double length = direction.norm();
      if (!(length > 0)) continue;
      try_direction(direction / length, &best, &least);
    }
    // Two points are less accurate than all that agree with them.
    constexpr int kRefinements = 2;
    for (int refinement = 0; refinement < kRefinements; ++refinement) try_direction(refined(best), &best, &least);
    return best;
  }

  /// Takes out of the points' motion a small rotation that most of them share, and adapts the direction.
  void correct_rotation(Eigen::Vector3d* direction) {
    constexpr int kIterations = 5;
    const std::vector<Eigen::Vector3d> given = rotated_;
    Eigen::Vector3d rotation_rad = Eigen::Vector3d::Zero();
    for (int iteration = 0; iteration < kIterations; ++iteration) {
      step_rotation(direction, &rotation_rad);
      for (std::size_t i = 0; i < given.size(); ++i) rotated_[i] = given[i] + rotation_rad.cross(given[i]);
      rotated_ = with_unit_depth(std::move(rotated_));
      compare();
    }
  }

 private:
  /// Makes normals_ and moved_px2_.
  void compare() {
    normals_.clear();
    moved_px2_.clear();
    for (std::size_t i = 0; i < rotated_.size(); ++i) {
      normals_.push_back(rotated_[i].cross(seen_[i]));
      moved_px2_.push_back((focal_px_ * (seen_[i] - rotated_[i])).squaredNorm());
    }
  }
  /// Squared distance from the epipolar line, which goes through where the rotation alone takes the point.
  double distance_px2(std::size_t i, const Eigen::Vector3d& direction) const {
    const double along = (direction.cross(rotated_[i])).head<2>().squaredNorm(),
                 across = focal_px_ * direction.dot(normals_[i]);
    return std::min(moved_px2_[i], across * across / std::max(along, std::numeric_limits<double>::min()));
  }
  /// Sum of the squared distances, each limited.
  double cost(const Eigen::Vector3d& direction, double best) const {
    double sum = 0;
    for (std::size_t i = 0; i < normals_.size() && sum < best; ++i) {
      sum += std::min(max_px2_, distance_px2(i, direction));
    }
    return sum;
  }
  /// Robust Gauss-Newton step.
  void step_rotation(Eigen::Vector3d* direction, Eigen::Vector3d* rotation_rad) const {
    // What a bias of 0.02 rad/s, or a readout time that is some milliseconds off, leaves between two images; and the
    // error of a corner. With 1 px for the rotation more wrong corners stay in 140 px of blur (doc/reports/tracks.md).
    constexpr double kRotationPx = 0.4, kNoisePx = 0.3;
    constexpr double kLeastWeight = 1e-6;  // of the direction: there may be no translation
    Eigen::Matrix<double, 3, 2> tangents;
    tangents.col(0) = direction->unitOrthogonal();
    tangents.col(1) = direction->cross(tangents.col(0));
    Eigen::Matrix<double, 5, 1> weights = Eigen::Matrix<double, 5, 1>::Constant(kLeastWeight);
    weights.head<3>().setConstant(std::pow(focal_px_ / kRotationPx, 2));
    Eigen::Matrix<double, 5, 5> normal = weights.asDiagonal();
    Eigen::Matrix<double, 5, 1> right = Eigen::Matrix<double, 5, 1>::Zero();
    right.head<3>() = weights.head<3>().cwiseProduct(*rotation_rad);
    for (std::size_t i = 0; i < normals_.size(); ++i) {
      const Eigen::Vector3d &from = rotated_[i], &to = seen_[i];
      const double along = direction->cross(from).head<2>().norm();
      if (!(along > 0)) continue;
      const double scale = focal_px_ / (along * kNoisePx), error = scale * direction->dot(normals_[i]);
      const double weight = scale / (1 + error * error / 4);  // Cauchy's, of two standard deviations
      Eigen::Matrix<double, 5, 1> jacobian;
      jacobian << direction->dot(from) * to - from.dot(to) * *direction, tangents.transpose() * normals_[i];
      normal += weight * scale * jacobian * jacobian.transpose();
      right += weight * error * jacobian;
    }
    const Eigen::Matrix<double, 5, 1> step = -normal.ldlt().solve(right);
    *rotation_rad += step.head<3>();
    *direction = (*direction + tangents * step.tail<2>()).normalized();
  }
  void try_direction(const Eigen::Vector3d& direction, Eigen::Vector3d* best, double* least) const {
    const double sum = cost(direction, *least);
    if (!(sum < *least)) return;
    *least = sum;
    *best = direction;
  }
  /// Least squares of the distances of those within the limit.
  Eigen::Vector3d refined(const Eigen::Vector3d& start) const {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < normals_.size(); ++i) {
      if (distance_px2(i, start) >= max_px2_) continue;
      const double along = start.cross(rotated_[i]).head<2>().squaredNorm();
      if (along > 0) sum += normals_[i] * normals_[i].transpose() / along;
    }
    return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(sum).eigenvectors().col(0);
  }

  std::vector<Eigen::Vector3d> rotated_;
  const std::vector<Eigen::Vector3d>& seen_;
  double focal_px_, max_px2_;
  std::vector<Eigen::Vector3d> normals_;  // of the planes of both directions
  std::vector<double> moved_px2_;
};

/// Without any assumption about the rotation.
std::vector<char> agree_with_any(const std::vector<Eigen::Vector3d>& rotated, const std::vector<Eigen::Vector3d>& seen,
                                 double focal_px, double max_distance_px) {
  constexpr double kConfidence = 0.99;
  std::vector<cv::Point2f> before, after;
  const auto pixel = [focal_px](const Eigen::Vector3d& ray) {
    return cv::Point2f(static_cast<float>(focal_px * ray.x()), static_cast<float>(focal_px * ray.y()));
  };
  for (std::size_t i = 0; i < rotated.size(); ++i) {
    before.push_back(pixel(rotated[i]));
    after.push_back(pixel(seen[i]));
  }
  std::vector<uchar> inliers;
  cv::setRNGSeed(1);
  cv::findFundamentalMat(before, after, cv::FM_RANSAC, max_distance_px, kConfidence, inliers);
  std::vector<char> agrees(rotated.size(), true);
  if (inliers.size() != rotated.size()) return agrees;  // no matrix found: nothing to disagree with
  for (std::size_t i = 0; i < rotated.size(); ++i) {
    // What stays where the rotation takes it is right whatever the direction of translation.
    agrees[i] = inliers[i] != 0 || cv::norm(after[i] - before[i]) <= max_distance_px;
  }
  return agrees;
}

}  // namespace

std::vector<char> agree_with_epipolar_geometry(const std::vector<Eigen::Vector3d>& rotated_rays,
                                               const std::vector<Eigen::Vector3d>& seen_rays, double focal_px,
                                               double max_distance_px) {
  constexpr double kLeastShare = 0.7;
  constexpr double kNearlyAll = 0.97;  // of a static scene's points: the rotation needs no correction
  const std::vector<Eigen::Vector3d> rotated = with_unit_depth(rotated_rays), seen = with_unit_depth(seen_rays);
  if (rotated.size() < kMinPoints) return std::vector<char>(rotated.size(), true);
  Translation translation(rotated, seen, focal_px, max_distance_px);
  Eigen::Vector3d direction = translation.find();
  std::vector<char> agrees = translation.agree(direction);
  const auto share = [](const std::vector<char>& of) {
    return static_cast<double>(std::count(of.begin(), of.end(), true)) / static_cast<double>(of.size());
  };
  if (share(agrees) < kNearlyAll) {
    translation.correct_rotation(&direction);
    std::vector<char> corrected = translation.agree(direction);
    if (share(corrected) > share(agrees)) agrees = std::move(corrected);
  }
  if (share(agrees) >= kLeastShare) return agrees;
  return agree_with_any(rotated, seen, focal_px, max_distance_px);
}

}  // namespace gyro_deblur
