#include "inverse/line_taps.hpp"

#include <cmath>
#include <initializer_list>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "inverse/filter_bank.hpp"

namespace gyro_deblur::line_taps_test {
namespace {

double radians(double degrees) { return degrees * CV_PI / 180; }

TEST(RotateKernel, KeepsTheSumAtEveryAngle) {
  const LineKernel kernel = wiener_kernel(17.3, {});
  for (int degrees = -180; degrees <= 360; ++degrees) {
    double sum = 0;
    for (const KernelTap& tap : rotate_kernel(kernel, radians(degrees))) sum += tap.weight;
    EXPECT_NEAR(sum, 1.0, 1e-5) << degrees;
  }
}

TEST(RotateKernel, IsTheKernelItselfAlongTheAxes) {
  const LineKernel kernel = wiener_kernel(9.0, {});
  for (const int degrees : {0, 90, 180}) {
    const std::vector<KernelTap> taps = rotate_kernel(kernel, radians(degrees));
    ASSERT_EQ(taps.size(), kernel.taps.size());
    for (const KernelTap& tap : taps) {
      EXPECT_EQ(degrees == 90 ? tap.dx : tap.dy, 0);
      EXPECT_NEAR(tap.weight, kernel.taps[(degrees == 90 ? tap.dy : tap.dx) + kernel.radius()], 1e-6);
    }
  }
}

TEST(RotateKernel, LiesAlongTheLine) {
  // First and second moments of a positive kernel: centred, and spread along the angle only.
  LineKernel box;
  box.taps.assign(41, 1.0f / 41);
  for (double degrees = 0; degrees < 180; degrees += 7.5) {
    const double dx = std::cos(radians(degrees)), dy = std::sin(radians(degrees));
    double along = 0, across = 0, along2 = 0, across2 = 0;
    for (const KernelTap& tap : rotate_kernel(box, radians(degrees))) {
      const double a = tap.dx * dx + tap.dy * dy, b = tap.dy * dx - tap.dx * dy;
      along += tap.weight * a;
      across += tap.weight * b;
      along2 += tap.weight * a * a;
      across2 += tap.weight * b * b;
    }
    EXPECT_NEAR(along, 0, 1e-4) << degrees;
    EXPECT_NEAR(across, 0, 1e-4) << degrees;
    EXPECT_NEAR(along2, (41.0 * 41 - 1) / 12, 0.6) << degrees;  // splatting adds at most 1/4 along and across
    EXPECT_LE(across2, 0.3) << degrees;
  }
}

TEST(RotateKernel, KeepsTheDirectionOfAnAsymmetricKernel) {
  LineKernel kernel;
  kernel.taps = {0, 0, 0, 0, 0, 0, 0, 0, 1};  // at +4 along the line
  const std::vector<KernelTap> down = rotate_kernel(kernel, radians(90));
  ASSERT_EQ(down.size(), 1u);
  EXPECT_EQ(down[0].dx, 0);
  EXPECT_EQ(down[0].dy, 4);
  const std::vector<KernelTap> left = rotate_kernel(kernel, radians(180));
  ASSERT_EQ(left.size(), 1u);
  EXPECT_EQ(left[0].dx, -4);
}

TEST(DirectionOf, FollowsTheMajorAxis) {
  for (double degrees = -180; degrees <= 360; degrees += 7.5) {
    const double dx = std::cos(radians(degrees)), dy = std::sin(radians(degrees));
    const LineDirection line = direction_of(radians(degrees));
    EXPECT_GE(std::abs(line.major), std::sqrt(0.5) - 1e-12) << degrees;
    EXPECT_LE(std::abs(line.slope), 1 + 1e-12) << degrees;
    // (slope, 1) or (1, slope) times major is the line again.
    EXPECT_NEAR(line.major * (line.major_is_y ? line.slope : 1), dx, 1e-12) << degrees;
    EXPECT_NEAR(line.major * (line.major_is_y ? 1 : line.slope), dy, 1e-12) << degrees;
  }
}

TEST(LineSteps, LieOnTheLineAndHaveTheWeightsOfTheAxis) {
  LineKernel lopsided, sparse, zero;
  for (int i = 0; i < 41; ++i) lopsided.taps.push_back(static_cast<float>(i + 1) / 861);
  sparse.taps.assign(41, 0.0f);
  sparse.taps[3] = sparse.taps[30] = 0.5f;
  zero.taps.assign(5, 0.0f);
  const LineKernel wiener = wiener_kernel(17.3, {});
  LineSteps line;  // used again and again
  std::vector<float> on_axis;
  for (const LineKernel* kernel : std::initializer_list<const LineKernel*>{&lopsided, &wiener, &sparse, &zero}) {
    for (int degrees = -90; degrees <= 180; degrees += 15) {
      const LineDirection direction = direction_of(radians(degrees));
      make_line_steps(*kernel, direction, line);
      kernel_on_major_axis(*kernel, direction.major, on_axis);
      EXPECT_EQ(line.major_is_y, direction.major_is_y) << degrees;
      if (kernel == &zero) {
        EXPECT_TRUE(line.steps.empty());
        continue;
      }
      const auto weight = [](const StepTaps& step) { return step.lower + step.upper; };
      EXPECT_NE(weight(line.steps.front()), 0) << degrees;
      EXPECT_NE(weight(line.steps.back()), 0) << degrees;
      const int middle = static_cast<int>(on_axis.size() / 2), steps = static_cast<int>(line.steps.size());
      for (int m = -middle; m <= middle; ++m) {
        const int i = m - line.first_m;
        const StepTaps step = i >= 0 && i < steps ? line.steps[i] : StepTaps{};
        EXPECT_NEAR(weight(step), on_axis[m + middle], 1e-7) << degrees << " deg, step " << m;
        if (weight(step) == 0) continue;
        EXPECT_NEAR(step.across + step.upper / weight(step), m * direction.slope, 2e-6) << degrees << " deg, " << m;
      }
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::line_taps_test
