// Estimates the residual velocity of every block from followed corners.
#include "features/residual_flow.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

#include "base/median.hpp"
#include "base/one_thread.hpp"
#include "base/parallel.hpp"
#include "features/corner_prediction.hpp"
#include "features/corner_strength.hpp"
#include "features/scene_change.hpp"
#include "features/velocity_plane.hpp"

namespace gyro_deblur {
namespace {

// Lengths are pixels of a SearchImage. The values left the smallest error on recorded flights
// (experiments/optical_flow).
constexpr int kCellPx = 16, kCornersOfCell = 4;  // at most so many in a cell
constexpr double kMinDistancePx = 6;
constexpr std::size_t kCornersOfPlane = 20;  // that a block's velocity is a plane through
constexpr int kIterationsOfPlane = 3;
/// A velocity that differs from the scene's is that of an object: this difference, times the distance from where it is
/// seen over kObjectReachPx, is a part of its standard deviation.
constexpr double kObjectReachPx = 48;
constexpr double kSlopePrior = 0.02;  // how many corners at the farthest neighbour's distance speak for no slope

constexpr double kCornerQuality = 0.01;
/// Over a longer time a mean velocity is no measure of the velocity within an exposure.
constexpr TimeNs kLongestStepNs = 250'000'000;
/// Error of Lucas-Kanade on blurred frames where all neighbours agree, in the smaller image [px].
constexpr double kFloorPx = 0.05;
/// Relative uncertainty of an extrapolated change of velocity. It is larger than on recorded flights, so that a
/// velocity that is only extrapolated is not certain (see is_certain).
constexpr double kChangeUncertainty = 0.3;
/// Part of the corners. Where fewer are found again the image shows another scene, or one that has jumped beyond the
/// search: one in a hundred is found by chance, eight in ten where the scene is the same.
constexpr double kLeastFollowed = 0.2;
/// A neighbour has half the weight at this share of the square of the farthest neighbour's distance.
constexpr float kNearShare = 0.3f;

constexpr std::uint64_t kIndexBits = 0xffffffff;
/// Orders by distance, as the bits of floats that are not negative do. Whose distance it is follows in kIndexBits.
std::uint64_t distance_key(float distance_px2, std::size_t index) {
  std::uint32_t bits = 0;
  std::memcpy(&bits, &distance_px2, sizeof(bits));
  return std::uint64_t{bits} << 32 | index;
}

/// Finds the corners nearest to one place after another, faster where each place is near the one before.
class NearestCorners {
 public:
  /// @param corners  at least kCornersOfPlane, with places in the image
  explicit NearestCorners(const NearbyVelocities& corners) : corners_(corners), by_distance_(corners.size()) {}

  /// The kCornersOfPlane nearest, by distance_key(), the last one the farthest.
  const std::uint64_t* nearest_to(const Eigen::Vector2f& place_px) {
    // The nearest corners of the place before are within this distance, so that there are enough.
    constexpr float kRounding = 1.001f;
    const float within_px = kRounding * (reach_px_ + (place_px - place_px_).norm());
    std::size_t count = 0;
    for (std::size_t k = 0; k < corners_.size(); ++k) {
      const float off_x = corners_.x_px[k] - place_px.x(), off_y = corners_.y_px[k] - place_px.y();
      const float distance_px2 = off_x * off_x + off_y * off_y;
      by_distance_[count] = distance_key(distance_px2, k);
      count += distance_px2 <= within_px * within_px ? 1 : 0;
    }
    const auto last = by_distance_.begin() + kCornersOfPlane - 1;
    std::nth_element(by_distance_.begin(), last, by_distance_.begin() + static_cast<std::ptrdiff_t>(count));
    const std::size_t farthest = *last & kIndexBits;
    reach_px_ = (Eigen::Vector2f(corners_.x_px[farthest], corners_.y_px[farthest]) - place_px).norm();
    place_px_ = place_px;
    return by_distance_.data();
  }

