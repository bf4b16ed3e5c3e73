#include "features/blur_alignment.hpp"

#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "blurred_texture.hpp"
#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::blur_alignment_test {
namespace {

using test::SinusoidTexture;
using View = SinusoidTexture::View;

const cv::Size kSize(760, 760);

/// Straight, at a speed that goes from nearly none to twice the mean.
Path2d accelerated_path(double extent_px, double angle_rad) {
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const double s = static_cast<double>(k) / (kPathInstants - 1), along = extent_px * (s * s - 0.25);
    path_px[k] = Eigen::Vector2d(along * std::cos(angle_rad), along * std::sin(angle_rad)).cast<float>();
  }
  return path_px;
}

Path2d straight_path(double extent_px, double angle_rad) { return test::arc_path(extent_px, 0, angle_rad); }

/// Rotated by 3 degrees, 3 % nearer, a little sheared.
Eigen::Matrix2d some_map() {
  Eigen::Matrix2d map;
  map << 1.03, -0.04, 0.065, 1.02;
  return map;
}

double contrast_of(const cv::Mat& image) {
  cv::Scalar mean, deviation;
  cv::meanStdDev(image, mean, deviation);
  return deviation[0];
}

cv::Mat exposed(const cv::Mat& image, double noise, std::uint64_t seed) {
  cv::Mat with_noise = image.clone(), result;
  if (noise > 0) {
    cv::Mat of_noise(image.size(), CV_64FC1);
    cv::RNG rng(seed);
    rng.fill(of_noise, cv::RNG::NORMAL, 0, noise);
    with_noise += of_noise;
  }
  with_noise.convertTo(result, CV_8U);
  return result;
}

cv::Mat halved(const cv::Mat& image) {
  cv::Mat half;
  cv::resize(image, half, {}, 0.5, 0.5, cv::INTER_AREA);
  return half;
}

/// Points of two images of one texture.
struct Comparison {
  int found = 0;
  Eigen::Vector2d mean_px = Eigen::Vector2d::Zero(), mean_size_px = Eigen::Vector2d::Zero();  // of the errors
  double mahalanobis = 0, residual_ratio = 0, gain = 0;                                       // means
};

class BlurAlignmentTest : public testing::Test {
 protected:
  static constexpr double kRounding = 0.29;  // standard deviation of rounding to whole numbers

  Comparison compare(const cv::Mat& from, const cv::Mat& to, double noise, bool knows_paths = true) {
    Comparison result;
    cv::RNG rng(3);
    const Eigen::Matrix2d map = second_.map * first_.map.inverse();
    for (int i = 0; i < points_; ++i) {
      const Eigen::Vector2d at_px(rng.uniform(150.0, 610.0), rng.uniform(150.0, 610.0)),
          truth_px = second_.at(first_.map.inverse() * (at_px - first_.shift_px)),
          start_px = truth_px + Eigen::Vector2d(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0));
      const double sigma = std::hypot(noise, kRounding);
      const Path2d none = still_path();
      const BlurredPoint in_from{at_px, knows_paths ? first_.path_px : none, sigma},
          in_to{start_px, knows_paths ? second_.path_px : none, sigma};
      auto found = half_size_ ? aligner_.align(halved(from), at_half_size(in_from), halved(to), at_half_size(in_to),
                                               map, options_)
                              : aligner_.align(from, in_from, to, in_to, map, options_);
      if (!found) continue;
      if (half_size_) *found = at_whole_size(*found);
      ++result.found;
      const Eigen::Vector2d error_px = found->place_px - truth_px;
      result.mean_px += error_px;
      result.mean_size_px += error_px.cwiseAbs();
      result.mahalanobis += error_px.dot(found->covariance_px2.inverse() * error_px);
      result.residual_ratio += found->residual / found->expected_residual;
      result.gain += found->gain;
    }
    const double count = std::max(1, result.found);
    result.mean_px /= count;
    result.mean_size_px /= count;
    result.mahalanobis /= count;
    result.residual_ratio /= count;
    result.gain /= count;
    return result;
  }
  Comparison compare(double noise = 0, bool knows_paths = true) {
    return compare(exposed(texture_.seen_by(first_, kSize, contrast_), noise, 11),
                   exposed(texture_.seen_by(second_, kSize, contrast_), noise, 12), noise, knows_paths);
  }

  static constexpr double kContrast = 40;
  double contrast_ = kContrast;
  SinusoidTexture texture_{300, 5};
  View first_, second_{some_map(), {-12.3, 20.6}};
  BlurAligner aligner_;
  AlignmentOptions options_;
  bool half_size_ = false;
  int points_ = 100;
};

