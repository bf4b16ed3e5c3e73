#include "features/point_covariance.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur::point_covariance_test {
namespace {

constexpr int kSidePx = 129, kMiddlePx = 64;
constexpr double kRadiusPx = 6;
const Eigen::Vector2d kMiddle(kMiddlePx, kMiddlePx);

FrameBlur field_of(BlockStatus status, double noise, double extent_px = 0, double angle_rad = 0) {
  FrameBlur field;
  field.grid = BlockGrid(kSidePx, kSidePx, 64);
  BlockBlur block;
  block.status = status;
  block.extent_px = static_cast<float>(extent_px);
  block.angle_rad = static_cast<float>(angle_rad);
  field.blocks.assign(static_cast<std::size_t>(field.grid.size()), block);
  field.noise = noise;
  field.exposure_ns = 20'000'000;
  return field;
}

/// contrast exp(-u^2 / 2 a^2 - v^2 / 2 b^2) about the middle, u along angle_rad, v across.
cv::Mat bump(double contrast, double a_px, double b_px, double angle_rad = 0) {
  cv::Mat image(kSidePx, kSidePx, CV_8UC1);
  for (int y = 0; y < kSidePx; ++y) {
    for (int x = 0; x < kSidePx; ++x) {
      const double dx = x - kMiddlePx, dy = y - kMiddlePx;
      const double u = (dx * std::cos(angle_rad) + dy * std::sin(angle_rad)) / a_px,
                   v = (dy * std::cos(angle_rad) - dx * std::sin(angle_rad)) / b_px;
      image.at<uchar>(y, x) = cv::saturate_cast<uchar>(30 + contrast * std::exp(-0.5 * (u * u + v * v)));
    }
  }
  return image;
}

/// Dark to the left of the middle's column, bright from there on.
cv::Mat upright_edge() {
  cv::Mat image(kSidePx, kSidePx, CV_8UC1, cv::Scalar(50));
  image(cv::Rect(kMiddlePx, 0, kSidePx - kMiddlePx, kSidePx)) = 200;
  return image;
}

Eigen::Matrix2d of_keypoint(const cv::Mat& image, const FrameBlur& field, const Eigen::Vector2d& pixel_px = kMiddle) {
  return PointCovariance(image, field).at(pixel_px, kRadiusPx, kBlobErrors);
}

/// What noise makes of a covariance when it grows from `less` to `more`; everything else goes out.
Eigen::Matrix2d of_noise(const cv::Mat& image, double less, double more) {
  return of_keypoint(image, field_of(BlockStatus::SHARP, more)) -
         of_keypoint(image, field_of(BlockStatus::SHARP, less));
}

bool is_positive_definite(const Eigen::Matrix2d& covariance) {
  return covariance.allFinite() && covariance(0, 1) == covariance(1, 0) && covariance(0, 0) > 0 &&
         covariance.determinant() > 0;
}

TEST(PointCovariance, OfARoundSpotIsRound) {
  const Eigen::Matrix2d covariance = of_keypoint(bump(150, 2, 2), field_of(BlockStatus::SHARP, 3));
  EXPECT_NEAR(covariance(1, 1), covariance(0, 0), 1e-9);
  EXPECT_NEAR(covariance(0, 1), 0, 1e-9);
}

TEST(PointCovariance, GrowsWithTheVarianceOfNoiseAndFallsWithThatOfContrast) {
  const cv::Mat image = bump(200, 2, 2), fainter = bump(100, 2, 2);
  EXPECT_NEAR(of_noise(image, 1, 2)(0, 0) / of_noise(image, 0.5, 1)(0, 0), 4, 0.1);
  EXPECT_NEAR(of_noise(fainter, 0.5, 1)(0, 0) / of_noise(image, 0.5, 1)(0, 0), 4, 0.1);
}

TEST(PointCovariance, IsInverseToTheGradientsSquares) {
  // Of a bump the sum of squares is pi contrast^2 b / (2 a) along a, and the other way round.
  const Eigen::Matrix2d covariance = of_noise(bump(200, 2.5, 2), 0.5, 1);
  // Differences of pixels two apart see somewhat less of the steeper side.
  EXPECT_NEAR(covariance(0, 0) / covariance(1, 1), 1.25 * 1.25, 0.12);
}

TEST(PointCovariance, IsLongAlongAnEdge) {
  const double noise = 2;
  const Eigen::Matrix2d covariance = of_keypoint(upright_edge(), field_of(BlockStatus::SHARP, noise));
  const Eigen::Matrix2d none =
      of_keypoint(cv::Mat(kSidePx, kSidePx, CV_8UC1, cv::Scalar(90)), field_of(BlockStatus::SHARP, noise));
  EXPECT_NEAR(covariance(0, 1), 0, 1e-9);
  EXPECT_LT(covariance(0, 0), 0.02 * covariance(1, 1));
  EXPECT_NEAR(covariance(1, 1), none(1, 1), 1e-6) << "along the edge there is no more to see than on a bare wall";
}

TEST(PointCovariance, IsFiniteWithoutTexture) {
  const cv::Mat bare(kSidePx, kSidePx, CV_8UC1, cv::Scalar(90));
  for (const double noise : {0.0, 0.5, 8.0}) {
    const Eigen::Matrix2d covariance = of_keypoint(bare, field_of(BlockStatus::SHARP, noise));
    EXPECT_TRUE(is_positive_definite(covariance));
    EXPECT_NEAR(covariance(0, 0), kBlobErrors.unseen_px * kBlobErrors.unseen_px, 0.01) << "it was found all the same";
  }
}

TEST(PointCovariance, FaintTextureSaysNoLessThanNone) {
  const FrameBlur field = field_of(BlockStatus::SHARP, 4);
  double before = kBlobErrors.unseen_px * kBlobErrors.unseen_px + 0.01;
  for (const double contrast : {10, 30, 60, 120}) {
    const double variance = of_keypoint(bump(contrast, 2, 2), field)(0, 0);
    EXPECT_LE(variance, before) << contrast;
    before = variance;
  }
  EXPECT_LT(before, 0.1 * kBlobErrors.unseen_px * kBlobErrors.unseen_px);
}

TEST(PointCovariance, NoiseIsNotTakenForTexture) {
  cv::Mat noisy(kSidePx, kSidePx, CV_8UC1);
  cv::RNG rng(1);
  rng.fill(noisy, cv::RNG::NORMAL, 90, 10);
  const FrameBlur field = field_of(BlockStatus::SHARP, 10);
  const double of_bare = of_keypoint(cv::Mat(kSidePx, kSidePx, CV_8UC1, cv::Scalar(90)), field)(0, 0);
  double sum = 0;
  int count = 0;
  for (int y = 20; y < 110; y += 15) {
    for (int x = 20; x < 110; x += 15, ++count) sum += of_keypoint(noisy, field, {x, y}).trace() / 2;
  }
  EXPECT_GT(sum / count, 0.1 * of_bare);
  FrameBlur unaware = field;
  unaware.noise = 1;
  EXPECT_LT(of_keypoint(noisy, unaware)(0, 0), 0.01 * of_bare);
}

TEST(PointCovariance, RotatesWithTheImage) {
  const double extent_px = 12;
  const Eigen::Matrix2d upright = of_keypoint(bump(200, 2.5, 1.5), field_of(BlockStatus::DEBLURRED, 3, extent_px, 0.6));
  for (const double rotation_rad : {0.3, 1.1, CV_PI / 2, 2.2}) {
    const double angle_rad = std::fmod(0.6 + rotation_rad, CV_PI);
    const Eigen::Matrix2d rotated =
        of_keypoint(bump(200, 2.5, 1.5, rotation_rad), field_of(BlockStatus::DEBLURRED, 3, extent_px, angle_rad));
    const Eigen::Matrix2d R = Eigen::Rotation2Dd(rotation_rad).toRotationMatrix();
    EXPECT_LT((rotated - R * upright * R.transpose()).norm(), 0.03 * upright.norm()) << rotation_rad;
  }
}

TEST(PointCovariance, BlurAddsAlongItsLine) {
  const cv::Mat image = bump(200, 2, 2);
  const double angle_rad = 0.4;
  const Eigen::Vector2d line(std::cos(angle_rad), std::sin(angle_rad)), across(-line.y(), line.x());
  const Eigen::Matrix2d sharp = of_keypoint(image, field_of(BlockStatus::SHARP, 1));
  double before = 0;
  for (const double extent_px : {5.0, 10.0, 20.0, 40.0}) {
    const auto added = [&](BlockStatus status) -> Eigen::Matrix2d {
      return of_keypoint(image, field_of(status, 1, extent_px, angle_rad)) - sharp;
    };
    const Eigen::Matrix2d restored = added(BlockStatus::DEBLURRED), left = added(BlockStatus::REJECTED);
    EXPECT_GT(line.dot(restored * line), before) << extent_px;
    EXPECT_GT(line.dot(left * line), 2 * line.dot(restored * line)) << extent_px;
    EXPECT_NEAR(line.dot(left * across), 0, 1e-6);
    for (const BlockStatus status :
         {BlockStatus::SHARP, BlockStatus::TOO_LARGE, BlockStatus::TOO_CURVED, BlockStatus::NOISY}) {
      EXPECT_TRUE(added(status).isApprox(left)) << to_string(status);
    }
    before = line.dot(restored * line);
  }
}

TEST(PointCovariance, NoiseOfADeblurredBlockIsWhatItsFilterMadeOfIt) {
  const cv::Mat image = bump(200, 2, 2);
  FrameBlur field = field_of(BlockStatus::DEBLURRED, 1);
  for (BlockBlur& block : field.blocks) block.noise_gain = 9;
  EXPECT_TRUE(of_keypoint(image, field).isApprox(of_keypoint(image, field_of(BlockStatus::DEBLURRED, 3))));
  for (BlockBlur& block : field.blocks) block.status = BlockStatus::REJECTED;
  EXPECT_TRUE(of_keypoint(image, field).isApprox(of_keypoint(image, field_of(BlockStatus::REJECTED, 1))))
      << "it was not filtered";
}

TEST(PointCovariance, UncertainMotionAddsInAllDirections) {
  const cv::Mat image = bump(200, 2, 2);
  FrameBlur field = field_of(BlockStatus::DEBLURRED, 1, 10);
  const Eigen::Matrix2d without = of_keypoint(image, field);
  for (BlockBlur& block : field.blocks) block.residual = ResidualVelocity{{100, 0}, 50};
  // 50 px/s for 20 ms.
  EXPECT_TRUE((of_keypoint(image, field) - without).isApprox(Eigen::Matrix2d::Identity()));
  EXPECT_TRUE(covariance_of_moving(field.blocks[0], -0.01).isApprox(0.25 * Eigen::Matrix2d::Identity()));
  EXPECT_TRUE(covariance_of_moving(BlockBlur{}, 0.01).isZero());
}

TEST(PointCovariance, IsPositiveDefiniteEverywhere) {
  cv::Mat image(kSidePx, kSidePx, CV_8UC1);
  cv::RNG rng(2);
  rng.fill(image, cv::RNG::UNIFORM, 0, 256);
  for (const BlockStatus status : kBlockStatuses) {
    if (status == BlockStatus::NO_GYRO || status == BlockStatus::MASKED) continue;
    for (const double extent_px : {0.0, 3.0, 300.0}) {
      const FrameBlur field = field_of(status, 2, extent_px, 1);
      const PointCovariance covariance(image, field);
      for (const double x : {-3.0, 0.0, 1.4, 64.0, 127.9, 128.0, 140.0}) {
        for (const double radius_px : {0.5, 2.0, 20.0, 100.0}) {
          EXPECT_TRUE(is_positive_definite(covariance.at({x, 128 - x}, radius_px, kCornerErrors)))
              << to_string(status) << ' ' << extent_px << ' ' << x << ' ' << radius_px;
        }
      }
    }
  }
}

TEST(PointCovariance, IsInfiniteWhereBlurOrNoiseIsNotKnown) {
  const cv::Mat image = bump(200, 2, 2);
  FrameBlur field = field_of(BlockStatus::NO_GYRO, 1);
  const auto expect_unknown = [&] {
    const Eigen::Matrix2d covariance = of_keypoint(image, field);
    EXPECT_TRUE(std::isinf(covariance(0, 0)) && std::isinf(covariance(1, 1)));
    EXPECT_EQ(covariance(0, 1), 0);
  };
  expect_unknown();
  field = field_of(BlockStatus::SHARP, 1);
  field.noise = std::nullopt;
  expect_unknown();
}

TEST(PointCovariance, WantsTheFieldsLuminance) {
  const FrameBlur field = field_of(BlockStatus::SHARP, 1);
  const cv::Mat other(kSidePx, kSidePx - 1, CV_8UC1), wide(kSidePx, kSidePx, CV_16UC1);
  EXPECT_THROW(PointCovariance(other, field), std::invalid_argument);
  EXPECT_THROW(PointCovariance(wide, field), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::point_covariance_test
