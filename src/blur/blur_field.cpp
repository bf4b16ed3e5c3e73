// Predicts the blur of every block from the camera's motion and sets its status.
#include "gyro_deblur/blur_field.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include <Eigen/Geometry>

#include "blur/path_1d.hpp"
#include "blur/path_2d.hpp"

namespace gyro_deblur {
namespace {

/// axial_angle as a float, also below the float above pi.
float axial_float(double dx, double dy) {
  const auto angle_rad = static_cast<float>(axial_angle(dx, dy));
  return angle_rad < static_cast<float>(CV_PI) ? angle_rad : 0;
}

/// The status that the extent alone decides.
BlockStatus status_of(double extent_px, const BlurFieldOptions& options) {
  if (extent_px < options.min_extent_px) return BlockStatus::SHARP;
  return extent_px > options.max_extent_px ? BlockStatus::TOO_LARGE : BlockStatus::DEBLURRED;
}

/// Extent of a path along and across a line [px], and the path along it.
struct LineFit {
  double along_px, across_px;
  Path1d path_px;
};

LineFit fit_to_line(const std::array<Eigen::Vector2d, kPathInstants>& path_px, double angle_rad) {
  const Eigen::Vector2d line(std::cos(angle_rad), std::sin(angle_rad)), normal(-line.y(), line.x());
  Eigen::AlignedBox2d covered_px;
  LineFit fit;
  for (int k = 0; k < kPathInstants; ++k) {
    const double along_px = line.dot(path_px[k]);
    fit.path_px[k] = static_cast<float>(along_px);
    covered_px.extend(Eigen::Vector2d(along_px, normal.dot(path_px[k])));
  }
  fit.along_px = covered_px.diagonal().x();
  fit.across_px = covered_px.diagonal().y();
  return fit;
}

/// Largest deviation [px] of a path along a line from uniform motion between its ends, after the best shift.
double nonuniformity_px(const Path1d& path_px) {
  double least = 0, most = 0;  // the ends do not deviate
  for (int k = 0; k < kPathInstants; ++k) {
    const double even = path_px.front() + k / (kPathInstants - 1.0) * (path_px.back() - path_px.front());
    least = std::min(least, path_px[k] - even);
    most = std::max(most, path_px[k] - even);
  }
  return 0.5 * (most - least);
}

/// Mean in time of a path of uniform speed between its instants.
Eigen::Vector2d mean_place(const std::array<Eigen::Vector2d, kPathInstants>& path_px) {
  Eigen::Vector2d sum_px = -0.5 * (path_px.front() + path_px.back());
  for (const Eigen::Vector2d& place_px : path_px) sum_px += place_px;
  return sum_px / (kPathInstants - 1);
}

/// Angle of the line that lies nearest to the places, axial.
float fitted_angle(const std::array<Eigen::Vector2d, kPathInstants>& path_px) {
  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& place_px : path_px) mean_px += place_px / kPathInstants;
  Eigen::Matrix2d scatter_px2 = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector2d& place_px : path_px) {
    scatter_px2 += (place_px - mean_px) * (place_px - mean_px).transpose();
  }
  // The angle of the eigenvector with the larger eigenvalue.
  const double angle_rad = 0.5 * std::atan2(2 * scatter_px2(0, 1), scatter_px2(0, 0) - scatter_px2(1, 1));
  return axial_float(std::cos(angle_rad), std::sin(angle_rad));
}

/// Cells of a row (or column) of `cells` cells that evenly cover `size_px` pixels.
struct CellRange {
  int first, last;         // that overlap a block or take part in the interpolation at its centre
  int before, after;       // whose centres enclose the block's centre
  double weight_of_after;  // [0, 1]
};

CellRange cells_of(int begin_px, int length_px, int size_px, int cells) {
  const double cells_per_px = static_cast<double>(cells) / size_px;
  const double last_cell = cells - 1;
  // Pixel i covers [i, i + 1) here, so that the image covers [0, size).
  const double at_center = std::clamp((begin_px + 0.5 * length_px) * cells_per_px - 0.5, 0.0, last_cell);
  CellRange range;
  range.before = static_cast<int>(at_center);
  range.weight_of_after = at_center - range.before;
  // A cell without weight takes no part, whatever it holds.
  range.after = range.weight_of_after > 0 ? range.before + 1 : range.before;
  // The margin keeps rounding from adding a cell that only shares a border with the block.
  constexpr double kMargin = 1e-9;
  range.first = std::min(range.before, static_cast<int>(begin_px * cells_per_px + kMargin));
  range.last = std::min(cells - 1, static_cast<int>(std::ceil((begin_px + length_px) * cells_per_px - kMargin)) - 1);
  if (range.weight_of_after > 0) range.last = std::max(range.last, range.after);
  return range;
}

}  // namespace

