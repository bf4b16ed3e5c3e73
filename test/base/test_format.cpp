#include "base/format.hpp"

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

TEST(Format, Degrees) { EXPECT_DOUBLE_EQ(kDegPerRad * M_PI, 180); }

}  // namespace
}  // namespace gyro_deblur::format_test
