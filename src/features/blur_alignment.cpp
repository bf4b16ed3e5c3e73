// Aligns a blurred patch with another that is blurred differently, by Gauss-Newton steps.
#include "features/blur_alignment.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include <Eigen/Dense>

#include "blur/path_2d.hpp"

namespace gyro_deblur {
namespace {

/// Derivatives read so many pixels on either side.
constexpr int kTemplateMargin = 1, kPatchMargin = 2;
/// Of the pixels that interpolation reads along an axis, kBefore are before the one that the place is in.
constexpr int kTaps = kInterpolationTaps, kBefore = 2, kAfter = kTaps - 1 - kBefore;

/// The second image is blurred so far beyond the window at once; predictions are rarely farther off.
constexpr int kSearchMargin = 1;

/// Less than rounding to grey levels makes, in some direction, is no texture [grey levels^2/px^2].
constexpr double kLeastInformation = 1e-3;

/// Share of the window below which a cut one is not compared.
constexpr double kMinWindowShare = 0.4;

Path2d mapped(const Path2d& path_px, const Eigen::Matrix2d& map) {
  Path2d result_px;
  for (std::size_t k = 0; k < path_px.size(); ++k) result_px[k] = map.cast<float>() * path_px[k];
  return result_px;
}

double least_eigenvalue(const Eigen::Matrix2d& symmetric) {
  return 0.5 * (symmetric.trace() - std::hypot(symmetric(0, 0) - symmetric(1, 1), 2 * symmetric(0, 1)));
}

/// False where the prediction is useless: a gyroscope in a wrong unit takes points out of the image, and makes huge
/// paths.
bool can_be_aligned(const Eigen::Vector2d& place_px, const Path2d& path_px, const cv::Size& size) {
  const bool is_inside =
      (place_px.array() >= 0).all() && place_px.x() < size.width && place_px.y() < size.height;  // not NaN either
  const bool is_finite =
      std::all_of(path_px.begin(), path_px.end(), [](const Eigen::Vector2f& at_px) { return at_px.allFinite(); });
  return is_inside && is_finite && extent_of(path_px).maxCoeff() <= kMax2dExtentPx;
}

/// Weights of pixels, by the fraction of a pixel: Lanczos' window of three pixels about sinc, with unit sum. Cubic
/// convolution with four pixels is wrong by 0.015 px on average where images are sharp down to 0.3 cycles/px.
using InterpolationWeights = Eigen::Array<float, kInterpolationStride, 1>;
InterpolationWeights lanczos_weights(double fraction) {
  InterpolationWeights weights = InterpolationWeights::Zero();
  for (int k = 0; k < kTaps; ++k) {
    const double x = M_PI * (k - kBefore - fraction);
    weights[k] = static_cast<float>(std::abs(x) < 1e-6 ? 1 : std::sin(x) * std::sin(x / 3) * 3 / (x * x));
  }
  return weights / weights.sum();
}

/// By steps of the fraction.
const float* interpolation_table() {
  // Sines would take most of the time. Half a step is 0.0005 px, and not always to the same side.
  static const std::vector<float> table = [] {
    std::vector<float> weights;
    for (int i = 0; i <= kInterpolationSteps; ++i) {
      const InterpolationWeights of_step = lanczos_weights(static_cast<double>(i) / kInterpolationSteps);
      weights.insert(weights.end(), of_step.data(), of_step.data() + of_step.size());
    }
    return weights;
  }();
  return table.data();
}

/// For AlignmentSimd::sample(). The polynomials are a least squares fit to lanczos_weights(), to 0.0001.
const Interpolation& interpolation() {
  static const Interpolation weights{interpolation_table(),
                                     {{0.0244897f, -0.0905506f, -0.0301399f},
                                      {-0.1358632f, 0.5702471f, -0.1072439f},
                                      {0.6113735f, -0.4796966f, 0.1373839f}},
                                     {{0.0637770f, -0.3051217f, 0.2003628f},
                                      {-0.1808148f, 0.8301109f, -0.4281239f},
                                      {1.3359838f, -1.5225440f, 0.7158705f}}};
  return weights;
}

/// @param fraction  [0, 1]
Eigen::Map<const InterpolationWeights> interpolation_weights(double fraction) {
  return Eigen::Map<const InterpolationWeights>(
      interpolation_table() + kInterpolationStride * static_cast<int>(fraction * kInterpolationSteps + 0.5));
}

/// Variance of noise after interpolation over that before. Noise that is blurred along an axis changes little from
/// pixel to pixel, so that interpolation along it does not reduce it.
double interpolated_share(const Eigen::Vector2d& place_px, const Path2d& blurred_by_px) {
  const Eigen::Vector2f extent_px = extent_of(blurred_by_px);
  double share = 1;
  for (int axis = 0; axis < 2; ++axis) {
    const double squares = interpolation_weights(place_px[axis] - std::floor(place_px[axis])).square().sum();
    share *= 1 - (1 - squares) / (1 + extent_px[axis]);
  }
  return share;
}

/// Of a template, without that of its noise, which biases a gain by it towards 0.
/// @param energy  sum of the squares of the template
/// @param noise   what noise has of it
double pattern_energy(double energy, double noise) {
  // Where noise is nearly all of it, its own scatter would decide.
  constexpr double kLeastShare = 0.1;
  return std::max(kLeastShare * energy, energy - noise);
}

}  // namespace

BlurredPoint at_half_size(BlurredPoint point) {
  // The middle of a pixel is between those of its four.
  point.place_px = 0.5 * point.place_px - Eigen::Vector2d::Constant(0.25);
  for (Eigen::Vector2f& at_px : point.path_px) at_px *= 0.5f;
  point.noise = std::hypot(0.5 * point.noise, kRoundingNoise);
  return point;
}

LocalMap at_half_size(LocalMap map) {
  map.quadratic *= 2;  // half of what offsets twice as long are moved by
  return map;
}

Alignment at_whole_size(Alignment found) {
  found.place_px = 2 * found.place_px + Eigen::Vector2d::Constant(0.5);
  found.covariance_px2 *= 4;
  return found;
}

bool agrees(const Alignment& alignment) {
  // Noise alone passes nearly always; the second is for errors of the local map, in proportion to the contrast.
  constexpr double kNoiseFactor = 1.7, kContrastShare = 0.4, kMinGain = 0.5, kMaxGain = 2;
  return alignment.gain > kMinGain && alignment.gain < kMaxGain &&
         alignment.residual <
             std::hypot(kNoiseFactor * alignment.expected_residual, kContrastShare * alignment.contrast);
}

void BlurAligner::Patch::resize(int width, int height) {
  width_ = width;
  height_ = height;
  stride_ = width + kPatchRoom;
  const auto needed = static_cast<std::size_t>(stride_ * height_ + kPatchRoom);
  if (pixels_.size() < needed) pixels_.resize(needed);
}

void BlurAligner::Patch::clear_room() {
  for (int y = 0; y < height_; ++y) std::fill_n(row(y) + width_, kPatchRoom, 0.0f);
}

void BlurAligner::choose_spacing(const Path2d& first_px, const Path2d& second_px) {
  // Where both blurs are long along an axis, neighbours show nearly the same, and each image's noise is blurred by the
  // other's path: every second or third pixel says as much as all (doc/reports/tracks.md).
  constexpr float kEverySecondPx = 6, kEveryThirdPx = 12;
  const Eigen::Vector2f shorter_px = extent_of(first_px).cwiseMin(extent_of(second_px));
  const std::size_t axis = shorter_px.x() > shorter_px.y() ? 0 : 1;
  const float extent_px = shorter_px[static_cast<Eigen::Index>(axis)];
  spacing_ = {1, 1};
  spacing_[axis] = extent_px >= kEveryThirdPx ? 3 : extent_px >= kEverySecondPx ? 2 : 1;
}

void BlurAligner::blur(const cv::Mat& image, const PathPsf& psf, const PixelBox& box, Region* blurred) {
  constexpr float kWeightOfAll = 32767;  // a pixel may have all of it, and int16 no more
  const PixelBox read = box.grown(psf.reach);
  const int stride = read.width() + kPatchRoom;
  const bool is_below = psf.axis == 1;
  const auto needed = static_cast<std::size_t>(stride * (read.height() + 1) + kPatchRoom);
  if (pairs_.size() < needed) pairs_.resize(needed);
  const auto image_stride = static_cast<std::ptrdiff_t>(image.step);
  simd_.make_pairs(image.ptr(read.first_y) + read.first_x, image_stride, is_below ? image_stride : 1, pairs_.data(),
                   stride, read.width() - (is_below ? 0 : 1), read.height() - (is_below ? 1 : 0));
  offsets_.clear();
  weights_.clear();
  int sum = 0;
  for (const PathPair& pair : psf.pairs) {
    const int first = static_cast<int>(kWeightOfAll * pair.first + 0.5f),
              second = static_cast<int>(kWeightOfAll * pair.second + 0.5f);
    offsets_.push_back(pair.y * stride + pair.x);
    weights_.push_back(first | second * (1 << 16));
    sum += first + second;
  }
  blurred->box = box;
  blurred->patch.resize(box.width(), box.height());
  simd_.convolve_pairs(pairs_.data(), stride, is_below ? stride : 1, offsets_.data(), weights_.data(),
                       static_cast<int>(weights_.size()), 1 / static_cast<float>(sum), blurred->patch.row(0),
                       blurred->patch.stride(), box.width(), box.height());
}

PixelBox BlurAligner::template_box(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map) const {
  Eigen::AlignedBox2d covered_px;
  const int margin_x = kTemplateMargin * spacing_[0], margin_y = kTemplateMargin * spacing_[1];
  for (const int x : {window_.first_x - margin_x, window_.last_x + margin_x}) {
    for (const int y : {window_.first_y - margin_y, window_.last_y + margin_y}) {
      covered_px.extend(place_px + inverse_map * Eigen::Vector2d(x, y));
    }
  }
  // One more for rounding: places are added up along a row.
  return {cvFloor(covered_px.min().x()) - kBefore - 1, cvFloor(covered_px.max().x()) + kAfter + 1,
          cvFloor(covered_px.min().y()) - kBefore - 1, cvFloor(covered_px.max().y()) + kAfter + 1};
}

PixelBox BlurAligner::search_box(const Eigen::Vector2d& place_px, int margin_px) const {
  const int x = cvFloor(place_px.x()), y = cvFloor(place_px.y());
  const int margin_x = margin_px + kPatchMargin * spacing_[0], margin_y = margin_px + kPatchMargin * spacing_[1];
  return {x + window_.first_x - margin_x - kBefore, x + window_.last_x + margin_x + kAfter,
          y + window_.first_y - margin_y - kBefore, y + window_.last_y + margin_y + kAfter};
}

bool BlurAligner::crop_window(const cv::Size& from, const Eigen::Vector2d& from_px, const cv::Size& to,
                              const Eigen::Vector2d& to_px, const Eigen::Matrix2d& inverse_map, int window_px) {
  const int half_px = window_px / 2;
  window_ = {-half_px, half_px, -half_px, half_px};
  // A map that rotates or stretches moves the first image's edge by more than what is cut off: again then.
  constexpr int kAttempts = 3;
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const PixelBox first = template_box(from_px, inverse_map).grown(psf_of_first_.reach),
                   second = search_box(to_px, kSearchMargin).grown(psf_of_second_.reach);
    const int left = std::max({0, -first.first_x, -second.first_x}),
              right = std::max({0, first.last_x - from.width + 1, second.last_x - to.width + 1}),
              top = std::max({0, -first.first_y, -second.first_y}),
              bottom = std::max({0, first.last_y - from.height + 1, second.last_y - to.height + 1});
    if (left + right + top + bottom == 0) {
      // Compared pixels are spread evenly about the middle.
      const int columns_left = (window_.width() - 1) % spacing_[0], rows_left = (window_.height() - 1) % spacing_[1];
      window_ = {window_.first_x + columns_left / 2, window_.last_x - (columns_left + 1) / 2,
                 window_.first_y + rows_left / 2, window_.last_y - (rows_left + 1) / 2};
      return true;
    }
    window_ = {window_.first_x + left, window_.last_x - right, window_.first_y + top, window_.last_y - bottom};
    if (window_.width() <= 0 || window_.height() <= 0) return false;
    if (window_.width() * window_.height() < kMinWindowShare * window_px * window_px) return false;
  }
  return false;
}

