#include "gyro_deblur/gyro_buffer.hpp"

#include <limits>
#include <random>
#include <stdexcept>

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

TEST(StationaryBias, IsTheMean) {
  std::mt19937 rng(1);
  std::normal_distribution<double> noise(0, 0.01);
  const Eigen::Vector3d bias(-0.002, 0.021, 0.078);
  std::vector<GyroSample> samples;
  for (int i = 0; i < 4000; ++i) samples.push_back({i, bias + Eigen::Vector3d(noise(rng), noise(rng), noise(rng))});
  std::string error;
  const auto estimate = estimate_stationary_bias(samples, 0.05, 100, &error);
  ASSERT_TRUE(estimate) << error;
  EXPECT_EQ(estimate->samples, samples.size());
  // Four standard deviations of the mean.
  EXPECT_LT((estimate->bias_rad_s - bias).cwiseAbs().maxCoeff(), 4 * 0.01 / std::sqrt(4000.0));
  for (int axis = 0; axis < 3; ++axis) EXPECT_NEAR(estimate->stddev_rad_s[axis], 0.01, 0.001);
}

TEST(StationaryBias, RefusesMotionAndNamesItsAxis) {
  std::vector<GyroSample> samples;
  for (int i = 0; i < 200; ++i) samples.push_back({i, Eigen::Vector3d(0, i % 2 == 0 ? 0.2 : -0.2, 0)});
  std::string error;
  EXPECT_FALSE(estimate_stationary_bias(samples, 0.05, 100, &error));
  EXPECT_NE(error.find("axis y"), std::string::npos) << error;
  EXPECT_NE(error.find("0.05"), std::string::npos) << error;
  EXPECT_TRUE(estimate_stationary_bias(samples, 0.25, 100, &error));
}

TEST(StationaryBias, RefusesTooFewOrBrokenSamples) {
  std::string error;
  EXPECT_FALSE(estimate_stationary_bias({at(0), at(1)}, 0.05, 3, &error));
  EXPECT_NE(error.find("2 samples"), std::string::npos) << error;
  EXPECT_NE(error.find("3"), std::string::npos) << error;
  EXPECT_FALSE(estimate_stationary_bias({at(0)}, 0.05, 1, &error));
  EXPECT_FALSE(
      estimate_stationary_bias({at(0), at(1), at(2, std::numeric_limits<double>::quiet_NaN())}, 0.05, 2, &error));
}

}  // namespace
}  // namespace gyro_deblur::gyro_buffer_test
