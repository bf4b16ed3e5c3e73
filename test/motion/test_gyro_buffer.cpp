#include "gyro_deblur/gyro_buffer.hpp"

#include <limits>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::gyro_buffer_test {
namespace {

GyroSample at(TimeNs t_ns, double x = 0) { return {t_ns, Eigen::Vector3d(x, 0, 0)}; }

std::vector<TimeNs> stamps(const std::vector<GyroSample>& samples) {
  std::vector<TimeNs> result;
  for (const GyroSample& sample : samples) result.push_back(sample.t_ns);
  return result;
}

using Stamps = std::vector<TimeNs>;

TEST(GyroBuffer, RefusesWhatIsNotFiniteOrNotNewer) {
  GyroBuffer buffer(1000);
  EXPECT_TRUE(buffer.add(at(100, 1)));
  EXPECT_FALSE(buffer.add(at(100, 2)));
  EXPECT_FALSE(buffer.add(at(99)));
  EXPECT_FALSE(buffer.add(at(200, std::numeric_limits<double>::quiet_NaN())));
  EXPECT_FALSE(buffer.add(at(200, std::numeric_limits<double>::infinity())));
  ASSERT_EQ(buffer.size(), 1u);
  EXPECT_EQ(buffer.window({100, 100}).front().rate_rad_s.x(), 1);
  EXPECT_TRUE(buffer.add(at(101)));
}

TEST(GyroBuffer, IsBoundedInTime) {
  GyroBuffer buffer(1000);
  for (TimeNs t = 0; t <= 100'000; t += 10) {
    buffer.add(at(t));
    ASSERT_LE(buffer.size(), 101u);
  }
  EXPECT_EQ(buffer.available().begin_ns, 99'000);
  EXPECT_EQ(buffer.available().end_ns, 100'000);
  // A long pause leaves the newest only.
  buffer.add(at(500'000));
  EXPECT_EQ(buffer.size(), 1u);
}

TEST(GyroBuffer, DropsTheNewestAndItsStamp) {
  GyroBuffer buffer(1000);
  for (const TimeNs t_ns : {100, 110, 150}) buffer.add(at(t_ns, static_cast<double>(t_ns)));
  EXPECT_EQ(buffer.drop_newest().rate_rad_s.x(), 150);
  EXPECT_TRUE(buffer.add(at(120)));
  EXPECT_EQ(stamps(buffer.window({100, 200})), (Stamps{100, 110, 120}));
}

TEST(GyroBuffer, ClearForgetsTheNewestStampToo) {
  GyroBuffer buffer(1000);
  buffer.add(at(100));
  buffer.clear();
  EXPECT_TRUE(buffer.empty());
  EXPECT_TRUE(buffer.available().empty());
  EXPECT_TRUE(buffer.add(at(5)));
}

TEST(GyroBuffer, WindowHasOneNeighbourOnEachSide) {
  GyroBuffer buffer(1000);
  for (TimeNs t = 100; t <= 600; t += 100) buffer.add(at(t));
  EXPECT_EQ(stamps(buffer.window({250, 350})), (Stamps{200, 300, 400}));
  EXPECT_EQ(stamps(buffer.window({310, 320})), (Stamps{300, 400}));
  EXPECT_EQ(stamps(buffer.window({300, 400})), (Stamps{200, 300, 400, 500}));
}

TEST(GyroBuffer, WindowNeverInventsWhatIsMissing) {
  GyroBuffer buffer(1000);
  EXPECT_TRUE(buffer.window({0, 100}).empty());
  for (TimeNs t = 100; t <= 300; t += 100) buffer.add(at(t));
  EXPECT_EQ(stamps(buffer.window({0, 150})), (Stamps{100, 200}));
  EXPECT_EQ(stamps(buffer.window({250, 900})), (Stamps{200, 300}));
  EXPECT_EQ(stamps(buffer.window({400, 900})), (Stamps{300}));
  EXPECT_EQ(stamps(buffer.window({0, 50})), (Stamps{100}));
  EXPECT_TRUE(buffer.window({200, 199}).empty());
}

TEST(GyroBuffer, NeedsACapacity) {
  EXPECT_THROW(GyroBuffer(0), std::invalid_argument);
  EXPECT_THROW(GyroBuffer(-1), std::invalid_argument);
}

}  // namespace
}  // namespace gyro_deblur::gyro_buffer_test