struct PairOfPaths {
  const char* name;
  Path2d first_px, second_px;
};

TEST_F(BlurAlignmentTest, WithoutNoiseTheMeanErrorIsBelowAHundredthOfAPixel) {
  points_ = 200;
  const std::vector<PairOfPaths> pairs{
      {"sharp", still_path(), still_path()},
      {"straight, one sharp", straight_path(30, 0.4), still_path()},
      {"straight, nearly the same", straight_path(60, 1.2), straight_path(55, 1.25)},
      {"straight, crossing", straight_path(20, 0.3), straight_path(30, 1.9)},
      {"straight, long and crossing", straight_path(60, 0.1), straight_path(60, 1.6)},
      {"non-uniform and straight", accelerated_path(40, 0.7), straight_path(25, 1.1)},
      {"non-uniform, there and back", accelerated_path(60, 2.5), accelerated_path(60, 2.5 + CV_PI)},
      {"curved and straight", test::arc_path(45, 12, 0.9), straight_path(35, 0.2)},
      {"curved, one sharp", still_path(), test::arc_path(60, 15, 2.1)},
      {"curved", test::arc_path(60, 15, 0.2), test::arc_path(50, -14, 1.0)}};
  for (const PairOfPaths& pair : pairs) {
    first_.path_px = pair.first_px;
    second_.path_px = pair.second_px;
    // Rounding to grey levels is noise as well: the blurred images use their range, and are nowhere saturated.
    constexpr double kBlurredContrast = 27;
    const cv::Mat from = texture_.seen_by(first_, kSize, kContrast), to = texture_.seen_by(second_, kSize, kContrast);
    const double scale = kBlurredContrast / std::max(contrast_of(from), contrast_of(to));
    const Comparison result =
        compare(exposed(128 + scale * (from - 128), 0, 0), exposed(128 + scale * (to - 128), 0, 0), 0);
    std::printf("%-28s %3d found, mean error (%.4f, %.4f) px, e^T C^-1 e %.2f\n", pair.name, result.found,
                result.mean_px.x(), result.mean_px.y(), result.mahalanobis);
    EXPECT_GE(result.found, 0.98 * points_) << pair.name;
    EXPECT_LT(result.mean_px.cwiseAbs().maxCoeff(), 0.01) << pair.name;
    // Single errors: of rounding, where long paths leave little contrast, and of PSFs in whole pixels.
    EXPECT_LT(result.mean_size_px.maxCoeff(), 0.05) << pair.name;
  }
}

TEST_F(BlurAlignmentTest, PathsAreWhatMakesItSo) {
  first_.path_px = test::arc_path(30, 6, 0.2);
  second_.path_px = accelerated_path(25, 1.5);
  const Comparison known = compare(), unknown = compare(0, false);
  EXPECT_GT(unknown.mean_size_px.minCoeff(), 20 * known.mean_size_px.maxCoeff());
}

