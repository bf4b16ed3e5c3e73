#include "tools/tool_main.hpp"

#include <exception>
#include <iostream>

namespace gyro_deblur {

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
