#include "evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <set>
#include <stdexcept>
#include <tuple>

#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>

#include "base/require_range.hpp"
#include "gyro_deblur/keypoints.hpp"

namespace gyro_deblur::experiments {
namespace {

// SIFT's own defaults (Lowe 2004) but for the contrast threshold: the number of detections is fixed by response.
constexpr int kSiftOctaveLayers = 3;
constexpr double kSiftContrastThreshold = 0;
constexpr double kSiftEdgeThreshold = 10;
constexpr double kSiftSigma = 1.6;

cv::Ptr<cv::Feature2D> make_sift() {
  return cv::SIFT::create(0, kSiftOctaveLayers, kSiftContrastThreshold, kSiftEdgeThreshold, kSiftSigma);
}

bool stronger(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  // The rest of the key makes the order total: several threads may deliver equal responses in any order.
  return std::make_tuple(-a.response, a.pt.y, a.pt.x, a.size, a.angle) <
         std::make_tuple(-b.response, b.pt.y, b.pt.x, b.size, b.angle);
}

bool is_inside(const cv::Point2d& point, const cv::Size& size) {
  return point.x >= 0 && point.y >= 0 && point.x <= size.width - 1 && point.y <= size.height - 1;
}

double distance(const cv::Point2d& a, const cv::Point2d& b) { return std::hypot(a.x - b.x, a.y - b.y); }

Homography estimate_homography(const std::vector<cv::Point2f>& points1, const std::vector<cv::Point2f>& points2,
                               double ransac_px) {
  constexpr std::size_t kMinPoints = 4;
  if (points1.size() < kMinPoints) return Homography::zeros();
  const cv::Mat estimate = cv::findHomography(points1, points2, cv::RANSAC, ransac_px);
  return estimate.empty() ? Homography::zeros() : Homography(estimate.ptr<double>());
}

double mean_corner_error(const Homography& estimate, const Homography& truth, const cv::Size& size) {
  if (std::abs(cv::determinant(estimate)) < 1e-12) return std::numeric_limits<double>::infinity();
  double sum = 0;
  for (const double x : {0.0, size.width - 1.0}) {
    for (const double y : {0.0, size.height - 1.0}) sum += distance(project(estimate, {x, y}), project(truth, {x, y}));
  }
  return sum / 4;
}

}  // namespace

Homography read_homography(const std::string& path) {
  std::ifstream file(path);
  Homography H;
  for (double& value : H.val) {
    if (!(file >> value)) throw std::runtime_error(path + ": does not hold three rows of three numbers");
  }
  if (!(std::abs(cv::determinant(H)) > 1e-12)) throw std::runtime_error(path + ": the homography is singular");
  return H;
}

cv::Point2d project(const Homography& H, const cv::Point2d& point_px) {
  const cv::Vec3d p = H * cv::Vec3d(point_px.x, point_px.y, 1);
  return {p[0] / p[2], p[1] / p[2]};
}

double local_scale(const Homography& H, const cv::Point2d& point_px) {
  const double w = H(2, 0) * point_px.x + H(2, 1) * point_px.y + H(2, 2);
  return std::sqrt(std::abs(cv::determinant(H) / (w * w * w)));
}

double disc_overlap(double radius1_px, double radius2_px, double distance_px) {
  const double r = radius1_px, s = radius2_px, d = distance_px;
  if (d >= r + s) return 0;
  const double smaller = std::min(r, s), larger = std::max(r, s);
  if (d <= larger - smaller) return smaller * smaller / (larger * larger);
  // Two circular segments on either side of the common chord, which lies at `a` from the first centre.
  const double a = (d * d + r * r - s * s) / (2 * d), b = d - a;
  const auto segment = [](double radius, double to_chord) {
    const double half_angle = std::acos(std::clamp(to_chord / radius, -1.0, 1.0));
    return radius * radius * (half_angle - std::sin(2 * half_angle) / 2);
  };
  const double common = segment(r, a) + segment(s, b);
  return common / (CV_PI * (r * r + s * s) - common);
}

std::vector<cv::KeyPoint> without_duplicates(const std::vector<cv::KeyPoint>& keypoints) {
  std::set<std::tuple<float, float, float>> seen;
  std::vector<cv::KeyPoint> unique;
  for (const cv::KeyPoint& keypoint : keypoints) {
    if (seen.emplace(keypoint.pt.x, keypoint.pt.y, keypoint.size).second) unique.push_back(keypoint);
  }
  return unique;
}

std::vector<cv::KeyPoint> strongest_in_common_region(const std::vector<cv::KeyPoint>& keypoints,
                                                     const Homography& H_other_own, const cv::Size& other_size,
                                                     int count) {
  std::vector<cv::KeyPoint> chosen;
  for (const cv::KeyPoint& keypoint : keypoints) {
    if (is_inside(project(H_other_own, keypoint.pt), other_size)) chosen.push_back(keypoint);
  }
  std::stable_sort(chosen.begin(), chosen.end(),
                   [](const cv::KeyPoint& a, const cv::KeyPoint& b) { return a.response > b.response; });
  chosen.resize(std::min(chosen.size(), static_cast<std::size_t>(count)));
  return chosen;
}

void OverlapOptions::validate() const {
  require_range("min_overlap", min_overlap, 1e-6, 1);
  require_range("radius_factor", radius_factor, 1e-6, 100);
  require_range("normalized_radius", normalized_radius_px, 0, 1000, "px");
}

std::vector<Correspondence> find_correspondences(const std::vector<cv::KeyPoint>& keypoints1,
                                                 const std::vector<cv::KeyPoint>& keypoints2, const Homography& H_2_1,
                                                 const OverlapOptions& options) {
  options.validate();
  struct Disc {
    cv::Point2d center;
    double radius;
  };
  const Homography H_1_2 = H_2_1.inv();
  std::vector<Disc> discs2;
  for (const cv::KeyPoint& keypoint : keypoints2) {
    discs2.push_back(
        {project(H_1_2, keypoint.pt), options.radius_factor * keypoint.size * local_scale(H_1_2, keypoint.pt)});
  }
  std::vector<Correspondence> candidates;
  for (std::size_t i = 0; i < keypoints1.size(); ++i) {
    const cv::Point2d center = keypoints1[i].pt;
    const double radius = options.radius_factor * keypoints1[i].size;
    const double magnification = options.normalized_radius_px > 0 ? options.normalized_radius_px / radius : 1;
    for (std::size_t j = 0; j < discs2.size(); ++j) {
      const double error = distance(center, discs2[j].center);
      const double overlap = disc_overlap(magnification * radius, magnification * discs2[j].radius, error);
      if (overlap >= options.min_overlap) {
        candidates.push_back({static_cast<int>(i), static_cast<int>(j), overlap, error});
      }
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Correspondence& a, const Correspondence& b) { return a.overlap > b.overlap; });
  std::vector<bool> taken1(keypoints1.size(), false), taken2(keypoints2.size(), false);
  std::vector<Correspondence> found;
  for (const Correspondence& candidate : candidates) {
    if (taken1[candidate.index1] || taken2[candidate.index2]) continue;
    taken1[candidate.index1] = taken2[candidate.index2] = true;
    found.push_back(candidate);
  }
  return found;
}

Repeatability evaluate_repeatability(const std::vector<cv::KeyPoint>& keypoints1, const cv::Size& size1,
                                     const std::vector<cv::KeyPoint>& keypoints2, const cv::Size& size2,
                                     const Homography& H_2_1, int count, const OverlapOptions& options) {
  const auto chosen1 = strongest_in_common_region(keypoints1, H_2_1, size2, count);
  const auto chosen2 = strongest_in_common_region(keypoints2, H_2_1.inv(), size1, count);
  const auto found = find_correspondences(chosen1, chosen2, H_2_1, options);
  Repeatability result;
  result.keypoints1 = static_cast<int>(chosen1.size());
  result.keypoints2 = static_cast<int>(chosen2.size());
  result.correspondences = static_cast<int>(found.size());
  const int fewer = std::min(result.keypoints1, result.keypoints2);
  if (fewer > 0) result.ratio = static_cast<double>(found.size()) / fewer;
  double sum = 0;
  for (const Correspondence& correspondence : found) sum += correspondence.error_px;
  result.error_px = found.empty() ? std::numeric_limits<double>::quiet_NaN() : sum / found.size();
  return result;
}

void MatchingOptions::validate() const {
  require_range("max_keypoints", max_keypoints, 1, 100000);
  require_range("max_ratio", max_ratio, 1e-6, 1);
  require_range("max_error", max_error_px, 1e-6, 1000, "px");
  require_range("ransac", ransac_px, 1e-6, 100, "px");
  require_range("max_corner_error", max_corner_error_px, 1e-6, 1000, "px");
}

Matching evaluate_matching(const Features& features1, const cv::Size& size1, const Features& features2,
                           const Homography& H_2_1, const MatchingOptions& options) {
  options.validate();
  Matching result;
  result.corner_error_px = std::numeric_limits<double>::infinity();
  const int n1 = std::min(features1.descriptors.rows, options.max_keypoints);
  const int n2 = std::min(features2.descriptors.rows, options.max_keypoints);
  if (n1 == 0 || n2 < 2) return result;  // no second nearest, no ratio

  const int norm = features1.descriptors.depth() == CV_8U ? cv::NORM_HAMMING : cv::NORM_L2;
  std::vector<std::vector<cv::DMatch>> nearest;
  cv::BFMatcher(norm).knnMatch(features1.descriptors.rowRange(0, n1), features2.descriptors.rowRange(0, n2), nearest,
                               2);
  std::vector<cv::Point2f> points1, points2;
  for (const std::vector<cv::DMatch>& two : nearest) {
    if (two.size() < 2 || two[0].distance > options.max_ratio * two[1].distance) continue;
    points1.push_back(features1.keypoints[two[0].queryIdx].pt);
    points2.push_back(features2.keypoints[two[0].trainIdx].pt);
    if (distance(project(H_2_1, points1.back()), points2.back()) <= options.max_error_px) ++result.correct;
  }
  result.matches = static_cast<int>(points1.size());
  result.corner_error_px = mean_corner_error(estimate_homography(points1, points2, options.ransac_px), H_2_1, size1);
  result.homography_found = result.corner_error_px <= options.max_corner_error_px;
  return result;
}

std::vector<cv::KeyPoint> detect_dog(const cv::Mat& image) {
  if (image.type() != CV_8UC1) throw std::invalid_argument("DoG keypoints are detected on CV_8UC1");
  std::vector<cv::KeyPoint> keypoints;
  make_sift()->detect(image, keypoints);
  std::sort(keypoints.begin(), keypoints.end(), stronger);
  return without_duplicates(keypoints);
}

Features extract_sift(const cv::Mat& image, int count) {
  if (image.type() != CV_8UC1) throw std::invalid_argument("SIFT features are extracted from CV_8UC1");
  Features features;
  const cv::Ptr<cv::Feature2D> sift = make_sift();
  sift->detect(image, features.keypoints);
  std::sort(features.keypoints.begin(), features.keypoints.end(), stronger);
  features.keypoints = without_duplicates(features.keypoints);
  features.keypoints.resize(std::min(features.keypoints.size(), static_cast<std::size_t>(count)));
  sift->compute(image, features.keypoints, features.descriptors);
  return features;
}

Features extract_orb(const cv::Mat& image, int count) {
  // Everything but the thresholds as FeatureExtractor has it, whose FAST threshold is the same.
  KeypointOptions options;
  options.detector = options.descriptor = "ORB";
  options.max_keypoints = count;
  return FeatureExtractor(options).extract(image);
}

}  // namespace gyro_deblur::experiments
