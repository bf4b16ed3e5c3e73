// Runs a tool and reports its errors.
#include "tools/tool_main.hpp"

#include <exception>
#include <iostream>

namespace gyro_deblur {

void add_common_options(CommandLine& app, CommonArguments* arguments) {
  app.add_option("--json", arguments->json, "write what was done to this file as JSON");
  app.add_flag("--quiet", arguments->quiet, "no progress on stderr");
}

std::optional<int> read_arguments(CommandLine& arguments, int argc, char** argv) {
  try {
    if (!arguments.parse(argc, argv)) {
      std::cout << arguments.help();
      return SUCCESS;
    }
  } catch (const UsageError& error) {
    std::cerr << arguments.name() << ": " << error.what() << "; see " << arguments.name() << " --help\n";
    return BAD_USAGE;
  }
  return {};
}

int run_tool(CommandLine& arguments, int argc, char** argv, const std::function<void()>& run) {
  if (const std::optional<int> ended = read_arguments(arguments, argc, argv)) return *ended;
  try {
    run();
  } catch (const std::exception& error) {
    std::cerr << arguments.name() << ": " << error.what() << "\n";
    return BAD_INPUT;
  }
  return SUCCESS;
}

}  // namespace gyro_deblur
