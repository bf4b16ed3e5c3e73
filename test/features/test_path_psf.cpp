#include "features/path_psf.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <set>
#include <vector>

#include <gtest/gtest.h>

#include "blurred_texture.hpp"
#include "features/blur_alignment.hpp"

namespace gyro_deblur::path_psf_test {
namespace {

/// Straight, relative to its middle.
Path2d straight_path(double extent_px, double angle_rad) { return test::arc_path(extent_px, 0, angle_rad); }

/// Out and most of the way back.
Path2d reversing_path() {
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    path_px[k] = {9 * std::sin(0.3f * static_cast<float>(k)), 4 * std::sin(0.3f * static_cast<float>(k))};
  }
  return path_px;
}

/// Of all pixels of the reach.
Eigen::ArrayXXf shares_of(const PathPsf& psf) {
  Eigen::ArrayXXf shares = Eigen::ArrayXXf::Zero(psf.reach.height(), psf.reach.width());
  for (const PathPair& pair : psf.pairs) {
    shares(pair.y, pair.x) += pair.first;
    shares(pair.y + psf.axis, pair.x + 1 - psf.axis) += pair.second;
  }
  return shares;
}

Eigen::Vector2f mean_of(const Path2d& path_px) {
  Eigen::Vector2f sum_px = Eigen::Vector2f::Zero();
  for (std::size_t k = 0; k + 1 < path_px.size(); ++k) sum_px += 0.5f * (path_px[k] + path_px[k + 1]);
  return sum_px / (kPathInstants - 1);
}

TEST(PathPsf, HasTheMirroredMeanOfThePath) {
  const std::vector<Path2d> paths{still_path(),          straight_path(15, 0.3),       straight_path(40, 1.3),
                                  straight_path(0.4, 2), straight_path(60, 0.7854),    test::arc_path(60, 15, 0.2),
                                  reversing_path(),      test::arc_path(30, -12, 2.5), straight_path(25, CV_PI / 2)};
  for (const Path2d& path_px : paths) {
    PathPsf psf;
    rasterize(path_px, &psf);
    for (const PathPair& pair : psf.pairs) {
      ASSERT_TRUE(pair.x >= 0 && pair.x + 1 - psf.axis < psf.reach.width());
      ASSERT_TRUE(pair.y >= 0 && pair.y + psf.axis < psf.reach.height());
      EXPECT_TRUE(pair.first >= 0 && pair.second >= 0);
    }
    const Eigen::ArrayXXf shares = shares_of(psf);
    EXPECT_NEAR(shares.sum(), 1, 1e-5);
    EXPECT_FLOAT_EQ(psf.energy, shares.square().sum());
    Eigen::Vector2f mean_px = Eigen::Vector2f::Zero();
    for (int y = 0; y < psf.reach.height(); ++y) {
      for (int x = 0; x < psf.reach.width(); ++x) {
        mean_px += shares(y, x) * Eigen::Vector2i(psf.reach.first_x + x, psf.reach.first_y + y).cast<float>();
      }
    }
    EXPECT_LT((mean_px + mean_of(path_px)).norm(), 1e-4) << mean_px.transpose();
  }
}

TEST(PathPsf, AStraightPathHasTwoPixelsALine) {
  PathPsf psf;
  for (const double angle_rad : {0.1, 0.6, 1.2, 2.0, 3.0}) {
    rasterize(straight_path(30, angle_rad), &psf);
    const bool is_wide = std::abs(std::cos(angle_rad)) > std::abs(std::sin(angle_rad));
    EXPECT_EQ(psf.axis, is_wide ? 1 : 0) << angle_rad;
    std::set<int> lines;
    for (const PathPair& pair : psf.pairs) EXPECT_TRUE(lines.insert(is_wide ? pair.x : pair.y).second) << angle_rad;
  }
}

TEST(PathPsf, ALineHasTheShareOfTheTimeNearIt) {
  // 8 px at uniform speed: an inner row gets the time of a pixel, the first and the last half of it. The mean place of
  // these two is a third of a row inside.
  Path2d path_px;
  for (int k = 0; k < kPathInstants; ++k) path_px[k] = {0.5f * static_cast<float>(k), static_cast<float>(k)};
  PathPsf psf;
  rasterize(path_px, &psf);
  ASSERT_EQ(psf.axis, 0);
  ASSERT_EQ(psf.pairs.size(), 9u);
  for (std::size_t i = 0; i < psf.pairs.size(); ++i) {
    const PathPair& pair = psf.pairs[i];
    const float away_px = -static_cast<float>(psf.reach.first_y + pair.y);
    const bool is_end = away_px == 0 || away_px == 8;
    const float share = pair.first + pair.second, inwards_px = is_end ? (away_px == 0 ? 1.0f : -1.0f) / 3 : 0;
    EXPECT_NEAR(share, is_end ? 1.0f / 16 : 1.0f / 8, 1e-6f) << away_px;
    EXPECT_NEAR(static_cast<float>(psf.reach.first_x + pair.x) + pair.second / share, -0.5f * (away_px + inwards_px),
                1e-5f)
        << away_px;
  }
}

/// Correlation of noise, both ways together, that a PSF makes at a lag along y, over all columns.
double correlation_of(const PathPsf& psf, int lag) {
  const Eigen::VectorXf lines = shares_of(psf).matrix().rowwise().sum();
  double sum = 0;
  for (int y = 0; y + lag < lines.size(); ++y) sum += lines[y] * lines[y + lag];
  return lag == 0 ? sum : 2 * sum;
}

TEST(NoiseLags, AreTheCorrelationsOfThePsf) {
  const Path2d path_px = straight_path(24, 1.3);
  PathPsf psf;
  rasterize(path_px, &psf);
  std::vector<NoiseLag> lags;
  for (const int spacing : {1, 2, 3}) {
    find_noise_lags(path_px, {1, spacing}, &lags);
    ASSERT_GT(lags.size(), 3u);
    double sum = 0;
    for (const NoiseLag& lag : lags) {
      EXPECT_NEAR(lag.correlation, correlation_of(psf, spacing * lag.y), 0.15 * correlation_of(psf, 0)) << lag.y;
      EXPECT_NEAR(std::abs(lag.x), spacing * lag.y / std::tan(1.3), 0.8);
      sum += lag.correlation;
    }
    EXPECT_NEAR(sum, 1.0 / spacing, 0.05);
  }
}

TEST(NoiseLags, CountASpacingAcrossThePath) {
  std::vector<NoiseLag> lags;
  find_noise_lags(straight_path(25, CV_PI / 2), {3, 1}, &lags);
  double sum = 0;
  for (const NoiseLag& lag : lags) {
    EXPECT_EQ(lag.x, 0);
    EXPECT_NEAR(lag.correlation, (lag.y == 0 ? 1 : 2) * (1 - lag.y / 25.0) / 25, 0.01) << lag.y;
    sum += lag.correlation;
  }
  EXPECT_NEAR(sum, 1, 0.05);

  // Of the columns that an oblique path crosses, every third is there.
  const Path2d oblique_px = straight_path(25, 1.2);
  PathPsf psf;
  rasterize(oblique_px, &psf);
  find_noise_lags(oblique_px, {3, 1}, &lags);
  EXPECT_NEAR(lags.front().correlation, correlation_of(psf, 0), 0.1 * correlation_of(psf, 0));
  sum = 0;
  for (const NoiseLag& lag : lags) sum += lag.correlation;
  EXPECT_NEAR(sum, 1.0 / 3, 0.1);
}

TEST(NoiseLags, FollowThePathIntoEachQuadrant) {
  std::vector<NoiseLag> lags;
  for (const double angle_rad : {0.4, 1.2, 1.9, 2.7}) {
    for (const std::array<int, 2> spacing : {std::array<int, 2>{1, 1}, {2, 1}, {1, 2}}) {
      find_noise_lags(straight_path(20, angle_rad), spacing, &lags);
      for (const NoiseLag& lag : lags) {
        ASSERT_GE(lag.y, 0);
        // Both are lags of one pair of pixels: away, and as far the other way.
        const double across_px = spacing[0] * lag.x * std::sin(angle_rad) - spacing[1] * lag.y * std::cos(angle_rad);
        EXPECT_LT(std::abs(across_px), 1) << angle_rad << ": " << lag.x << ", " << lag.y;
      }
    }
  }
}

TEST(NoiseLags, AStillPointCorrelatesNothing) {
  std::vector<NoiseLag> lags;
  find_noise_lags(still_path(), {1, 1}, &lags);
  ASSERT_EQ(lags.size(), 1u);
  EXPECT_EQ(lags[0].x, 0);
  EXPECT_EQ(lags[0].y, 0);
  EXPECT_EQ(lags[0].correlation, 1);
}

}  // namespace
}  // namespace gyro_deblur::path_psf_test
