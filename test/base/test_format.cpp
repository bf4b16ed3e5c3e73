#include "base/format.hpp"

#include <limits>
#include <string>

#include <gtest/gtest.h>

namespace gyro_deblur::format_test {
namespace {

TEST(Format, WritesAsPrintfDoes) {
  EXPECT_EQ(format("%zu of %d images, %.2f px, 5 %%", std::size_t{3}, -7, 0.125), "3 of -7 images, 0.12 px, 5 %");
  EXPECT_EQ(format("%s", ""), "");
}

TEST(Format, CutsNoTextOff) {
  const std::string word(5000, 'a');
  EXPECT_EQ(format("%s of %s", word.c_str(), word.c_str()), word + " of " + word);
}

TEST(Format, TimesKeepAllDigits) {
  EXPECT_EQ(seconds_text(1'700'000'000'123'456'789), "1700000000.123456789");
  EXPECT_EQ(seconds_text(0), "0.000000000");
  EXPECT_EQ(seconds_text(-1), "-0.000000001");
  EXPECT_EQ(seconds_text(std::numeric_limits<TimeNs>::min()), "-9223372036.854775808");
}

TEST(Format, VectorsAndSizes) {
  EXPECT_EQ(vector_text({0.1, -2, 1e-7}), "[0.100000, -2.000000, 0.000000]");
  EXPECT_EQ(size_text(640, 480), "640x480");
  EXPECT_EQ(size_text(0.5, 1920), "0.5x1920");
}

TEST(Format, Degrees) { EXPECT_DOUBLE_EQ(kDegPerRad * M_PI, 180); }

}  // namespace
}  // namespace gyro_deblur::format_test