 private:
  const NearbyVelocities& corners_;
  std::vector<std::uint64_t> by_distance_;
  Eigen::Vector2f place_px_ = Eigen::Vector2f::Zero();
  float reach_px_ = std::numeric_limits<float>::infinity();
};

/// Whether a window around `p` lies in the image: one that is cut by its border drags the corner along.
bool has_window(const cv::Point2f& p, const cv::Size& size) {
  constexpr float kHalfPx = kSearchWindowPx / 2;
  return p.x >= kHalfPx && p.y >= kHalfPx && p.x <= static_cast<float>(size.width - 1) - kHalfPx &&
         p.y <= static_cast<float>(size.height - 1) - kHalfPx;
}

/// Middle of the middle row's exposure, the instant of an image.
TimeNs middle_of(const RowExposure& exposure, const Camera& camera) {
  return exposure.middle(0.5 * (camera.calibration().height_px - 1));
}

/// The best of each cell: all over the image, for what has most texture may be an object that moves by itself.
/// @param usable  CV_8UC1 of the image's size: 0 where no corner is wanted; or empty
std::vector<cv::Point2f> corners_everywhere(const cv::Mat& image, const cv::Mat& usable) {
  const auto cells_along = [](int length_px) { return std::max(1, (length_px + kCellPx / 2) / kCellPx); };
  const int columns = cells_along(image.cols), rows = cells_along(image.rows);
  CornerStrengths strengths;
  strengths.rate(
      image.cols, image.rows, [&](int, int, const auto& rate_run) { rate_run(0, image.cols); },
      [&](int y, int first, int end, float* to) { std::copy(image.ptr(y) + first, image.ptr(y) + end, to); });
  constexpr int kHalfPx = kSearchWindowPx / 2;
  const cv::Rect with_window(kHalfPx, kHalfPx, image.cols - 2 * kHalfPx, image.rows - 2 * kHalfPx);
  std::vector<cv::Point2f> corners;
  std::vector<std::pair<float, cv::Point2f>> candidates;
  std::vector<int> peaks(static_cast<std::size_t>(image.cols));
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      candidates.clear();
      float best = 0;
      const cv::Point begin(column * image.cols / columns, row * image.rows / rows);
      const cv::Point end((column + 1) * image.cols / columns, (row + 1) * image.rows / rows);
      const cv::Rect cell = cv::Rect(begin, end) & with_window;
      for (int y = cell.y; y < cell.y + cell.height; ++y) {
        const int count = strengths.find_peaks(y, cell.x, cell.x + cell.width, peaks.data());
        for (int i = 0; i < count; ++i) {
          const int x = peaks[static_cast<std::size_t>(i)];
          if (!usable.empty() && usable.at<uchar>(y, x) == 0) continue;
          const float value = strengths.row(y)[x];
          if (!(value > 0)) continue;  // where there is one gradient alone, of rounding
          best = std::max(best, value);
          candidates.emplace_back(value, cv::Point2f(static_cast<float>(x), static_cast<float>(y)));
        }
      }
      std::stable_sort(candidates.begin(), candidates.end(),
                       [](const auto& a, const auto& b) { return a.first > b.first; });
      const std::size_t of_others = corners.size();
      for (const auto& [value, place] : candidates) {
        if (value < kCornerQuality * best || corners.size() == of_others + kCornersOfCell) break;
        const auto is_near = [&, at = place](const cv::Point2f& corner) {
          return (corner - at).dot(corner - at) < kMinDistancePx * kMinDistancePx;
        };
        if (std::none_of(corners.begin() + static_cast<std::ptrdiff_t>(of_others), corners.end(), is_near)) {
          corners.push_back(place);
        }
      }
    }
  }
  return corners;
}

}  // namespace

std::optional<TimeRange> ResidualFlow::newest_frame() const {
  if (!exposure_) return std::nullopt;
  return exposure_->frame();
}

std::optional<ResidualField> ResidualFlow::found_for(const RowExposure& exposure, const BlockGrid& grid) const {
  if (!exposure_ || exposure_->start(0) != exposure.start(0)) return std::nullopt;
  return newest_.size() == static_cast<std::size_t>(grid.size()) ? newest_ : ResidualField();
}

void ResidualFlow::set_mask(const PixelMask& mask) {
  if (mask.is_same(mask_)) return;
  mask_ = mask;
  usable_.release();
}

void ResidualFlow::correct_exposure(const Camera& camera, const RowExposure& exposure) {
  if (!exposure_) return;
  // The mean of the velocities is halfway from the image before, which stays where it is.
  mean_ns_ += (middle_of(exposure, camera) - middle_of(*exposure_, camera)) / 2;
  exposure_ = exposure;
}