double BlurAligner::sample_template(const Eigen::Vector2d& place_px, const Eigen::Matrix2d& inverse_map,
                                    const LocalMap::Quadratic& quadratic) {
  constexpr int kMargin = kTemplateMargin;
  const int width = compared_columns(), height = compared_rows();
  sampled_.resize(width + 2 * kMargin, height + 2 * kMargin);
  const Eigen::Vector2d first_px(window_.first_x - kMargin * spacing_[0], window_.first_y - kMargin * spacing_[1]);
  const Eigen::Vector2f at_px =
      (place_px + inverse_map * first_px - Eigen::Vector2d(first_.box.first_x + kBefore, first_.box.first_y + kBefore))
          .cast<float>();
  const Eigen::Matrix2f step_px = (inverse_map * px_per_compared()).cast<float>();
  simd_.sample(first_.patch.row(0), first_.patch.stride(), interpolation(),
               {sampled_.width(), sampled_.height(), at_px.x(), at_px.y(), step_px(0, 0), step_px(1, 0), step_px(0, 1),
                step_px(1, 1)},
               sampled_.row(0), sampled_.stride());
  for (Patch* patch : {&template_, &gradient_x_, &gradient_y_}) {
    patch->resize(width, height);
    patch->clear_room();
  }
  const float* middle = sampled_.row(kMargin) + kMargin;
  simd_.differentiate(middle, sampled_.stride(), gradient_x_.row(0), gradient_y_.row(0), gradient_x_.stride(), width,
                      height);
  const Eigen::Matrix<float, 2, 3> per_compared =
      (px_per_compared().inverse() * quadratic_after(quadratic, px_per_compared())).cast<float>();
  float* displaced = template_.row(0);
  simd_.displace(middle, sampled_.stride(), per_compared.data(),
                 static_cast<float>(-window_.first_x) / static_cast<float>(spacing_[0]),
                 static_cast<float>(-window_.first_y) / static_cast<float>(spacing_[1]), displaced, template_.stride(),
                 width, height);
  // From a pixel of its own: squares of grey levels would leave few digits for the contrast.
  const float offset = *displaced;
  std::array<float, 3> sums;
  simd_.compare(displaced, template_.stride(), offset, displaced, template_.stride(), width, height, sums.data());
  const float mean = sums[0] / static_cast<float>(template_.size());
  simd_.combine(displaced, template_.stride(), 1, displaced, template_.stride(), 0, -offset - mean, displaced,
                template_.stride(), width, height);
  return std::max(0.0, static_cast<double>(sums[2]) - static_cast<double>(mean) * sums[0]);
}

