#include "features/remembered_motion.hpp"

#include <gtest/gtest.h>
#include <Eigen/Geometry>

namespace gyro_deblur::remembered_motion_test {
namespace {

/// Rotates at a constant rate, and counts how often it is asked.
class CountingMotion : public CameraMotion {
 public:
  bool covers(const TimeRange& range) const override { return range.begin_ns >= 0; }
  Eigen::Matrix3d rotation(TimeNs from_ns, TimeNs to_ns) const override {
    ++asked;
    return Eigen::AngleAxisd(to_seconds(to_ns - from_ns), Eigen::Vector3d::UnitY()).toRotationMatrix();
  }
  mutable int asked = 0;
};

TEST(RememberedMotion, IsTheMotionAskedOnceForEachPair) {
  const CountingMotion motion;
  const RememberedMotion remembered(motion);
  for (int repeat = 0; repeat < 3; ++repeat) {
    for (int k = 0; k < 7; ++k)
      EXPECT_EQ(remembered.rotation(5'000'000, k * 1'000'000), motion.rotation(5'000'000, k * 1'000'000));
  }
  // 21 times by the test itself; pairs that share an entry are asked for again.
  EXPECT_LT(motion.asked, 21 + 14);
  EXPECT_TRUE(remembered.covers({0, 1}));
  EXPECT_FALSE(remembered.covers({-1, 1}));
}

TEST(RememberedMotion, NeverTakesOnePairForAnother) {
  const CountingMotion motion;
  const RememberedMotion remembered(motion);
  for (TimeNs from_ns = 0; from_ns < 40; ++from_ns) {  // far more than there are entries
    for (TimeNs to_ns = 0; to_ns < 40; ++to_ns) {
      EXPECT_EQ(remembered.rotation(from_ns * 1'000'000, to_ns * 1'000'000),
                motion.rotation(from_ns * 1'000'000, to_ns * 1'000'000));
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::remembered_motion_test
