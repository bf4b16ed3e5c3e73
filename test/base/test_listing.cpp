#include "base/listing.hpp"

#include <gtest/gtest.h>

namespace gyro_deblur {
namespace {

TEST(Listing, PutsAWordBeforeTheLast) {
  EXPECT_EQ(listing({}, "and"), "");
  EXPECT_EQ(listing({"8"}, "or"), "8");
  EXPECT_EQ(listing({"0", "4"}, "or"), "0 or 4");
  EXPECT_EQ(listing({"radtan", "equidistant", "none"}, "and"), "radtan, equidistant and none");
}

}  // namespace
}  // namespace gyro_deblur