void BlurAligner::sort_columns() {
  const Patch& blurred = second_.patch;
  const int each = (blurred.width() + spacing_[0] - 1) / spacing_[0];
  sorted_.resize(spacing_[0] * each, blurred.height());
  const auto sort_row = spacing_[0] == 2 ? simd_.sort_by_two : simd_.sort_by_three;
  for (int y = 0; y < blurred.height(); ++y) sort_row(blurred.row(y), sorted_.row(y), each);
}

void BlurAligner::sample_patch(const Eigen::Vector2d& place_px) {
  const int x = cvFloor(place_px.x()), y = cvFloor(place_px.y());
  const auto across = interpolation_weights(place_px.x() - x), down = interpolation_weights(place_px.y() - y);
  constexpr int kMargin = kPatchMargin;
  const int left = x + window_.first_x - kMargin * spacing_[0] - kBefore - second_.box.first_x,
            top = y + window_.first_y - kMargin * spacing_[1] - kBefore - second_.box.first_y,
            width = compared_columns() + 2 * kMargin, height = compared_rows() + 2 * kMargin,
            rows = (height - 1) * spacing_[1] + kTaps;
  rows_.resize(width, rows);
  patch_.resize(width, height);
  const Patch& blurred = spacing_[0] == 1 ? second_.patch : sorted_;
  std::array<int, kTaps> right_of, below;
  for (int k = 0; k < kTaps; ++k) {
    right_of[k] = (left + k) % spacing_[0] * (blurred.width() / spacing_[0]) + (left + k) / spacing_[0];
    below[k] = k * rows_.stride();
  }
  simd_.convolve(blurred.row(top), blurred.stride(), right_of.data(), across.data(), kTaps, rows_.row(0),
                 rows_.stride(), width, rows);
  simd_.convolve(rows_.row(0), spacing_[1] * rows_.stride(), below.data(), down.data(), kTaps, patch_.row(0),
                 patch_.stride(), width, height);
}