BlockBlur classify_blur(double dx_px, double dy_px, const BlurFieldOptions& options) {
  const double extent_px = std::hypot(dx_px, dy_px);
  return {axial_float(dx_px, dy_px), static_cast<float>(extent_px), status_of(extent_px, options)};
}

double even_path_px(double extent_px) {
  // Measured: along a parabola the filter of a box loses equally at all extents, down to a quarter of a pixel.
  const double share = extent_px / 40;
  return std::max(0.25, share * share);
}

BlockBlur classify_path(const std::array<Eigen::Vector2d, kPathInstants>& path_px, const BlurFieldOptions& options,
                        bool straight_only) {
  const Eigen::Vector2d chord_px = path_px.back() - path_px.front();
  BlockBlur blur = classify_blur(chord_px.x(), chord_px.y(), options);
  const float angle_rad = fitted_angle(path_px);
  LineFit fit = fit_to_line(path_px, angle_rad);
  const double nonuniform_px = nonuniformity_px(fit.path_px) - even_path_px(fit.along_px);
  if (nonuniform_px > 0) {
    blur = {angle_rad, static_cast<float>(fit.along_px), status_of(fit.along_px, options), fit.path_px};
  } else {
    fit = fit_to_line(path_px, blur.angle_rad);
  }
  blur.chord_middle_px = (0.5 * (path_px.front() + path_px.back())).cast<float>();
  blur.mean_place_px = mean_place(path_px).cast<float>();
  const double excess_px = excess_deviation_px(fit.along_px, fit.across_px);
  const double threshold_px = options.curved_path_threshold_px;
  if (blur.status != BlockStatus::DEBLURRED || std::max(excess_px, nonuniform_px) <= threshold_px) return blur;
  Path2d curved_path_px;
  for (int k = 0; k < kPathInstants; ++k) curved_path_px[k] = path_px[k].cast<float>();
  if (!straight_only && extent_of(curved_path_px).maxCoeff() <= kMax2dExtentPx) {
    blur.curved_path_px = curved_path_px;
  } else if (excess_px > std::max(threshold_px, kMaxStraightDeviationPx)) {
    blur.status = BlockStatus::TOO_CURVED;
  }
  return blur;
}

bool is_certain(const ResidualVelocity& residual, TimeNs exposure_ns) {
  // A normal error exceeds the first limit in one block of 3000. Motion below the second is invisible in an image.
  constexpr double kSigmas = 4, kLeastPx = 0.2;
  const double speed_px_s = residual.velocity_px_s.norm();
  return speed_px_s > kSigmas * residual.stddev_px_s && speed_px_s * to_seconds(exposure_ns) > kLeastPx;
}

BlurFieldEstimator::BlurFieldEstimator(const Camera& camera, const BlurFieldOptions& options)
    : camera_(camera), options_(options) {
  options.validate();
  grid_ = BlockGrid(camera.calibration().width_px, camera.calibration().height_px, options.block_size_px);
  std::vector<Eigen::Vector2d> centers;
  centers.reserve(grid_.size());
  for (int i = 0; i < grid_.size(); ++i) centers.push_back(grid_.center(i));
  rays_ = camera_.rays(centers);
}

FrameBlur BlurFieldEstimator::estimate(const CameraMotion& motion, const RowExposure& exposure,
                                       const ResidualField& residuals, bool straight_only) const {
  if (!residuals.empty() && residuals.size() != static_cast<std::size_t>(grid_.size())) {
    throw std::invalid_argument(std::to_string(residuals.size()) + " residual velocities for a grid of " +
                                std::to_string(grid_.size()) + " blocks");
  }
  const BlockBlur unknown{0, 0, BlockStatus::NO_GYRO};
  FrameBlur field;
  field.grid = grid_;
  field.exposure_ns = exposure.timing().exposure_ns;
  field.readout_ns = exposure.timing().readout_ns;
  field.blocks.assign(grid_.size(), unknown);
  for (int row = 0; row < grid_.rows(); ++row) {
    const int first = row * grid_.cols();
    const double y_px = grid_.center(first).y();
    const TimeNs start_ns = exposure.start(y_px), middle_ns = exposure.middle(y_px), end_ns = exposure.end(y_px);
    if (!motion.covers({start_ns, end_ns})) continue;
    std::array<Eigen::Matrix3d, kPathInstants> rotations;  // from the middle of the exposure
    std::array<double, kPathInstants> since_middle_s;
    for (int k = 0; k < kPathInstants; ++k) {
      const TimeNs instant_ns = start_ns + (end_ns - start_ns) * k / (kPathInstants - 1);
      rotations[k] = motion.rotation(middle_ns, instant_ns);
      since_middle_s[k] = to_seconds(instant_ns - middle_ns);
    }
    for (int i = first; i < first + grid_.cols(); ++i) {
      const Eigen::Vector2d center_px = grid_.center(i);
      std::optional<ResidualVelocity> residual;
      double uncertainty_px = 0;  // about the extent
      if (!residuals.empty() && residuals[i]) {
        const double exposure_s = to_seconds(end_ns - start_ns),
                     moved_px = exposure_s * residuals[i]->velocity_px_s.norm();
        if (is_certain(*residuals[i], end_ns - start_ns)) {
          residual = residuals[i];
          uncertainty_px = exposure_s * residual->stddev_px_s;
        } else if (moved_px >= options_.min_extent_px) {
          uncertainty_px = moved_px;  // an uncertain velocity is not used, but may be real
        }
      }
      std::array<Eigen::Vector2d, kPathInstants> path_px;
      for (int k = 0; k < kPathInstants; ++k) {
        path_px[k] = camera_.project(rotations[k] * rays_[i]) - center_px;
        if (residual) path_px[k] += since_middle_s[k] * residual->velocity_px_s;
      }
      if (!std::all_of(path_px.begin(), path_px.end(), [](const auto& place_px) { return place_px.allFinite(); })) {
        continue;
      }
      BlockBlur& block = field.blocks[i];
      block = classify_path(rolling_shutter_path(path_px, exposure), options_, straight_only);
      block.residual = residual;
      // A residual velocity that cancels the rotation may leave no blur.
      if (block.status == BlockStatus::DEBLURRED && block.extent_px - uncertainty_px < options_.min_extent_px) {
        block.status = BlockStatus::SHARP;
      }
    }
  }
  return field;
}

