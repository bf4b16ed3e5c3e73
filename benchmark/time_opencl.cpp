// Where the OpenCL engine's time goes, on the device and on the host, on roll fields.

#include <chrono>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "base/median.hpp"
#include "base/stopwatch.hpp"
#include "engine/opencl/opencl_engine.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "roll_scene.hpp"
#include "scene.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::benchmark {
namespace {

struct Arguments {
  std::string device;
  int width_px = 1920, height_px = 1080;
  std::vector<double> extents_px = {5, 15, 30, 60, 90, 130};
  std::vector<int> threads = {1, 2};
  int rounds = 51, pause_ms = 0;
};

/// The columns of the table. What is left of the whole is finding the filters, copying and blending.
const std::pair<const char*, double OpenClTimes::*> kParts[] = {
    {"plan", &OpenClTimes::plan_ms},        {"fill", &OpenClTimes::fill_ms},     {"wait", &OpenClTimes::wait_ms},
    {"store", &OpenClTimes::store_ms},      {"upload", &OpenClTimes::upload_ms}, {"kernel", &OpenClTimes::kernel_ms},
    {"download", &OpenClTimes::download_ms}};

void run(const Arguments& arguments) {
  for (const std::string& device : opencl_devices()) std::printf("%s\n", device.c_str());
  const FilterBank bank(FilterOptions{});
  const cv::Size size(arguments.width_px, arguments.height_px);
  const cv::Mat image = extend(natural_images().front(), size);
  for (const int threads : arguments.threads) {
    const Stopwatch opening;
    const std::unique_ptr<OpenClEngine> engine = make_opencl_engine(arguments.device, threads);
    std::printf("\n%s, opened in %.0f ms; %dx%d, %d thread%s, median ms\n%9s %8s", engine->name().c_str(), opening.ms(),
                size.width, size.height, threads, threads > 1 ? "s" : "", "extent", "whole");
    for (const auto& [name, part] : kParts) std::printf(" %8s", name);
    std::printf("\n");
    for (const double extent_px : arguments.extents_px) {
      const FrameBlur field =
          test::Roll::about_center(size.width, size.height, extent_px).field(size.width, size.height, wide_options());
      std::vector<double> whole_ms;
      std::map<std::string, std::vector<double>> parts_ms;
      cv::Mat dst;
      constexpr int kWarmUp = 3;
      for (int round = -kWarmUp; round < arguments.rounds; ++round) {
        std::this_thread::sleep_for(std::chrono::milliseconds(arguments.pause_ms));
        const Stopwatch watch;
        deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst);
        if (round < 0) continue;
        whole_ms.push_back(watch.ms());
        for (const auto& [name, part] : kParts) parts_ms[name].push_back(engine->last_times().*part);
      }
      std::printf("%6.0f px %8.3f", extent_px, median(whole_ms));
      for (const auto& [name, part] : kParts) std::printf(" %8.3f", median(parts_ms[name]));
      std::printf("\n");
      std::fflush(stdout);
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::benchmark

int main(int argc, char** argv) {
  gyro_deblur::benchmark::Arguments arguments;
  gyro_deblur::CommandLine app{
      "Times the OpenCL engine on roll fields. Of the host: plan, fill, wait, store; of the device: upload, kernel, "
      "download.",
      "time_opencl"};
  app.add_option("--device", arguments.device, "index, or a part of the name; default: the first GPU, else device");
  app.add_option("--width", arguments.width_px, "[px]").range(1, 10000).show_default();
  app.add_option("--height", arguments.height_px, "[px]").range(1, 10000).show_default();
  app.add_option("--extents", arguments.extents_px, "mean extents [px]").range(1.0, 250.0).show_default();
  app.add_option("--threads", arguments.threads).range(1, 256).show_default();
  app.add_option("--rounds", arguments.rounds).range(1, 10000).show_default();
  app.add_option("--pause", arguments.pause_ms, "between frames, as a camera leaves one [ms]")
      .range(0, 1000)
      .show_default();
  return gyro_deblur::run_tool(app, argc, argv, [&arguments] { gyro_deblur::benchmark::run(arguments); });
}