TEST_F(BlurAlignmentTest, CovarianceAndExpectedResidualAreThoseOfTheErrors) {
  constexpr double kAcross = CV_PI / 2;
  const auto pair_of = [](double extent_px) {
    return PairOfPaths{"same direction", straight_path(extent_px, 0.5), straight_path(1.2 * extent_px, 1.0)};
  };
  // Pixels of a PSF smooth a sharp image a little: residuals are larger there.
  const std::vector<PairOfPaths> pairs{pair_of(0),
                                       pair_of(6),
                                       pair_of(15),
                                       pair_of(40),
                                       {"crossing, 15 and 10", straight_path(15, 0), straight_path(10, kAcross)},
                                       {"crossing, 30 and 25", straight_path(30, 0), straight_path(25, kAcross)},
                                       {"crossing, 60 and 50", straight_path(60, 0), straight_path(50, kAcross)},
                                       {"30 and still", straight_path(30, 0), still_path()},
                                       {"still and 30", still_path(), straight_path(30, 0)}};
  for (const double noise : {2.0, 4.0}) {
    for (const PairOfPaths& pair : pairs) {
      first_.path_px = pair.first_px;
      second_.path_px = pair.second_px;
      const Comparison result = compare(noise);
      std::printf("noise %.0f, %-20s %3d found, size of error (%.3f, %.3f) px, e^T C^-1 e %.2f, residual %.2f\n", noise,
                  pair.name, result.found, result.mean_size_px.x(), result.mean_size_px.y(), result.mahalanobis,
                  result.residual_ratio);
      EXPECT_GE(result.found, 95);
      // Two degrees of freedom; the mean of 100 scatters by 0.2.
      const bool is_alike = std::string(pair.name) == "same direction";
      EXPECT_GT(result.mahalanobis, is_alike ? 1.4 : 1.1);
      EXPECT_LT(result.mahalanobis, 2.8);
      EXPECT_NEAR(result.residual_ratio, 1, is_alike ? 0.1 : 0.15);
    }
  }
}

// Where one image is sharp its neighbours along the other's blur have noise of their own: each has its say.
TEST_F(BlurAlignmentTest, NoPixelIsLeftOutThatSaysSomething) {
  first_.path_px = straight_path(30, 0);
  const Comparison with_sharp = compare(2);
  std::printf("30 px and still: size of error (%.3f, %.3f) px\n", with_sharp.mean_size_px.x(),
              with_sharp.mean_size_px.y());
  EXPECT_LT(with_sharp.mean_size_px.x(), 0.08);  // with every third pixel 0.115
}

TEST_F(BlurAlignmentTest, BlurIsComparedInTheSecondImagesAxes) {
  options_.window_px = 41;
  for (const double extent_px : {20.0, 40.0}) {
    first_.path_px = straight_path(extent_px, 0);
    second_ = {some_map(), {-12.3, 20.6}};
    second_.path_px = straight_path(extent_px, 0);
    const Comparison upright = compare(2);
    first_.path_px = straight_path(extent_px, -CV_PI / 2);
    second_.map << 0, -1, 1, 0;
    second_.shift_px = {760, 0};
    const Comparison rolled = compare(2);
    EXPECT_GE(rolled.found, 95);
    EXPECT_LT(rolled.mean_size_px.x(), 1.2 * upright.mean_size_px.x());
    EXPECT_LT(rolled.mean_size_px.y(), 1.2 * upright.mean_size_px.y());
    EXPECT_NEAR(rolled.residual_ratio, 1, 0.1);
  }
}

TEST_F(BlurAlignmentTest, HalfTheSizeServesInLongBlur) {
  half_size_ = true;
  first_.path_px = straight_path(40, 0.5);
  second_.path_px = straight_path(48, 1.0);
  // Offsets left out on the way there and back would be .04 px along y by this map.
  const Comparison clean = compare();
  EXPECT_GE(clean.found, 95);
  EXPECT_LT(clean.mean_px.cwiseAbs().maxCoeff(), 0.01);
  const Comparison noisy = compare(4);
  std::printf("off by (%.4f, %.4f) px; noise 4: %d found, size of error (%.3f, %.3f) px, e^T C^-1 e %.2f\n",
              clean.mean_px.x(), clean.mean_px.y(), noisy.found, noisy.mean_size_px.x(), noisy.mean_size_px.y(),
              noisy.mahalanobis);
  EXPECT_GE(noisy.found, 95);
  EXPECT_GT(noisy.mahalanobis, 1.4);
  EXPECT_LT(noisy.mahalanobis, 2.8);
}