Eigen::Matrix2d BlurAligner::gradients_without_gain(double pattern) {
  const int width = template_.width(), height = template_.height(), stride = template_.stride();
  std::array<float, 3> sums;
  for (Patch* gradient : {&gradient_x_, &gradient_y_}) {
    float* pixels = gradient->row(0);
    simd_.compare(pixels, stride, 0, template_.row(0), stride, width, height, sums.data());
    // The template has no mean.
    const float mean = sums[0] / static_cast<float>(template_.size()),
                share = pattern > 0 ? sums[1] / static_cast<float>(pattern) : 0;
    simd_.combine(pixels, stride, 1, template_.row(0), stride, -share, -mean, pixels, stride, width, height);
  }
  products_.clear();
  return gradient_products(0, 0);
}

Eigen::Matrix2d BlurAligner::gradient_products(int away_x, int away_y) {
  // Paths of successive images are nearly the same, and so are their lags.
  for (const GradientProducts& known : products_) {
    if (known.away_x == away_x && known.away_y == away_y) return known.sums;
  }
  const int left = std::max(0, -away_x), right = std::max(0, away_x);
  std::array<float, 3> sums;
  simd_.multiply_gradients(gradient_x_.row(0) + left, gradient_y_.row(0) + left, gradient_x_.row(away_y) + right,
                           gradient_y_.row(away_y) + right, gradient_x_.stride(),
                           gradient_x_.width() - std::abs(away_x), gradient_x_.height() - away_y, sums.data());
  GradientProducts products{away_x, away_y, {}};
  products.sums << sums[0], 0.5 * sums[1], 0.5 * sums[1], sums[2];
  products_.push_back(products);
  return products.sums;
}