void ResidualFlow::reset() {
  ResidualFlow fresh;
  fresh.mask_ = mask_;
  fresh.whole_ = whole_;
  *this = std::move(fresh);
}

void ResidualFlow::change_motion(const Camera& camera, const BlockGrid& grid, const CameraMotion* known) {
  whole_ = known != nullptr;
  ResidualField before = std::exchange(means_, {});
  newest_.clear();
  accelerations_.clear();
  inertial_.clear();
  if (!known || !exposure_ || !known->covers(exposure_->frame())) return;
  if (before.size() != static_cast<std::size_t>(grid.size())) before.assign(static_cast<std::size_t>(grid.size()), {});
  for (int i = 0; i < grid.size(); ++i) {
    const Eigen::Vector2d center_px = grid.center(i);
    const double y = center_px.y();
    const auto from = predicted_pixel(center_px, camera, *known, *exposure_, exposure_->start(y));
    const auto to = predicted_pixel(center_px, camera, *known, *exposure_, exposure_->end(y));
    if (!from || !to) return;
    if (!before[i]) before[i].emplace();
    before[i]->velocity_px_s += (*to - *from) / to_seconds(exposure_->end(y) - exposure_->start(y));
  }
  means_ = std::move(before);
  mean_ns_ = middle_of(*exposure_, camera);
}

ResidualField ResidualFlow::follow(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                   const RowExposure& exposure, const BlockGrid& grid, int threads) {
  if (exposure_) {
    const TimeNs step_ns = exposure.start(0) - exposure_->start(0);
    if (step_ns <= 0 || step_ns > kLongestStepNs) reset();
  }
  // OpenCV's loops in it are serial, also those on the threads of parallel_for().
  bool follows = false;
  on_one_thread([&] { follows = follow_and_find_corners(luminance, camera, motion, exposure, grid, threads); });
  ResidualField carried;
  if (follows) {
    const TimeNs now_ns = middle_of(exposure, camera), mean_ns = now_ns - (now_ns - middle_of(*exposure_, camera)) / 2;
    ResidualField means = mean_velocities(grid, threads);
    std::vector<std::optional<Eigen::Vector2d>> before_px_s(means.size());
    parallel_for(means_.size() == means.size() ? grid.size() : 0, threads, grid.cols(), [&](int i) {
      if (means[i]) before_px_s[i] = velocity_before(i, *means[i], grid, camera, motion, exposure);
    });
    carried = extrapolated(means, before_px_s, camera, motion, exposure, grid, to_seconds(mean_ns - mean_ns_));
    means_ = std::move(means);
    mean_ns_ = mean_ns;
  } else {
    means_.clear();
    accelerations_.clear();
    inertial_.clear();
  }
  exposure_ = exposure;
  newest_ = carried;
  return carried;
}

bool ResidualFlow::follow_and_find_corners(const cv::Mat& luminance, const Camera& camera, const CameraMotion& motion,
                                           const RowExposure& exposure, const BlockGrid& grid, int threads) {
  SearchImage image = search_image(luminance, threads);
  const cv::Mat& small = image.pyramid.front();
  if (!mask_.empty() && usable_.size() != small.size()) {
    // Each halving smooths over two pixels to either side.
    constexpr int kSmoothedPx = 2;
    usable_ = shrink_mask(mask_.pixels(), small.size(), kSearchWindowPx + 2 * kSmoothedPx);
  }
  const bool follows = exposure_ && !corners_.empty() && image_.pyramid.front().size() == small.size();
  if (!follows) corners_.clear();
  constexpr std::ptrdiff_t kCornersAtATime = 32;
  const auto count = static_cast<std::ptrdiff_t>(corners_.size());
  std::vector<FollowedPart> parts(static_cast<std::size_t>((count + kCornersAtATime - 1) / kCornersAtATime));
  std::vector<cv::Point2f> corners;
  // The longest piece of work comes first.
  parallel_for(1 + static_cast<int>(parts.size()), threads, 1, [&](int i) {
    if (i == 0) {
      corners = corners_everywhere(small, usable_);
      return;
    }
    const std::ptrdiff_t begin = (i - 1) * kCornersAtATime, end = std::min(begin + kCornersAtATime, count);
    parts[i - 1] =
        follow_corners({corners_.begin() + begin, corners_.begin() + end}, image, camera, motion, exposure, grid);
  });
  samples_.clear();
  std::size_t searched = 0;
  for (const FollowedPart& part : parts) {
    samples_.insert(samples_.end(), part.samples.begin(), part.samples.end());
    searched += part.searched;
  }
  if (static_cast<double>(samples_.size()) < kLeastFollowed * static_cast<double>(searched)) samples_.clear();
  corners_ = std::move(corners);
  image_ = std::move(image);
  return follows;
}

