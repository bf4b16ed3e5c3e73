// Fits the translation between two images and rejects the points that contradict it.
#include "features/epipolar_check.hpp"

#include <algorithm>
#include <cstddef>
#include <limits>
#include <random>

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
      : rotated_(rotated), focal_px_(focal_px), max_px2_(max_distance_px * max_distance_px) {
    for (std::size_t i = 0; i < rotated.size(); ++i) {
      normals_.push_back(rotated[i].cross(seen[i]));
      moved_px2_.push_back((focal_px * (seen[i] - rotated[i])).squaredNorm());
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

 private:
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

  const std::vector<Eigen::Vector3d>& rotated_;
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
  const std::vector<Eigen::Vector3d> rotated = with_unit_depth(rotated_rays), seen = with_unit_depth(seen_rays);
  std::vector<char> agrees(rotated.size(), true);
  if (rotated.size() < kMinPoints) return agrees;
  const Translation translation(rotated, seen, focal_px, max_distance_px);
  const Eigen::Vector3d direction = translation.find();
  std::size_t count = 0;
  for (std::size_t i = 0; i < rotated.size(); ++i) {
    agrees[i] = translation.distance_px2(i, direction) <= max_distance_px * max_distance_px;
    count += agrees[i] ? 1 : 0;
  }
  if (static_cast<double>(count) >= kLeastShare * static_cast<double>(rotated.size())) return agrees;
  return agree_with_any(rotated, seen, focal_px, max_distance_px);
}

}  // namespace gyro_deblur