TEST_F(BlurAlignmentTest, NoiseIsNotTakenForContrast) {
  contrast_ = 6;
  for (const double extent_px : {0.0, 6.0}) {
    first_.path_px = straight_path(extent_px, 0.5);
    second_.path_px = straight_path(1.2 * extent_px, 1.0);
    const Comparison result = compare(4);
    std::printf("contrast 6, noise 4, %2.0f px: %3d found, size of error (%.3f, %.3f) px, e^T C^-1 e %.2f, gain %.2f\n",
                extent_px, result.found, result.mean_size_px.x(), result.mean_size_px.y(), result.mahalanobis,
                result.gain);
    EXPECT_GE(result.found, 95);
    EXPECT_NEAR(result.gain, 1, 0.1);
    EXPECT_LT(result.mean_size_px.maxCoeff(), extent_px > 0 ? 0.3 : 0.12);
    EXPECT_GT(result.mahalanobis, 1.2);
    EXPECT_LT(result.mahalanobis, 2.8);
  }
}

TEST_F(BlurAlignmentTest, GainAndOffsetAreFitted) {
  first_.path_px = straight_path(12, 0.5);
  second_.path_px = straight_path(18, 0.9);
  const cv::Mat from = texture_.seen_by(first_, kSize, kContrast), to = texture_.seen_by(second_, kSize, kContrast);
  const Comparison result = compare(exposed(from, 0, 1), exposed(0.6 * to + 70, 0, 2), 0);
  EXPECT_GE(result.found, 98);
  EXPECT_NEAR(result.gain, 0.6, 0.01);
  EXPECT_LT(result.mean_px.cwiseAbs().maxCoeff(), 0.01);
  EXPECT_LT(result.mean_size_px.maxCoeff(), 0.02);
}

TEST_F(BlurAlignmentTest, AWindowThatTheEdgeCutsIsComparedWhereItIsComplete) {
  first_.path_px = second_.path_px = straight_path(20, 0);
  second_.map.setIdentity();
  second_.shift_px = {3.3, -2.6};
  const cv::Mat from = exposed(texture_.seen_by(first_, kSize, kContrast), 0, 1),
                to = exposed(texture_.seen_by(second_, kSize, kContrast), 0, 2);
  const Eigen::Matrix2d map = Eigen::Matrix2d::Identity();
  // The window reaches 10 px, its blur as many, the search and cubic interpolation five.
  const auto find = [&](double x_px) {
    return aligner_.align(from, {{x_px, 300}, first_.path_px, kRounding}, to,
                          {{x_px + 3, 298}, second_.path_px, kRounding}, map, options_);
  };
  const auto cut = find(17);
  ASSERT_TRUE(cut);
  const Eigen::Vector2d error_px = cut->place_px - Eigen::Vector2d(20.3, 297.4);
  EXPECT_LT(error_px.norm(), 0.1);
  EXPECT_FALSE(find(9));
  EXPECT_FALSE(find(-50));
}

// Windows of other widths leave their pixels where those of this one have room behind their rows.
TEST_F(BlurAlignmentTest, WhatCameBeforeDoesNotMatter) {
  const Eigen::Matrix2d map = second_.map * first_.map.inverse();
  int found = 0;
  for (const double angle_rad : {0.1, CV_PI / 2}) {
    for (const double extent_px : {40.0, 0.0, 6.0, 15.0}) {  // every third pixel, all, all, every second
      first_.path_px = straight_path(extent_px, angle_rad);
      second_.path_px = straight_path(0.75 * extent_px, angle_rad + 0.3);
      const cv::Mat from = exposed(texture_.seen_by(first_, kSize, contrast_), 2, 11),
                    to = exposed(texture_.seen_by(second_, kSize, contrast_), 2, 12);
      for (int x = 40; x < 60; ++x) {  // whole, and cut by the left edge
        const Eigen::Vector2d at_px(x % 3 == 0 ? 300 : x, 300), truth_px = second_.at(first_.map.inverse() * at_px);
        const auto align = [&](BlurAligner& aligner) {
          return aligner.align(from, {at_px, first_.path_px, 2}, to, {truth_px, second_.path_px, 2}, map, options_);
        };
        BlurAligner fresh;
        const auto expected = align(fresh), actual = align(aligner_);
        ASSERT_EQ(actual.has_value(), expected.has_value()) << x;
        if (!actual) continue;
        ++found;
        EXPECT_EQ(actual->place_px, expected->place_px) << x;
        EXPECT_EQ(actual->covariance_px2, expected->covariance_px2) << x;
        EXPECT_EQ(actual->residual, expected->residual) << x;
      }
    }
  }
  EXPECT_GT(found, 80);
}