ResidualField ResidualFlow::extrapolated(const ResidualField& means,
                                         const std::vector<std::optional<Eigen::Vector2d>>& before_px_s,
                                         const Camera& camera, const CameraMotion& motion, const RowExposure& exposure,
                                         const BlockGrid& grid, double since_before_s) {
  const TimeNs before_ns = middle_of(*exposure_, camera), now_ns = middle_of(exposure, camera);
  InertialChange::Step step;
  step.step_s = to_seconds(now_ns - before_ns);
  step.gain = motion.velocity_gain(before_ns, now_ns);
  if (step.gain) step.R_now_before = motion.rotation(before_ns, now_ns);
  const cv::Size size(camera.calibration().width_px, camera.calibration().height_px);
  step.px_per_ray = projection_jacobian(camera, camera.ray({0.5 * (size.width - 1), 0.5 * (size.height - 1)}));
  // In the image the axes rotate by the camera's roll.
  const Eigen::Rotation2Dd roll(std::atan2(step.R_now_before(1, 0), step.R_now_before(0, 0)));

  std::vector<BlockChange> changes;
  std::vector<std::size_t> changed;
  Accelerations accelerations(means.size());
  std::vector<double> changed_x, changed_y;
  for (std::size_t i = 0; i < means.size(); ++i) {
    if (!before_px_s[i]) continue;
    const BlockChange& change =
        changes.emplace_back(BlockChange{grid.center(static_cast<int>(i)), means[i]->velocity_px_s,
                                         means[i]->stddev_px_s, means[i]->velocity_px_s - *before_px_s[i]});
    changed.push_back(i);
    accelerations[i] = change.change_px_s / since_before_s;
    if (accelerations_.size() != means.size() || !accelerations_[i]) continue;
    const Eigen::Vector2d changed_px_s2 = *accelerations[i] - roll * *accelerations_[i];
    changed_x.push_back(changed_px_s2.x());
    changed_y.push_back(changed_px_s2.y());
  }
  accelerations_ = std::move(accelerations);
  if (changed_x.size() >= kLeastBlocksOfScene) {
    step.acceleration_changed_px_s2 = {median(changed_x), median(changed_y)};
  }
  const Eigen::Vector2d beyond_px_s = inertial_.beyond_even(step);

  ResidualField carried = means;
  const std::vector<Eigen::Vector2d> common_px_s = common_changes(changes);
  for (std::size_t k = 0; k < changed.size(); ++k) {
    ResidualVelocity& velocity = *carried[changed[k]];
    const Eigen::Vector2d even_px_s = step.step_s / 2 / since_before_s * common_px_s[k];
    velocity.velocity_px_s += even_px_s + beyond_px_s;
    velocity.stddev_px_s = std::hypot(velocity.stddev_px_s, kChangeUncertainty * even_px_s.norm(),
                                      kChangeUncertainty * beyond_px_s.norm());
  }
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
  // As an arrow in the image it rotates, and grows towards the border, with the camera's rotation.
  constexpr double kArrowS = 0.01;
  const TimeNs then_ns = exposure_->middle(there_px->y());
  const auto foot = rotated_ray(camera.ray(*there_px), motion, then_ns, now_ns);
  const auto head = rotated_ray(camera.ray(*there_px + kArrowS * velocity_px_s), motion, then_ns, now_ns);
  if (!foot || !head) return std::nullopt;
  const Eigen::Vector2d rotated_px_s = (camera.project(*head) - camera.project(*foot)) / kArrowS;
  if (!rotated_px_s.allFinite()) return std::nullopt;
  return rotated_px_s;
}

