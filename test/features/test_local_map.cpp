// Maps to second order.
#include "features/local_map.hpp"

#include <gtest/gtest.h>
#include <Eigen/Core>

#include "features/blur_alignment.hpp"

namespace gyro_deblur {
namespace {

Eigen::Vector2d taken(const LocalMap& map, const Eigen::Vector2d& offset_px) {
  const double x = offset_px.x(), y = offset_px.y();
  return map.jacobian * offset_px + map.quadratic * Eigen::Vector3d(x * x, x * y, y * y);
}

class LocalMapTest : public testing::Test {
 protected:
  LocalMapTest() {
    first_.jacobian << 1.1, -0.2, 0.3, 0.9;
    first_.quadratic << 2e-3, -1e-3, 5e-4, 1e-3, 3e-3, -2e-3;
    second_.jacobian << 0.8, 0.4, -0.1, 1.2;
    second_.quadratic << -1e-3, 2e-3, 1e-3, 4e-3, -5e-4, 1.5e-3;
  }
  LocalMap first_, second_;
  const Eigen::Vector2d offset_px_{0.3, -0.2};  // what is of third order is small there
};

TEST_F(LocalMapTest, CombinedIsOneAfterTheOther) {
  const Eigen::Vector2d both_px = taken(combined(second_, first_), offset_px_);
  EXPECT_LT((both_px - taken(second_, taken(first_, offset_px_))).norm(), 1e-6);
  EXPECT_GT((both_px - taken(first_, taken(second_, offset_px_))).norm(), 1e-2) << "cannot tell the order";
}

TEST_F(LocalMapTest, QuadraticAfterALinearMap) {
  const LocalMap after(Eigen::Matrix2d::Zero(), quadratic_after(second_.quadratic, first_.jacobian)),
      quadratic(Eigen::Matrix2d::Zero(), second_.quadratic);
  EXPECT_LT((taken(after, offset_px_) - taken(quadratic, first_.jacobian * offset_px_)).norm(), 1e-15);
}

TEST_F(LocalMapTest, AtHalfTheSizeEverythingIsHalfAsLong) {
  const Eigen::Vector2d half_px = taken(at_half_size(first_), offset_px_ / 2);
  EXPECT_LT((half_px - taken(first_, offset_px_) / 2).norm(), 1e-15);
}

}  // namespace
}  // namespace gyro_deblur