/// A camera that rotates about an axis across the optical one: its image moves along motion().
class RotatingCamera {
 public:
  static constexpr double kFocalPx = 460;
  static Eigen::Vector2d motion() { return {0.8, 0.6}; }
  /// What a pixel at no rotation shows, where it is at `angle_rad`.
  static cv::Matx33d homography(double angle_rad) {
    const double middle = 0.5 * (kSize.width - 1);
    const cv::Matx33d K(kFocalPx, 0, middle, 0, kFocalPx, middle, 0, 0, 1);
    const Eigen::Matrix3d R =
        Eigen::AngleAxisd(angle_rad, Eigen::Vector3d(-motion().y(), motion().x(), 0)).toRotationMatrix().transpose();
    return K * cv::Matx33d(R.data()) * K.inv();  // Eigen has columns one after the other
  }
  static Eigen::Vector2d moved(const Eigen::Vector2d& at_px, double from_rad, double to_rad) {
    const cv::Vec3d v = homography(to_rad) * (homography(from_rad).inv() * cv::Vec3d(at_px.x(), at_px.y(), 1));
    return {v[0] / v[2], v[1] / v[2]};
  }
  /// Exposed from middle_rad - half_rad to middle_rad + half_rad.
  static cv::Mat seen(const cv::Mat& texture, double middle_rad, double half_rad) {
    constexpr int kInstants = 32;
    cv::Mat sum(texture.size(), CV_32FC1, cv::Scalar(0)), wide, at;
    texture.convertTo(wide, CV_32F);
    for (int k = 0; k < kInstants; ++k) {
      const double angle_rad = middle_rad + half_rad * ((2 * k + 1.0) / kInstants - 1);
      cv::warpPerspective(wide, at, homography(angle_rad), texture.size(), cv::INTER_LANCZOS4, cv::BORDER_REFLECT);
      sum += at / kInstants;
    }
    cv::Mat image;
    sum.convertTo(image, CV_8U);
    return image;
  }
  static Path2d path(const Eigen::Vector2d& at_px, double middle_rad, double half_rad) {
    Path2d path_px;
    for (int k = 0; k < kPathInstants; ++k) {
      const double angle_rad = middle_rad + half_rad * (2.0 * k / (kPathInstants - 1) - 1);
      path_px[k] = (moved(at_px, middle_rad, angle_rad) - at_px).cast<float>();
    }
    return path_px;
  }
  static LocalMap map(const Eigen::Vector2d& at_px, double from_rad, double to_rad) {
    const Eigen::Vector2d place_px = moved(at_px, from_rad, to_rad);
    const auto away_px = [&](double x, double y) -> Eigen::Vector2d {
      return moved(at_px + Eigen::Vector2d(x, y), from_rad, to_rad) - place_px;
    };
    constexpr double h = 10;
    LocalMap map;
    map.jacobian << 0.5 * (away_px(1, 0) - away_px(-1, 0)), 0.5 * (away_px(0, 1) - away_px(0, -1));
    map.quadratic.col(0) = (away_px(h, 0) + away_px(-h, 0)) / (2 * h * h);
    map.quadratic.col(2) = (away_px(0, h) + away_px(0, -h)) / (2 * h * h);
    map.quadratic.col(1) =
        (away_px(h, h) + away_px(-h, -h)) / (2 * h * h) - map.quadratic.col(0) - map.quadratic.col(2);
    return map;
  }
};

