#include "tools/tool_main.hpp"

#include <exception>
#include <iostream>

namespace gyro_deblur {

void add_common_options(CLI::App& app, CommonArguments* arguments) {
  app.add_option("--json", arguments->json, "write what was done to this file as JSON");
  app.add_flag("--quiet", arguments->quiet, "no progress on stderr");
}

int run_tool(CLI::App& app, int argc, char** argv, const std::function<void()>& run) {
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? SUCCESS : BAD_USAGE;
  }
  try {
    run();
  } catch (const std::exception& error) {
    std::cerr << app.get_name() << ": " << error.what() << "\n";
    return BAD_INPUT;
  }
  return SUCCESS;
}

}  // namespace gyro_deblur