double BlurAligner::residual(double gain) {
  const int width = template_.width(), height = template_.height();
  const float* middle = patch_.row(kPatchMargin) + kPatchMargin;
  // Less one of its own grey levels, as in sample_template(): squares would leave few digits for the difference.
  difference_.resize(width, height);
  simd_.combine(middle, patch_.stride(), 1, template_.row(0), template_.stride(), static_cast<float>(-gain), -*middle,
                difference_.row(0), difference_.stride(), width, height);
  std::array<float, 3> sums;
  simd_.compare(difference_.row(0), difference_.stride(), 0, template_.row(0), template_.stride(), width, height,
                sums.data());
  const double pixels = template_.size(), mean = sums[0] / pixels;
  return std::sqrt(std::max(0.0, sums[2] / pixels - mean * mean));
}

bool BlurAligner::search(const cv::Mat& to, const Eigen::Matrix2d& gradients, double pattern,
                         const AlignmentOptions& options, Eigen::Vector2d* place_px, double* gain) {
  constexpr double kMinGain = 0.1, kLongestStepPx = 2;
  const PixelBox image{0, to.cols - 1, 0, to.rows - 1};
  const Eigen::Matrix2d inverse = gradients.inverse(), per_compared_px = px_per_compared();
  const Eigen::Vector2d start_px = *place_px;
  const std::array<const float*, 3> factors{template_.row(0), gradient_x_.row(0), gradient_y_.row(0)};
  second_.box = {};
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    if (!second_.box.contains(search_box(*place_px, 0))) {
      const PixelBox box = search_box(*place_px, kSearchMargin);
      if (!image.contains(box.grown(psf_of_second_.reach))) return false;
      blur(to, psf_of_second_, box, &second_);
      if (spacing_[0] > 1) sort_columns();
    }
    sample_patch(*place_px);
    // The factors have no mean: that of the patch does not matter.
    std::array<float, 3> sums;
    simd_.project(patch_.row(kPatchMargin) + kPatchMargin, patch_.stride(), factors.data(), template_.stride(),
                  compared_columns(), compared_rows(), sums.data());
    *gain = sums[0] / pattern;
    if (!(*gain > kMinGain)) return false;
    const Eigen::Vector2d products(sums[1], sums[2]);
    Eigen::Vector2d step_px = -per_compared_px * inverse * products / *gain;
    const double length_px = step_px.norm();
    if (length_px > kLongestStepPx) step_px *= kLongestStepPx / length_px;
    // The last step is taken without reading the patch again: it is shorter than what a patch shows.
    *place_px += step_px;
    if (!((*place_px - start_px).norm() <= options.max_offset_px)) return false;
    if (length_px < options.min_step_px) return true;
  }
  return false;
}

Eigen::Matrix2d BlurAligner::multiply_gradients_of_both() {
  std::array<float, 3> sums;
  simd_.multiply_by_derivatives(gradient_x_.row(0), gradient_y_.row(0), gradient_x_.stride(),
                                patch_.row(kPatchMargin) + kPatchMargin, patch_.stride(), compared_columns(),
                                compared_rows(), sums.data());
  Eigen::Matrix2d products;
  products << sums[0], sums[1] / 2, sums[1] / 2, sums[2];
  return products;
}