ResidualFlow::FollowedPart ResidualFlow::follow_corners(const std::vector<cv::Point2f>& part, const SearchImage& image,
                                                        const Camera& camera, const CameraMotion& motion,
                                                        const RowExposure& exposure, const BlockGrid& grid) const {
  const cv::Size size = image.pyramid.front().size();
  const auto scale = static_cast<float>(image.scale);
  std::vector<cv::Point2f> before, start;
  for (const cv::Point2f& corner : part) {
    auto at = predicted_pixel({scale * corner.x, scale * corner.y}, camera, motion, *exposure_, exposure);
    if (!at) continue;
    if (whole_ && means_.size() == static_cast<std::size_t>(grid.size())) {
      const auto& mean = means_[grid.index_at(at->x(), at->y())];
      if (mean) *at += to_seconds(exposure.start(0) - exposure_->start(0)) * mean->velocity_px_s;
    }
    const cv::Point2f start_px(static_cast<float>(at->x()) / scale, static_cast<float>(at->y()) / scale);
    if (!has_window(corner, size) || !has_window(start_px, size)) continue;
    before.push_back(corner);
    start.push_back(start_px);
  }
  const FollowedCorners corners = follow_there_and_back(image_.pyramid, image.pyramid, before, start, corner_search());
  const std::vector<cv::Point2f>& after = corners.places;
  FollowedPart followed{before.size(), {}};
  for (std::size_t i = 0; i < after.size(); ++i) {
    if (!corners.found[i] || !has_window(after[i], size)) continue;
    if (!usable_.empty() && usable_.at<uchar>(cvRound(after[i].y), cvRound(after[i].x)) == 0) continue;
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
    // A rolling shutter may have seen both within an instant.
    if (2 * since_ns < exposure.start(0) - exposure_->start(0)) continue;
    followed.samples.push_back({pixel_px, (pixel_px - *at) / to_seconds(since_ns), since_ns});
  }
  return followed;
}

ResidualField ResidualFlow::mean_velocities(const BlockGrid& grid, int threads) const {
  ResidualField velocities(static_cast<std::size_t>(grid.size()));
  if (samples_.size() < kCornersOfPlane) return velocities;
  const double floor_px_s = image_.scale * kFloorPx / to_seconds(samples_.front().since_ns);
  NearbyVelocities everywhere;
  everywhere.resize(samples_.size());
  for (std::size_t k = 0; k < samples_.size(); ++k) everywhere.set(k, samples_[k].pixel_px, samples_[k].velocity_px_s);
  const VelocityPlane scene = fit_plane(everywhere, kIterationsOfPlane, kSlopePrior);
  parallel_for(grid.rows(), threads, 1, [&](int row) {
    NearestCorners corners(everywhere);
    NearbyVelocities nearest;
    nearest.resize(kCornersOfPlane);
    for (int i = row * grid.cols(); i < (row + 1) * grid.cols(); ++i) {
      const Eigen::Vector2d center_px = grid.center(i);
      const std::uint64_t* by_distance = corners.nearest_to(center_px.cast<float>());
      for (std::size_t k = 0; k < kCornersOfPlane; ++k) {
        const Sample& sample = samples_[by_distance[k] & kIndexBits];
        nearest.set(k, sample.pixel_px - center_px, sample.velocity_px_s);
      }
      const float reach_px2 = std::max(nearest.distance_px2.back(), 1.0f);
      for (std::size_t k = 0; k < kCornersOfPlane; ++k) {
        nearest.nearness[k] = 1 / (1 + nearest.distance_px2[k] / (kNearShare * reach_px2));
      }
      const VelocityPlane plane = fit_plane(nearest, kIterationsOfPlane, kSlopePrior);
      const Eigen::Vector2d velocity_px_s = plane.at(Eigen::Vector2d::Zero());
      const double from_scene_px_s = (velocity_px_s - scene.at(center_px)).norm();
      const double uncertainty_px_s = from_scene_px_s * seen_from_px(plane, nearest) / (image_.scale * kObjectReachPx);
      velocities[static_cast<std::size_t>(i)] = {velocity_px_s,
                                                 std::hypot(plane.stddev_px_s, floor_px_s, uncertainty_px_s)};
    }
  });
  return velocities;
}

}  // namespace gyro_deblur