TEST_F(BlurAlignmentTest, ARotationIsFollowedToSecondOrder) {
  // 6 degrees, and up to 30 px of blur.
  constexpr double kFromRad = -0.052, kToRad = 0.052;
  options_.window_px = 41;
  for (const double half_rad : {0.0, 0.0325}) {
    Eigen::Vector2d corrected_px = Eigen::Vector2d::Zero(), affine_px = Eigen::Vector2d::Zero();
    cv::RNG rng(5);
    int count = 0;
    // A few corners decide where a patch is: on average over textures.
    for (const std::uint64_t seed : {5, 6, 7}) {
      const cv::Mat texture = SinusoidTexture(300, seed).seen_by({}, kSize, contrast_),
                    from = RotatingCamera::seen(texture, kFromRad, half_rad),
                    to = RotatingCamera::seen(texture, kToRad, half_rad);
      for (int i = 0; i < 200; ++i) {
        const Eigen::Vector2d at_px(rng.uniform(170.0, 590.0), rng.uniform(170.0, 590.0)),
            truth_px = RotatingCamera::moved(at_px, kFromRad, kToRad);
        const BlurredPoint in_from{at_px, RotatingCamera::path(at_px, kFromRad, half_rad), kRounding},
            in_to{truth_px, RotatingCamera::path(truth_px, kToRad, half_rad), kRounding};
        const LocalMap map = RotatingCamera::map(at_px, kFromRad, kToRad);
        const auto with = aligner_.align(from, in_from, to, in_to, map, options_),
                   without = aligner_.align(from, in_from, to, in_to, map.jacobian, options_);
        if (!with || !without) continue;
        corrected_px += with->place_px - truth_px;
        affine_px += without->place_px - truth_px;
        ++count;
      }
    }
    EXPECT_GT(count, 500);
    corrected_px /= count;
    affine_px /= count;
    std::printf("%.0f px of blur: mean error to first order %.4f px, to second %.4f px\n",
                2 * half_rad * RotatingCamera::kFocalPx, affine_px.norm(), corrected_px.norm());
    EXPECT_GT(std::abs(affine_px.dot(RotatingCamera::motion())), 0.025);
    // Not all of it: differences over three pixels are smaller than the derivatives of fine texture.
    EXPECT_LT(corrected_px.norm(), 0.35 * affine_px.norm());
  }
}

TEST_F(BlurAlignmentTest, FindsNothingWhereThereIsNothingToFind) {
  const cv::Mat texture = exposed(texture_.seen_by(first_, kSize, kContrast), 0, 1);
  const Eigen::Matrix2d map = Eigen::Matrix2d::Identity();
  const BlurredPoint point{{300, 300}, straight_path(10, 0.3), kRounding};
  const auto align = [&](const cv::Mat& from, const cv::Mat& to, const Eigen::Vector2d& start_px,
                         const Eigen::Matrix2d& by) {
    return aligner_.align(from, point, to, {start_px, point.path_px, kRounding}, by, options_);
  };
  ASSERT_TRUE(align(texture, texture, {300.5, 299.5}, map));
  const cv::Mat flat(kSize, CV_8UC1, cv::Scalar(90));
  EXPECT_FALSE(align(flat, flat, {300, 300}, map));
  EXPECT_FALSE(align(texture, flat, {300, 300}, map));
  cv::Mat stripes(kSize, CV_8UC1);
  for (int y = 0; y < kSize.height; ++y) stripes.row(y) = 128 + 100 * std::sin(0.3 * y);
  EXPECT_FALSE(align(stripes, stripes, {300, 300}, map)) << "texture in one direction alone";
  options_.max_offset_px = 0.5;
  EXPECT_FALSE(align(texture, texture, {302, 300}, map)) << "farther than it may search";
  options_.max_offset_px = 6;
  EXPECT_FALSE(align(texture, texture, {300, 300}, Eigen::Matrix2d::Zero()));
  EXPECT_FALSE(align(texture, texture, {std::nan(""), 300}, map));
  EXPECT_FALSE(align(texture, texture, {1e9, 300}, map));
  // A gyroscope in degrees/s has such paths.
  for (const double length_px : {1e5, 1e12, HUGE_VAL}) {
    const BlurredPoint far{{300, 300}, straight_path(length_px, 0.3), kRounding};
    EXPECT_FALSE(aligner_.align(texture, far, texture, point, map, options_)) << length_px;
    EXPECT_FALSE(aligner_.align(texture, point, texture, far, map, options_)) << length_px;
  }
}

}  // namespace
}  // namespace gyro_deblur::blur_alignment_test