FrameBlur uniform_blur_field(int width_px, int height_px, double angle_rad, double extent_px,
                             const BlurFieldOptions& options) {
  options.validate();
  FrameBlur field;
  field.grid = BlockGrid(width_px, height_px, options.block_size_px);
  field.blocks.assign(field.grid.size(),
                      classify_blur(extent_px * std::cos(angle_rad), extent_px * std::sin(angle_rad), options));
  return field;
}

FrameBlur blur_field_from_displacement(int width_px, int height_px, const cv::Mat& dx_px, const cv::Mat& dy_px,
                                       const BlurFieldOptions& options) {
  options.validate();
  const auto usable = [](const cv::Mat& m) { return m.dims == 2 && (m.type() == CV_32FC1 || m.type() == CV_64FC1); };
  if (dx_px.empty() || dx_px.size() != dy_px.size() || !usable(dx_px) || !usable(dy_px)) {
    throw std::invalid_argument("displacement matrices must be of one size and of floating point, but are " +
                                std::to_string(dx_px.cols) + " x " + std::to_string(dx_px.rows) + " and " +
                                std::to_string(dy_px.cols) + " x " + std::to_string(dy_px.rows));
  }
  cv::Mat dx, dy;
  dx_px.convertTo(dx, CV_64F);
  dy_px.convertTo(dy, CV_64F);

  // Double angles make a displacement and its opposite equal.
  const auto axial_at = [&](int row, int col) {
    const double x = dx.at<double>(row, col), y = dy.at<double>(row, col);
    const double extent = std::hypot(x, y), angle = std::atan2(y, x);
    return Eigen::Vector3d(extent * std::cos(2 * angle), extent * std::sin(2 * angle), extent);
  };
  const auto all_finite = [&](const CellRange& cols, const CellRange& rows) {
    for (int row = rows.first; row <= rows.last; ++row) {
      for (int col = cols.first; col <= cols.last; ++col) {
        if (!std::isfinite(dx.at<double>(row, col)) || !std::isfinite(dy.at<double>(row, col))) return false;
      }
    }
    return true;
  };

  FrameBlur field;
  field.grid = BlockGrid(width_px, height_px, options.block_size_px);
  field.blocks.reserve(field.grid.size());
  for (int i = 0; i < field.grid.size(); ++i) {
    const cv::Rect block = field.grid.rect(i);
    const CellRange cols = cells_of(block.x, block.width, width_px, dx.cols);
    const CellRange rows = cells_of(block.y, block.height, height_px, dx.rows);
    if (!all_finite(cols, rows)) {
      field.blocks.push_back({0, 0, BlockStatus::NO_GYRO});
      continue;
    }
    const auto along_row = [&](int row) -> Eigen::Vector3d {
      return (1 - cols.weight_of_after) * axial_at(row, cols.before) + cols.weight_of_after * axial_at(row, cols.after);
    };
    const Eigen::Vector3d axial =
        (1 - rows.weight_of_after) * along_row(rows.before) + rows.weight_of_after * along_row(rows.after);
    const double angle_rad = 0.5 * std::atan2(axial.y(), axial.x());
    field.blocks.push_back(classify_blur(axial.z() * std::cos(angle_rad), axial.z() * std::sin(angle_rad), options));
  }
  return field;
}

}  // namespace gyro_deblur
