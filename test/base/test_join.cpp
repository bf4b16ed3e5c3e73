#include "base/join.hpp"

#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::join_test {
namespace {

using Words = std::vector<std::string>;

TEST(Join, SeparatesByCommas) {
  EXPECT_EQ(join(Words{}), "");
  EXPECT_EQ(join(Words{"8"}), "8");
  EXPECT_EQ(join(std::set<std::string>{"b", "c", "a"}), "a, b, c");
}

TEST(Join, PutsAConjunctionBeforeTheLast) {
  EXPECT_EQ(join(Words{}, "and"), "");
  EXPECT_EQ(join(Words{"8"}, "or"), "8");
  EXPECT_EQ(join(Words{"0", "4"}, "or"), "0 or 4");
  EXPECT_EQ(join(Words{"radtan", "equidistant", "none"}, "and"), "radtan, equidistant and none");
}

}  // namespace
}  // namespace gyro_deblur::join_test
