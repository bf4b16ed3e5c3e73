// Every tool distinguishes bad usage, bad input and help in the same way.
#include <algorithm>
#include <filesystem>
#include <ostream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "run_program.hpp"

namespace gyro_deblur {
namespace {

struct Tool {
  const char* path;
  std::vector<std::string> bad_input;  // arguments that can be parsed, but name what is not there
  friend void PrintTo(const Tool& tool, std::ostream* stream) { *stream << tool.path; }
};

class Usage : public testing::TestWithParam<Tool> {
 protected:
  static test::ProgramResult run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), GetParam().path);
    return test::run_program(arguments);
  }
};

TEST_P(Usage, HelpEndsWell) {
  const test::ProgramResult result = run({"--help"});
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_NE(result.output.find("Usage:"), std::string::npos);
}

TEST_P(Usage, BadUsageEndsWithTwo) {
  EXPECT_EQ(run({}).exit_code, 2);
  std::vector<std::string> arguments = GetParam().bad_input;
  arguments.push_back("--nonsense");
  EXPECT_EQ(run(arguments).exit_code, 2);
}

TEST_P(Usage, BadInputEndsWithOneAndOneLine) {
  const test::ProgramResult result = run(GetParam().bad_input);
  EXPECT_EQ(result.exit_code, 1) << result.output;
  EXPECT_EQ(std::count(result.output.begin(), result.output.end(), '\n'), 1) << result.output;
  const std::string name = std::filesystem::path(GetParam().path).filename().string();
  EXPECT_EQ(result.output.find(name + ": "), 0u) << result.output;
  EXPECT_NE(result.output.find("/nowhere/in"), std::string::npos) << result.output;
}

const Tool kTools[] = {
    {DEBLUR_IMAGE, {"/nowhere/in", "/nowhere/out", "--angle-deg", "0", "--extent-px", "9"}},
#ifdef TOOLS_FOR_BAGS
    {DEBLUR_BAG, {"/nowhere/in", "/nowhere/out", "--config", "/nowhere/config"}},
    {MAKE_BAG, {"/nowhere/out", "/nowhere/in", "--format", "euroc"}},
    {SIMULATE_BAG, {"/nowhere/out", "--scene", "/nowhere/in"}},
    {CALIBRATE, {"/nowhere/in"}},
#endif
};

INSTANTIATE_TEST_SUITE_P(Tools, Usage, testing::ValuesIn(kTools), [](const testing::TestParamInfo<Tool>& tool) {
  return std::filesystem::path(tool.param.path).filename().string();
});

}  // namespace
}  // namespace gyro_deblur
