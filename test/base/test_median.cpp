#include "base/median.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::median_test {
namespace {

TEST(Median, MiddleOfAnOddNumberInAnyOrder) {
  std::vector<double> values{-3, 0.5, 2, 7, 1e9};
  std::sort(values.begin(), values.end());
  do {
    EXPECT_EQ(median(values), 2);
  } while (std::next_permutation(values.begin(), values.end()));
}

TEST(Median, UpperOfTheTwoInTheMiddleNeverTheirMean) {
  EXPECT_EQ(median(std::vector<double>{1, 2}), 2);
  EXPECT_EQ(median(std::vector<double>{2, 1}), 2);
  EXPECT_EQ(median(std::vector<double>{40, 10, 30, 20}), 30);
}

TEST(Median, OneValueAndNone) {
  EXPECT_EQ(median(std::vector<double>{-4.25}), -4.25);
  EXPECT_EQ(median(std::vector<double>{}), 0);
  EXPECT_EQ(median(std::vector<std::int64_t>{}), 0);
}

TEST(Median, EqualValuesCountEach) {
  EXPECT_EQ(median(std::vector<double>{1, 1, 1, 5, 9}), 1);
  EXPECT_EQ(median(std::vector<double>{1, 5, 5, 5, 9}), 5);
}

TEST(Median, KeepsEveryBitOfItsType) {
  // A double in between would lose the last digits of nanoseconds since 1970, and a float gives a float.
  EXPECT_EQ(median(std::vector<std::int64_t>{1'700'000'000'123'456'789, 1, 1'800'000'000'000'000'000}),
            1'700'000'000'123'456'789);
  EXPECT_EQ(median(std::vector<float>{0.1f, 0.1f}), 0.1f);
}

TEST(Median, AgreesWithSortingAndDoesNotChangeItsArgument) {
  std::mt19937 random(5);
  for (std::size_t size = 1; size <= 200; ++size) {
    std::vector<int> values(size);
    for (int& value : values) value = static_cast<int>(random() % 50);
    const std::vector<int> before = values;
    const int result = median(values);
    EXPECT_EQ(values, before);
    std::sort(values.begin(), values.end());
    EXPECT_EQ(result, values[size / 2]) << size;
  }
}

}  // namespace
}  // namespace gyro_deblur::median_test
