// Calibration of timing on recorded flights through a simulated room: trajectories, exposures and readouts. Writes the
// table of doc/reports/timing.md.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>

#include "flight_timing.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  double seconds = 40, speed = 1;
  int width_px = 376;
  std::uint64_t seed = 1;
};

const char kHead[] =
    "| trajectory | exposure [ms] | readout [ms] | offset [ms] | readout [ms] | bias [rad/s] | rotation [degrees] | "
    "rotation alone / with translation [px] | errors in standard deviations, rms and largest |\n"
    "| --- | --- | --- | --- | --- | --- | --- | --- | --- |\n";

std::string row_of(const test::FlightCase& c, const test::FlightTiming& t) {
  char text[500];
  const Eigen::ArrayXd normalised = t.errors.cwiseQuotient(t.stddevs).array().abs();
  std::snprintf(text, sizeof(text),
                "| %s | %.0f | %.0f | %+.3f ± %.3f | %+.3f ± %.3f | %.4f ± %.4f | %.3f ± %.3f | %.2f / %.3f | %.1f, "
                "%.1f |\n",
                c.flight.name, 1e3 * to_seconds(c.exposure_ns), 1e3 * to_seconds(c.readout_ns), 1e3 * t.errors[0],
                1e3 * t.stddevs[0], 1e3 * t.errors[1], 1e3 * t.stddevs[1], t.bias_rad_s(),
                t.stddevs.segment<3>(2).maxCoeff(), t.rotation_deg(), t.stddevs.tail<3>().norm() * 180 / M_PI,
                t.estimate.median_at_start_px, t.estimate.median_px, std::sqrt(t.normalised_square()),
                normalised.maxCoeff());
  return text;
}

void run(const Arguments& arguments) {
  if (!std::filesystem::exists(arguments.data + "/trajectories")) {
    throw std::runtime_error("there is no " + arguments.data + "/trajectories; see test/data/README.md");
  }
  std::string table = kHead;
  std::fputs(kHead, stdout);
  for (const test::RecordedFlight& flight : test::recorded_flights()) {
    for (const TimeNs exposure_ns : {15'000'000, 30'000'000}) {
      for (const TimeNs readout_ns : {0, 20'000'000}) {
        constexpr double kLeadsS = 2;
        const test::FlightCase c{
            flight,          std::min(arguments.seconds, flight.length_s / arguments.speed - kLeadsS),
            arguments.speed, exposure_ns,
            readout_ns,      arguments.width_px,
            arguments.seed};
        const std::string row = row_of(c, test::calibrate_flight(c, arguments.data));
        std::fputs(row.c_str(), stdout);
        std::fflush(stdout);
        table += row;
      }
    }
  }
  if (arguments.output.empty()) return;
  std::ofstream file(arguments.output);
  file << table;
  if (!file.flush()) throw std::runtime_error(arguments.output + " cannot be written");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Flies recorded trajectories through a textured room and calibrates timing on what the camera sees. Prints what "
      "the estimates are wrong by.",
      "flight_timing"};
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--seconds", arguments.seconds, "of each flight, where it is that long [40]").range(2.0, 80.0);
  app.add_option("--speed", arguments.speed, "of the flight, 1: as recorded").range(0.2, 3.0);
  app.add_option("--width", arguments.width_px, "of the image [376 px]").range(100, 2000);
  app.add_option("--seed", arguments.seed, "of all noise [1]");
  app.add_option("--out", arguments.output, "file for the table");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
