#include "features/scene_change.hpp"

#include <complex>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::scene_change_test {
namespace {

using Complex = std::complex<double>;

Eigen::Vector2d to_vector(const Complex& c) { return {c.real(), c.imag()}; }

/// Blocks at depths of 1 to 5 m, seen by a camera that moves to the right and is pushed up and forward.
struct Scene {
  /// @param speed_px_s  of what is 1 m away
  explicit Scene(double noise_px_s, double speed_px_s = 200) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> inverse_depth(0.2, 1);
    std::normal_distribution<double> normal;
    const auto noisy = [&](const Eigen::Vector2d& v) {
      const double y = v.y() + noise_px_s * normal(random), x = v.x() + noise_px_s * normal(random);
      return Eigen::Vector2d(x, y);
    };
    for (int y = 32; y < 480; y += 64) {
      for (int x = 32; x < 752; x += 64) {
        const double nearness = inverse_depth(random);
        BlockChange block;
        block.center_px = Eigen::Vector2d(x, y);
        block.stddev_px_s = std::max(noise_px_s, 1e-3);
        const Complex between = nearness * speed_px_s * Complex(-1, 0.05);
        const Complex change = Complex(0.2, 0.3) * between + Complex(3, -2) + 0.02 * Complex(x - 352.0, y - 224.0);
        true_changes_px_s.push_back(to_vector(change));
        const Eigen::Vector2d before_px_s = noisy(to_vector(between - 0.5 * change));
        block.velocity_px_s = noisy(to_vector(between + 0.5 * change));
        block.change_px_s = block.velocity_px_s - before_px_s;
        blocks.push_back(block);
      }
    }
  }
  std::vector<BlockChange> blocks;
  std::vector<Eigen::Vector2d> true_changes_px_s;
};

double mean_error(const std::vector<Eigen::Vector2d>& changes_px_s, const Scene& scene) {
  double sum = 0;
  for (std::size_t i = 0; i < changes_px_s.size(); ++i) sum += (changes_px_s[i] - scene.true_changes_px_s[i]).norm();
  return sum / static_cast<double>(changes_px_s.size());
}

TEST(CommonChanges, AreThoseOfAllDepths) {
  const Scene scene(0);
  EXPECT_LT(mean_error(common_changes(scene.blocks), scene), 0.05);
}

TEST(CommonChanges, HaveAFractionOfTheNoise) {
  for (const double speed_px_s : {0, 20, 50, 200}) {
    const Scene scene(10, speed_px_s);
    std::vector<Eigen::Vector2d> own_px_s;
    for (const BlockChange& block : scene.blocks) own_px_s.push_back(block.change_px_s);
    // 6 numbers out of 168: a fifth would be left by least squares, without regard to outliers.
    EXPECT_LT(mean_error(common_changes(scene.blocks), scene), 0.3 * mean_error(own_px_s, scene)) << speed_px_s;
  }
}

TEST(CommonChanges, AnObjectKeepsItsOwn) {
  Scene scene(2);
  const Eigen::Vector2d own_px_s(150, 90);
  for (const int i : {40, 41, 51, 52}) scene.blocks[i].change_px_s = own_px_s;
  const std::vector<Eigen::Vector2d> changes = common_changes(scene.blocks);
  for (const int i : {40, 41, 51, 52}) {
    EXPECT_EQ(changes[i], own_px_s);
    scene.true_changes_px_s[i] = own_px_s;
  }
  EXPECT_LT(mean_error(changes, scene), 1);
}

TEST(CommonChanges, OfFewBlocksAreTheirOwn) {
  Scene scene(10);
  scene.blocks.resize(kLeastBlocksOfScene - 1);
  const std::vector<Eigen::Vector2d> changes = common_changes(scene.blocks);
  for (std::size_t i = 0; i < changes.size(); ++i) EXPECT_EQ(changes[i], scene.blocks[i].change_px_s);
  EXPECT_TRUE(common_changes({}).empty());
}

TEST(CommonChanges, OfOneVelocityAreFinite) {
  Scene scene(2);
  for (BlockChange& block : scene.blocks) block.velocity_px_s = {50, 0};
  for (const Eigen::Vector2d& change : common_changes(scene.blocks)) EXPECT_TRUE(change.allFinite());
}

}  // namespace
}  // namespace gyro_deblur::scene_change_test