BlurAligner::NoiseShare BlurAligner::noise_share(const Path2d& path_px) {
  const int width = compared_columns(), height = compared_rows();
  NoiseShare share;
  find_noise_lags(path_px, spacing_, &lags_);
  for (const NoiseLag& lag : lags_) {
    if (lag.y >= height || std::abs(lag.x) >= width) continue;
    share.products += lag.correlation * gradient_products(lag.x, lag.y);
    share.mean += lag.correlation * (width - std::abs(lag.x)) * (height - lag.y);
  }
  share.mean /= std::pow(width * height, 2);
  return share;
}

std::optional<Alignment> BlurAligner::align(const cv::Mat& from, const BlurredPoint& in_from, const cv::Mat& to,
                                            const BlurredPoint& in_to, const LocalMap& map,
                                            const AlignmentOptions& options) {
  constexpr double kLeastDeterminant = 0.1;  // a tenth of the area: nothing that is followed shrinks so
  if (!(map.jacobian.determinant() > kLeastDeterminant)) return std::nullopt;
  const Eigen::Matrix2d inverse_map = map.jacobian.inverse();
  // Paths are mapped to first order: so there is no bias where a window is full of texture (doc/design/tracks.md).
  const Path2d blur_of_second_px = mapped(in_from.path_px, map.jacobian),
               blur_of_first_px = mapped(in_to.path_px, inverse_map);
  if (!can_be_aligned(in_from.place_px, blur_of_first_px, from.size()) ||
      !can_be_aligned(in_to.place_px, blur_of_second_px, to.size())) {
    return std::nullopt;
  }
  choose_spacing(in_to.path_px, blur_of_second_px);
  rasterize(blur_of_first_px, &psf_of_first_);
  rasterize(blur_of_second_px, &psf_of_second_);
  if (!crop_window(from.size(), in_from.place_px, to.size(), in_to.place_px, inverse_map, options.window_px)) {
    return std::nullopt;
  }
  blur(from, psf_of_first_, template_box(in_from.place_px, inverse_map), &first_);
  const double energy = sample_template(in_from.place_px, inverse_map, quadratic_after(map.quadratic, inverse_map)),
               template_noise = psf_of_first_.energy * interpolated_share(in_from.place_px, blur_of_first_px),
               pattern = pattern_energy(energy, std::pow(in_from.noise, 2) * template_noise * template_.size());
  const Eigen::Matrix2d gradients = gradients_without_gain(pattern);
  const Eigen::Matrix2d per_px = px_per_compared().inverse();
  if (!(least_eigenvalue(per_px * gradients * per_px) > kLeastInformation * template_.size())) return std::nullopt;

  Alignment result{};
  result.place_px = in_to.place_px;
  if (!search(to, gradients, pattern, options, &result.place_px, &result.gain)) return std::nullopt;
  // By the gain: as the template's gradients alone would be without their noise.
  const Eigen::Matrix2d products_of_both = multiply_gradients_of_both() / result.gain;
  if (!(least_eigenvalue(per_px * products_of_both * per_px) > kLeastInformation * template_.size())) {
    return std::nullopt;
  }
  result.contrast = result.gain * std::sqrt(pattern / template_.size());
  result.residual = residual(result.gain);
  const double first_variance = std::pow(result.gain * in_from.noise, 2), second_variance = std::pow(in_to.noise, 2);
  const NoiseShare of_first = noise_share(in_to.path_px), of_second = noise_share(blur_of_second_px);
  // The patches are compared without their means, of which long blur makes much of the noise.
  const double first_left = template_noise - of_first.mean,
               second_left =
                   psf_of_second_.energy * interpolated_share(result.place_px, blur_of_second_px) - of_second.mean;
  result.expected_residual =
      std::sqrt(first_variance * std::max(0.0, first_left) + second_variance * std::max(0.0, second_left));
  const Eigen::Matrix2d px_per_product = px_per_compared() * products_of_both.inverse();
  const Eigen::Matrix2d products = first_variance * of_first.products + second_variance * of_second.products;
  const double excess = result.expected_residual > 0 ? result.residual / result.expected_residual : 1;
  result.covariance_px2 = px_per_product * products * px_per_product.transpose() * std::max(1.0, excess * excess) /
                          (result.gain * result.gain);
  return result;
}

}  // namespace gyro_deblur
