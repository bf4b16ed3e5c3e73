#include "features/residual_flow.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "base/median.hpp"
#include "features/corner_prediction.hpp"

namespace gyro_deblur {
namespace {

constexpr double kCornerQuality = 0.01;
/// Over a longer one a mean velocity says little of the one within an exposure.
constexpr TimeNs kLongestStepNs = 250'000'000;
/// What Lucas-Kanade leaves on blurred frames where all neighbours agree, in the smaller image [px].
constexpr double kFloorPx = 0.1;
/// Of the change that is carried on: a velocity need not go on changing as it did. Measured on recorded flights.
constexpr double kDoubtOfChange = 0.25;

bool inside(const cv::Point2f& p, const cv::Size& size, float margin) {
  return p.x >= margin && p.y >= margin && p.x <= static_cast<float>(size.width - 1) - margin &&
         p.y <= static_cast<float>(size.height - 1) - margin;
}

}  // namespace

std::optional<TimeRange> ResidualFlow::newest_frame() const {
  if (!exposure_) return std::nullopt;
  return exposure_->frame();
}

void ResidualFlow::reset() {
  exposure_.reset();
  samples_.clear();
  corners_.clear();
  means_.clear();
}

cv::Mat ResidualFlow::shrink(const cv::Mat& luminance) {
  cv::Mat small = luminance;
  for (scale_ = 1; small.cols > options_.largest_width_px; scale_ *= 2) {
    cv::Mat half;
    cv::pyrDown(small, half);  // its pixel (x, y) is at (2 x, 2 y)
    small = half;
  }
  return small;
}

ResidualField ResidualFlow::follow(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                   const RowExposure& exposure, const BlockGrid& grid) {
  if (exposure_) {
    const TimeNs step_ns = exposure.start(0) - exposure_->start(0);
    if (step_ns <= 0 || step_ns > kLongestStepNs) reset();
  }
  const cv::Mat small = shrink(luminance);
  std::vector<cv::Mat> pyramid;
  cv::buildOpticalFlowPyramid(small, pyramid, {options_.window_px, options_.window_px}, options_.levels, true,
                              cv::BORDER_REFLECT_101, cv::BORDER_CONSTANT, false);
  samples_.clear();
  ResidualField carried;
  if (exposure_ && !corners_.empty() && pyramid_.front().size() == pyramid.front().size()) {
    follow_corners(pyramid, camera, motion, exposure);
    const TimeNs step_ns = exposure.start(0) - exposure_->start(0), mean_ns = exposure.start(0) - step_ns / 2;
    ResidualField means = mean_velocities(grid);
    carried = means;
    for (int i = 0; i < grid.size() && means_.size() == means.size(); ++i) {
      if (!means[i]) continue;
      const auto before_px_s = velocity_before(i, *means[i], grid, camera, motion, exposure);
      if (!before_px_s) continue;
      const Eigen::Vector2d change_px_s =
          (means[i]->velocity_px_s - *before_px_s) * (to_seconds(step_ns / 2) / to_seconds(mean_ns - mean_ns_));
      carried[i]->velocity_px_s += change_px_s;
      carried[i]->stddev_px_s = std::hypot(means[i]->stddev_px_s, kDoubtOfChange * change_px_s.norm());
    }
    means_ = std::move(means);
    mean_ns_ = mean_ns;
  } else {
    means_.clear();
  }
  corners_.clear();
  cv::goodFeaturesToTrack(small, corners_, options_.max_corners, kCornerQuality, options_.min_distance_px);
  pyramid_ = std::move(pyramid);
  exposure_ = exposure;
  return carried;
}

std::optional<Eigen::Vector2d> ResidualFlow::velocity_before(int block, const ResidualVelocity& mean,
                                                             const BlockGrid& grid, const Camera& camera,
                                                             const CameraMotion& motion,
                                                             const RowExposure& exposure) const {
  const Eigen::Vector2d center_px = grid.center(block);
  const TimeNs now_ns = exposure.middle(center_px.y());
  const Eigen::Vector2d moved_px = to_seconds(exposure.start(0) - exposure_->start(0)) * mean.velocity_px_s;
  const auto there_px = predicted_pixel(center_px - moved_px, camera, motion, exposure, *exposure_);
  if (!there_px) return std::nullopt;
  Eigen::Vector2d velocity_px_s = Eigen::Vector2d::Zero();
  for (const BlockGrid::Neighbour& neighbour : grid.around(*there_px)) {
    if (neighbour.share == 0) continue;
    if (!means_[neighbour.index]) return std::nullopt;
    velocity_px_s += neighbour.share * means_[neighbour.index]->velocity_px_s;
  }
  // As an arrow in the image it turns, and grows towards the border, with the camera's rotation.
  constexpr double kArrowS = 0.01;
  const RowExposure& then = *exposure_;
  const TimeNs then_ns = then.middle(there_px->y());
  const auto foot = turned_ray(*there_px, camera, motion, then_ns, now_ns);
  const auto head = turned_ray(*there_px + kArrowS * velocity_px_s, camera, motion, then_ns, now_ns);
  if (!foot || !head) return std::nullopt;
  const Eigen::Vector2d turned_px_s = (camera.project(*head) - camera.project(*foot)) / kArrowS;
  if (!turned_px_s.allFinite()) return std::nullopt;
  return turned_px_s;
}

void ResidualFlow::follow_corners(const std::vector<cv::Mat>& pyramid, const Camera& camera, const CameraMotion& motion,
                                  const RowExposure& exposure) {
  const cv::Size window(options_.window_px, options_.window_px), size = pyramid.front().size();
  const auto scale = static_cast<float>(scale_);
  std::vector<cv::Point2f> before, start;
  for (const cv::Point2f& corner : corners_) {
    const auto at = predicted_pixel({scale * corner.x, scale * corner.y}, camera, motion, *exposure_, exposure);
    if (!at) continue;
    const cv::Point2f start_px(static_cast<float>(at->x()) / scale, static_cast<float>(at->y()) / scale);
    if (!inside(start_px, size, 0)) continue;
    before.push_back(corner);
    start.push_back(start_px);
  }
  if (before.empty()) return;
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, options_.iterations, 0.03);
  std::vector<cv::Point2f> after = start, back;
  std::vector<uchar> found, found_back;
  std::vector<float> unused;
  cv::calcOpticalFlowPyrLK(pyramid_, pyramid, before, after, found, unused, window, options_.levels, criteria,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  for (std::size_t i = 0; i < after.size(); ++i) back.push_back(after[i] - (start[i] - before[i]));
  cv::calcOpticalFlowPyrLK(pyramid, pyramid_, after, back, found_back, unused, window, options_.levels, criteria,
                           cv::OPTFLOW_USE_INITIAL_FLOW);
  for (std::size_t i = 0; i < after.size(); ++i) {
    if (!found[i] || !found_back[i] || !inside(after[i], size, 0)) continue;
    if (cv::norm(back[i] - before[i]) > options_.max_round_trip_px) continue;
    Eigen::Vector2d from_px(scale * before[i].x, scale * before[i].y);
    Eigen::Vector2d pixel_px(scale * after[i].x, scale * after[i].y);
    const auto from_offset_px = mean_offset(from_px, camera, motion, *exposure_);
    const auto offset_px = mean_offset(pixel_px, camera, motion, exposure);
    if (!from_offset_px || !offset_px) continue;
    from_px -= *from_offset_px;
    pixel_px -= *offset_px;
    // Where the rotation takes it by the time that the row in which it was found is exposed.
    const auto at = predicted_pixel(from_px, camera, motion, *exposure_, exposure.middle(pixel_px.y()));
    if (!at) continue;
    const TimeNs since_ns = exposure.middle(pixel_px.y()) - exposure_->middle(from_px.y());
    samples_.push_back({pixel_px, (pixel_px - *at) / to_seconds(since_ns), since_ns});
  }
}

ResidualField ResidualFlow::mean_velocities(const BlockGrid& grid) const {
  ResidualField velocities(grid.size());
  const std::size_t count = options_.neighbours;
  if (samples_.size() < count) return velocities;
  std::vector<std::pair<double, const Sample*>> nearest(samples_.size());
  for (int i = 0; i < grid.size(); ++i) {
    const Eigen::Vector2d center_px = grid.center(i);
    for (std::size_t k = 0; k < samples_.size(); ++k) {
      nearest[k] = {(samples_[k].pixel_px - center_px).squaredNorm(), &samples_[k]};
    }
    std::nth_element(nearest.begin(), nearest.begin() + count - 1, nearest.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    const double reach_px2 = nearest[count - 1].first;
    ResidualVelocity& velocity = velocities[i].emplace();
    double variance = 0;
    for (int axis = 0; axis < 2; ++axis) {
      std::vector<double> of_axis, deviations(count);
      for (std::size_t k = 0; k < count; ++k) of_axis.push_back(nearest[k].second->velocity_px_s[axis]);
      Eigen::Vector3d plane(median(of_axis), 0, 0);
      double spread = 0;
      Eigen::Matrix3d information = Eigen::Matrix3d::Identity();
      for (int iteration = 0; iteration < options_.iterations_of_plane + 1; ++iteration) {
        const auto residual = [&](std::size_t k) {
          const Eigen::Vector2d d = nearest[k].second->pixel_px - center_px;
          return of_axis[k] - plane.dot(Eigen::Vector3d(1, d.x(), d.y()));
        };
        for (std::size_t k = 0; k < count; ++k) deviations[k] = std::abs(residual(k));
        spread = std::max(1.4826 * median(deviations), 1e-3);
        if (iteration == options_.iterations_of_plane) break;
        Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
        Eigen::Vector3d right = Eigen::Vector3d::Zero();
        // A slope is believed where the corners tell it.
        normal(1, 1) = normal(2, 2) = options_.slope_prior * reach_px2;
        for (std::size_t k = 0; k < count; ++k) {
          const Eigen::Vector2d d = nearest[k].second->pixel_px - center_px;
          const Eigen::Vector3d row(1, d.x(), d.y());
          const double r = residual(k) / (2.0 * spread);
          const double near = 1 / (1 + nearest[k].first / (0.5 * reach_px2));
          const double weight = near / (1 + r * r) / (1 + r * r);
          normal += weight * row * row.transpose();
          right += weight * of_axis[k] * row;
        }
        plane = normal.ldlt().solve(right);
        information = normal;
      }
      velocity.velocity_px_s[axis] = plane[0];
      variance = std::max(variance, spread * spread * information.inverse()(0, 0));
    }
    const double floor_px_s = scale_ * kFloorPx / to_seconds(nearest.front().second->since_ns);
    velocity.stddev_px_s = std::sqrt(floor_px_s * floor_px_s + variance);
  }
  return velocities;
}

}  // namespace gyro_deblur
