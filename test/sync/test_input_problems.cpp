#include "sync/input_problems.hpp"

#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gyro_deblur::input_problems_test {
namespace {

class InputProblemsTest : public testing::Test {
 protected:
  TimeNs now_ns_ = 1'000'000'000;
  std::vector<std::string> lines_;
  InputProblems problems_{[this](LogLevel, const std::string& text) { lines_.push_back(text); },
                          [this] { return now_ns_; }};
};

TEST_F(InputProblemsTest, LogAndListSayTheSame) {
  problems_.report("unit", "exposure is 3e-4 s, must be > 0.001 s");
  ASSERT_EQ(lines_.size(), 1u);
  const InputProblem problem = problems_.all().at("unit");
  EXPECT_EQ(problem.text, lines_.front());
  EXPECT_TRUE(problem.active);
  EXPECT_EQ(problem.count, 1u);
}

TEST_F(InputProblemsTest, RepeatedReportsAreCountedAndThrottled) {
  for (int i = 0; i < 10; ++i) problems_.report("unit", "text " + std::to_string(i));
  EXPECT_EQ(lines_.size(), 1u);
  EXPECT_EQ(problems_.all().at("unit").count, 10u);
  EXPECT_EQ(problems_.all().at("unit").text, "text 9");
}

TEST_F(InputProblemsTest, ResolvedProblemsAreKeptAndBecomeActiveAgain) {
  problems_.resolve("never reported");
  EXPECT_TRUE(problems_.all().empty());
  problems_.report("unit", "text");
  problems_.report("size", "text", LogLevel::ERROR);
  problems_.resolve("unit");
  EXPECT_FALSE(problems_.all().at("unit").active);
  EXPECT_TRUE(problems_.all().at("size").active);
  EXPECT_EQ(problems_.all().at("size").level, LogLevel::ERROR);
  problems_.report("unit", "text");
  EXPECT_TRUE(problems_.all().at("unit").active);
  EXPECT_EQ(problems_.all().at("unit").count, 2u);
}

TEST_F(InputProblemsTest, WhatLastsIsReportedWhenItBegins) {
  problems_.update("tf", "");
  EXPECT_TRUE(problems_.all().empty());
  problems_.update("tf", "no transform");
  problems_.update("tf", "still no transform");
  EXPECT_EQ(problems_.all().at("tf").text, "still no transform");
  EXPECT_EQ(problems_.all().at("tf").count, 1u);
  EXPECT_TRUE(problems_.is_active("tf"));
  problems_.update("tf", "");
  EXPECT_FALSE(problems_.is_active("tf"));
  EXPECT_FALSE(problems_.all().at("tf").active);
  problems_.update("tf", "gone again");
  EXPECT_EQ(problems_.all().at("tf").count, 2u);
  EXPECT_EQ(lines_, (std::vector<std::string>{"no transform"})) << "within 5 s";
}

TEST_F(InputProblemsTest, TheNextLineAfterTheThrottleCountsThoseLeftOut) {
  for (int i = 0; i < 4; ++i) problems_.report("unit", "text");
  now_ns_ += 6'000'000'000;
  problems_.report("unit", "text");
  EXPECT_EQ(lines_, (std::vector<std::string>{"text", "text (and 3 more of the kind)"}));
  problems_.clear();
  problems_.report("unit", "text");
  EXPECT_EQ(lines_.size(), 3u);
}

}  // namespace
}  // namespace gyro_deblur::input_problems_test
