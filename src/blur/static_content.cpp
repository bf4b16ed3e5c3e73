// Finds content that does not move with the camera.
#include "blur/static_content.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <opencv2/imgproc.hpp>

namespace gyro_deblur {
namespace {

constexpr int kCellPx = 8;
/// Smaller steps [px] between two images are not used: a gyroscope's bias may cause them in a camera at rest.
constexpr double kLeastStepPx = 4;
/// The scene has to be seen at so many places, two cells apart, in so many images: less than 5 s at 10 Hz.
constexpr std::size_t kPlaces = 8;
constexpr double kPlacePx = 2 * kCellPx;
constexpr int kImages = 30;
/// Limit for a camera that shakes between few places.
constexpr int kMostImages = 300;
/// A cell is still if its grey level changes by at most this: noise, plus a share of the level for changes of light.
constexpr double kStillLevels = 6, kStillShare = 0.04;
/// Least change of grey levels at an edge, and of a changed cell. Filters make rings of a tenth of an edge.
constexpr int kEdgeLevels = 24;
constexpr double kEdgeShare = 0.6;  ///< of the images
/// Distance of compared cells: the cell between them is on their edge.
constexpr int kApart = 2;
/// Least share of changed cells for an image that moves with the gyroscope.
constexpr double kLeastChanged = 0.2;
/// Least number of changed cells for each at a static edge: 13 with a rim around the image, 0.9 where people walk
/// before a camera at rest.
constexpr int kChangedPerEdge = 3;
constexpr int kLeastEdges = 6;

/// Means of every second row of each cell; rows and columns beyond whole cells do not count.
void cell_means(const cv::Mat& luminance, cv::Mat& cells) {
  cells.create(luminance.rows / kCellPx, luminance.cols / kCellPx, CV_8UC1);
  const int width = cells.cols * kCellPx;
  std::vector<std::uint16_t> sums(static_cast<std::size_t>(width));
  constexpr int kSamples = kCellPx * kCellPx / 2;
  for (int row = 0; row < cells.rows; ++row) {
    const std::uint8_t *a = luminance.ptr(row * kCellPx), *b = luminance.ptr(row * kCellPx + 2),
                       *c = luminance.ptr(row * kCellPx + 4), *d = luminance.ptr(row * kCellPx + 6);
#pragma omp simd
    for (int x = 0; x < width; ++x) sums[x] = static_cast<std::uint16_t>(a[x] + b[x] + c[x] + d[x]);
    std::uint8_t* to = cells.ptr(row);
    for (int col = 0; col < cells.cols; ++col) {
      int sum = kSamples / 2;
      for (int x = 0; x < kCellPx; ++x) sum += sums[col * kCellPx + x];
      to[col] = static_cast<std::uint8_t>(sum / kSamples);
    }
  }
}

/// The first cells of pairs along an axis, or the second ones.
cv::Mat of_pairs(const cv::Mat& cells, bool is_x, bool second) {
  const int skipped = second ? kApart : 0;
  return is_x ? cells.colRange(skipped, cells.cols - kApart + skipped)
              : cells.rowRange(skipped, cells.rows - kApart + skipped);
}

/// Cells that have a masked pixel.
cv::Mat masked_cells(const PixelMask& mask, const cv::Size& cells) {
  cv::Mat masked(cells, CV_8UC1, cv::Scalar(0));
  if (mask.empty()) return masked;
  for (int row = 0; row < cells.height; ++row) {
    for (int col = 0; col < cells.width; ++col) {
      const cv::Rect cell(col * kCellPx, row * kCellPx, kCellPx, kCellPx);
      masked.at<std::uint8_t>(row, col) = mask.masked_in(cell) > 0 ? 255 : 0;
    }
  }
  return masked;
}

/// Drops pairs without an adjacent one, which are chance.
void drop_lonely(cv::Mat& pairs) {
  cv::Mat ones, around;
  pairs.convertTo(ones, CV_8U, 1.0 / 255);
  cv::boxFilter(ones, around, CV_8U, {2 * kApart + 1, 2 * kApart + 1}, {-1, -1}, false, cv::BORDER_CONSTANT);
  pairs &= around > 1;
}

/// Cells that are connected through cells that stand still with one that does and is at an edge.
cv::Mat connected(const cv::Mat& still, const cv::Mat& seeds) {
  cv::Mat labels;
  const int count = cv::connectedComponents(still, labels, 4, CV_32S);
  std::vector<std::uint8_t> wanted(static_cast<std::size_t>(count), 0);
  for (int y = 0; y < still.rows; ++y) {
    for (int x = 0; x < still.cols; ++x) {
      if (seeds.at<std::uint8_t>(y, x) != 0) wanted[static_cast<std::size_t>(labels.at<int>(y, x))] = 255;
    }
  }
  wanted[0] = 0;  // what does not stand still
  cv::Mat cells(still.size(), CV_8UC1);
  std::transform(labels.begin<int>(), labels.end<int>(), cells.begin<std::uint8_t>(),
                 [&](int label) { return wanted[static_cast<std::size_t>(label)]; });
  return cells;
}

}  // namespace

bool StaticContent::move(const Eigen::Vector2d& moved_px) {
  if (!moved_px.allFinite()) return false;
  step_px_ = moved_px;
  place_px_ += moved_px;
  return moved_px.cwiseAbs().maxCoeff() >= kLeastStepPx;
}

void StaticContent::reset() { *this = StaticContent(); }

void StaticContent::add(const cv::Mat& luminance, const PixelMask& mask) {
  if (luminance.size() != size_) {
    const Eigen::Vector2d step_px = step_px_;
    reset();
    move(step_px);
    size_ = luminance.size();
  }
  constexpr int kLeastCells = kApart + 1;
  if (size_.width < kLeastCells * kCellPx || size_.height < kLeastCells * kCellPx) return;
  cell_means(luminance, cells_);
  const bool repeated = cells_before_.size() == cells_.size() && cv::norm(cells_, cells_before_, cv::NORM_INF) == 0;
  cells_.copyTo(cells_before_);
  if (repeated) return;
  bool decided = false;
  for (int i = 0; i < 2; ++i) {
    Axis& axis = axes_[static_cast<std::size_t>(i)];
    if (std::abs(step_px_[i]) < kLeastStepPx) continue;
    add_to(axis, i == 0, place_px_[i]);
    if (axis.images < kImages) continue;
    if (axis.places.size() >= kPlaces) {
      decide(axis, i == 0, mask);
      decided = true;
    }
    if (axis.places.size() >= kPlaces || axis.images >= kMostImages) {
      axis.images = 0;
      axis.places.clear();
    }
  }
  if (decided) combine();
}

void StaticContent::add_to(Axis& axis, bool is_x, double place_px) {
  if (axis.images++ == 0) {
    cells_.copyTo(axis.least);
    cells_.copyTo(axis.most);
    axis.contrasts = cv::Mat::zeros(of_pairs(cells_, is_x, false).size(), CV_16UC1);
  } else {
    cv::min(axis.least, cells_, axis.least);
    cv::max(axis.most, cells_, axis.most);
  }
  axis.places.insert(static_cast<int>(std::floor(place_px / kPlacePx)));
  cv::Mat difference;
  cv::absdiff(of_pairs(cells_, is_x, false), of_pairs(cells_, is_x, true), difference);
  cv::add(axis.contrasts, 1, axis.contrasts, difference >= kEdgeLevels);
}

void StaticContent::decide(Axis& axis, bool is_x, const PixelMask& mask) {
  const cv::Mat masked = masked_cells(mask, cells_.size());
  cv::Mat range = axis.most - axis.least, allowed;
  axis.most.convertTo(allowed, CV_8U, kStillShare, kStillLevels);
  cv::Mat still = range <= allowed;
  still.setTo(0, masked);
  range.setTo(0, masked);
  cv::Mat pairs = axis.contrasts >= kEdgeShare * axis.images;
  pairs &= of_pairs(still, is_x, false) | of_pairs(still, is_x, true);
  pairs.setTo(0, of_pairs(masked, is_x, false) | of_pairs(masked, is_x, true));
  drop_lonely(pairs);
  const int edges = cv::countNonZero(pairs), changed = cv::countNonZero(range >= kEdgeLevels);
  const int used = static_cast<int>(masked.total()) - cv::countNonZero(masked);
  // Where most edges stand still, the gyroscope does not rotate with the camera.
  if (changed < kLeastChanged * used || changed < kChangedPerEdge * edges) return;
  axis.found = cv::Mat::zeros(cells_.size(), CV_8UC1);
  axis.static_cells = cv::Mat::zeros(cells_.size(), CV_8UC1);
  if (edges < kLeastEdges) return;
  cv::Mat seeds = cv::Mat::zeros(cells_.size(), CV_8UC1);
  for (const bool second : {false, true}) {
    cv::Mat of_seeds = of_pairs(seeds, is_x, second);
    of_seeds |= pairs;
  }
  seeds &= still;
  axis.static_cells = connected(still, seeds);
  // From the one cell of each pair to the other.
  for (int k = 0; k <= kApart; ++k) {
    const cv::Rect shifted(is_x ? k : 0, is_x ? 0 : k, pairs.cols, pairs.rows);
    cv::Mat of_found = axis.found(shifted);
    of_found |= pairs;
  }
}

void StaticContent::combine() {
  cv::Mat found = cv::Mat::zeros(cells_.size(), CV_8UC1), static_cells = found.clone();
  for (const Axis& axis : axes_) {
    if (axis.found.size() != found.size()) continue;
    found |= axis.found;
    static_cells |= axis.static_cells;
  }
  share_ = static_cast<double>(cv::countNonZero(static_cells)) / static_cast<double>(static_cells.total());
  edges_ = PixelMask();
  if (cv::countNonZero(found) == 0) return;
  cv::Mat used(size_, CV_8UC1, cv::Scalar(255));
  cv::Mat of_cells = used(cv::Rect(0, 0, found.cols * kCellPx, found.rows * kCellPx));
  cv::resize(found == 0, of_cells, of_cells.size(), 0, 0, cv::INTER_NEAREST);
  edges_ = PixelMask(used);
}

}  // namespace gyro_deblur
