// Common parts of the command-line tools: arguments, errors, exit codes.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "tools/command_line.hpp"

namespace gyro_deblur {

/// Exit codes, by which scripts distinguish bad input from bad usage.
enum ExitCode { SUCCESS = 0, BAD_INPUT = 1, BAD_USAGE = 2 };

/// Arguments of every tool.
struct CommonArguments {
  std::string json;    ///< file of the report; empty: none
  bool quiet = false;  ///< no progress on stderr
};
/// Adds --json and --quiet.
void add_common_options(CommandLine& app, CommonArguments* arguments);

/// @return for main, where the tool ends here: SUCCESS with the help on stdout, BAD_USAGE with what is wrong on stderr
std::optional<int> read_arguments(CommandLine& arguments, int argc, char** argv);

/// Reads the arguments, then runs the tool.
/// @param arguments  with the tool's name and options
/// @param run  throws std::exception when it cannot do what it is asked for; called at most once
/// @return for main: SUCCESS, also of --help; BAD_USAGE; BAD_INPUT with one line
///     "TOOL: what()" on stderr
int run_tool(CommandLine& arguments, int argc, char** argv, const std::function<void()>& run);

}  // namespace gyro_deblur
