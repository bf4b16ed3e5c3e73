// The loop that validation spends its time in, for every instruction set that this processor runs.
#include "blur/gradient_simd.hpp"

#include <algorithm>
#include <cstdlib>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::gradient_simd_test {
namespace {

/// Pixel by pixel, with the Sobel pair as in textbooks.
int expected_gradient(const std::vector<std::uint8_t>& padded, int width, int height, int dx, int dy) {
  int strongest = 0;
  for (int y = 1; y <= height; ++y) {
    for (int x = 1; x <= width; ++x) {
      const auto at = [&](int i, int j) { return padded[(y + j) * (width + 2) + x + i]; };
      const int gx = at(1, -1) + 2 * at(1, 0) + at(1, 1) - at(-1, -1) - 2 * at(-1, 0) - at(-1, 1);
      const int gy = at(-1, 1) + 2 * at(0, 1) + at(1, 1) - at(-1, -1) - 2 * at(0, -1) - at(1, -1);
      strongest = std::max(strongest, std::abs(dx * gx + dy * gy));
    }
  }
  return strongest;
}

class GradientSimdTest : public testing::TestWithParam<const char*> {};

TEST_P(GradientSimdTest, FindTheStrongest) {
  const GradientSimd* loops = find_for_cpu<GradientSimd>(GetParam());
  if (loops == nullptr) GTEST_SKIP() << "this processor does not run " << GetParam();
  EXPECT_STREQ(loops->name, GetParam());
  constexpr int kOne = 1 << 20;
  std::mt19937 random(3);
  std::uniform_int_distribution<int> grey(0, 255), white(0, 9);
  for (int width = 1; width <= 67; ++width) {
    for (const int height : {1, 2, 33}) {
      // Of exactly this size, so that AddressSanitizer sees what is read beyond it.
      std::vector<std::uint8_t> padded((width + 2) * (height + 2));
      for (const bool few_lights : {false, true}) {  // with few, the strongest may be anywhere in a row
        for (std::uint8_t& p : padded) {
          p = static_cast<std::uint8_t>(few_lights ? (white(random) == 0 ? 255 : 0) : grey(random));
        }
        for (const auto& [dx, dy] : {std::pair(kOne, 0), std::pair(0, -kOne), std::pair(741455, 741455),
                                     std::pair(-741455, 741455), std::pair(313, -1048575), std::pair(0, 0)}) {
          ASSERT_EQ(loops->strongest_gradient(padded.data(), width + 2, width, height, dx, dy),
                    expected_gradient(padded, width, height, dx, dy))
              << width << 'x' << height << ", " << dx << ", " << dy;
        }
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(InstructionSets, GradientSimdTest, testing::Values("baseline", "avx2", "avx512"));

TEST(GradientSimd, OfTheWidestSetAreTheBest) {
  const char* widest = "baseline";
  for (const char* name : {"avx2", "avx512"}) widest = find_for_cpu<GradientSimd>(name) != nullptr ? name : widest;
  EXPECT_STREQ(select_for_cpu<GradientSimd>().name, widest);
}

}  // namespace
}  // namespace gyro_deblur::gradient_simd_test
