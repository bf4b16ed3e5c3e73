// What it costs that blur changes: the first frame at new extents against later ones, and blur at non-uniform speed
// against even blur of the same extent, in time and in what is restored.

#include <time.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "base/median.hpp"
#include "blur/path_1d.hpp"
#include "engine/engine.hpp"
#include "engines.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "roll_scene.hpp"
#include "scene.hpp"
#include "synthetic_blur.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::benchmark {
namespace {

constexpr double kNoiseGreyLevels = 1;
const cv::Size kSizes[] = {{752, 480}, {1920, 1080}};

struct Arguments {
  std::string engine = "cpu";
  std::vector<double> max_extents_px = {100, 150, 500};
  std::vector<double> extents_px = {40, 60, 80, 105, 150, 250};
  int threads = 1;
  int rounds = 5;
  int angle_step_deg = 15;
  bool wall = false, in_time = false, skip_first = false, skip_nonuniform = false, skip_fidelity = false;
  std::string json;
};

/// Time [ms] of the processors while they run this process, which others on the machine hardly change, or of the wall.
double ms_of(bool wall, const std::function<void()>& work) {
  const auto now_ms = [wall] {
    timespec time{};
    clock_gettime(wall ? CLOCK_MONOTONIC : CLOCK_PROCESS_CPUTIME_ID, &time);
    return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
  };
  const double start_ms = now_ms();
  work();
  return now_ms() - start_ms;
}

/// How far along its line the camera's point is at `t`, 0 to 1.
struct Profile {
  const char* name;
  double (*place)(double t);
};
const std::array<Profile, 4> kProfiles = {
    {{"speeds up to fourfold", [](double t) { return t * (0.4 + 0.6 * t); }},
     {"starts from rest", [](double t) { return t * t; }},
     {"slows down twice", [](double t) { return t + 0.06 * std::sin(4 * CV_PI * t); }},
     {"reverses", [](double t) { return (t - 0.3) * (t - 0.3); }}}};

/// `profile` over `extent_px`, from where it is at the middle of the exposure.
Path1d path_of(const Profile& profile, double extent_px) {
  Path1d path_px;
  for (int k = 0; k < kPathInstants; ++k) {
    path_px[k] = static_cast<float>(profile.place(k / (kPathInstants - 1.0)) - profile.place(0.5));
  }
  const auto scale = static_cast<float>(extent_px / extent_of(path_px));
  for (float& place_px : path_px) place_px *= scale;
  return path_px;
}

FrameBlur roll_field(cv::Size size, double mean_extent_px) {
  return test::Roll::about_center(size.width, size.height, mean_extent_px)
      .field(size.width, size.height, wide_options());
}

/// Every block at the speed of `profile`.
FrameBlur nonuniform(FrameBlur field, const Profile& profile) {
  for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_of(profile, block.extent_px);
  return field;
}

/// A bank and an engine that have not seen the extents of a roll, as long as max_extent allows.
nlohmann::json measure_first_frame(const Arguments& arguments) {
  nlohmann::json records;
  std::printf("First frame at new extents, %d thread%s, median ms\n%-10s %12s %10s %8s %8s %8s\n", arguments.threads,
              arguments.threads > 1 ? "s" : "", "size", "max_extent", "made ahead", "first", "later", "more");
  for (const cv::Size size : kSizes) {
    const cv::Mat image = extend(natural_images().front(), size);
    // The corners of a roll have about twice the mean.
    for (const double max_extent_px : arguments.max_extents_px) {
      std::vector<double> ahead_ms, first_ms, later_ms;
      for (int round = 0; round < arguments.rounds; ++round) {
        BlurFieldOptions options;
        options.max_extent_px = max_extent_px;
        const FilterBank bank(FilterOptions{});
        const auto engine = make_engine(arguments.engine, arguments.threads);
        cv::Mat dst;
        const auto run = [&](const FrameBlur& field) {
          return ms_of(arguments.wall,
                       [&] { deconvolve(image, PixelLayout::GRAY, field, bank, *engine, dst, arguments.threads); });
        };
        ahead_ms.push_back(ms_of(arguments.wall, [&] {
          if (!arguments.in_time) prepare_deconvolution(options, bank, *engine, arguments.threads);
        }));
        for (int i = 0; i < 2; ++i) run(roll_field(size, 4));  // memory of the image's size
        const FrameBlur field = roll_field(size, 0.5 * max_extent_px);
        first_ms.push_back(run(field));
        std::vector<double> again_ms;
        for (int i = 0; i < 5; ++i) again_ms.push_back(run(field));
        later_ms.push_back(median(again_ms));
      }
      std::printf("%4dx%-5d %9.0f px %10.2f %8.2f %8.2f %8.2f\n", size.width, size.height, max_extent_px,
                  median(ahead_ms), median(first_ms), median(later_ms), median(first_ms) - median(later_ms));
      std::fflush(stdout);
      records.push_back({{"width", size.width},
                         {"height", size.height},
                         {"max_extent_px", max_extent_px},
                         {"threads", arguments.threads},
                         {"ahead_ms", median(ahead_ms)},
                         {"first_ms", median(first_ms)},
                         {"later_ms", median(later_ms)}});
    }
  }
  return records;
}

nlohmann::json measure_nonuniform(const Arguments& arguments) {
  nlohmann::json records;
  const cv::Size size(1920, 1080);
  const cv::Mat image = extend(natural_images().front(), size);
  const FilterBank bank(FilterOptions{});
  std::printf("\nUneven speed, 1920x1080, %d thread%s, median ms: making kernels + filtering, over even\n%-22s",
              arguments.threads, arguments.threads > 1 ? "s" : "", "mean extent");
  for (const double extent_px : arguments.extents_px) std::printf(" %15.0f px", extent_px);
  std::printf("\n");
  std::vector<double> even_ms;
  for (int p = -1; p < static_cast<int>(kProfiles.size()); ++p) {
    std::printf("%-22s", p < 0 ? "even" : kProfiles[p].name);
    for (std::size_t e = 0; e < arguments.extents_px.size(); ++e) {
      FrameBlur field = roll_field(size, arguments.extents_px[e]);
      for (BlockBlur& block : field.blocks) {  // of one extent, along the roll
        block.extent_px = static_cast<float>(arguments.extents_px[e]);
        block.status = BlockStatus::DEBLURRED;
      }
      if (p >= 0) field = nonuniform(field, kProfiles[p]);
      const auto engine = make_engine(arguments.engine, arguments.threads);
      cv::Mat dst;
      std::vector<double> making_ms, filtering_ms, all_ms;
      for (int round = -1; round < arguments.rounds; ++round) {
        FilterGrid grid;
        const double making = ms_of(arguments.wall, [&] { grid = make_filter_grid(field, bank, arguments.threads); });
        const double filtering = ms_of(arguments.wall, [&] { engine->filter(image, grid, dst); });
        if (round < 0) continue;
        making_ms.push_back(making);
        filtering_ms.push_back(filtering);
        all_ms.push_back(making + filtering);
      }
      if (p < 0) even_ms.push_back(median(all_ms));
      std::size_t slow = 0;
      for (const auto& [reason, count] : engine->fallback_counts()) slow += count;
      const double ratio = median(all_ms) / even_ms[e];
      std::printf(" %5.1f+%5.1f %4.1f%s", median(making_ms), median(filtering_ms), ratio, slow > 0 ? "s" : " ");
      std::fflush(stdout);
      records.push_back({{"profile", p < 0 ? "even" : kProfiles[p].name},
                         {"extent_px", arguments.extents_px[e]},
                         {"threads", arguments.threads},
                         {"making_ms", median(making_ms)},
                         {"filtering_ms", median(filtering_ms)},
                         {"over_even", ratio},
                         {"fallback_counts", slow}});
    }
    std::printf("\n");
  }
  return records;
}

double mean_square(const cv::Mat& a, const cv::Mat& b) {
  const double norm = cv::norm(a, b, cv::NORM_L2);
  return norm * norm / static_cast<double>(a.total());
}
double psnr_of(double mean_square_error) { return 10 * std::log10(255.0 * 255.0 / std::max(mean_square_error, 1e-9)); }

/// Photographs blurred along one line at non-uniform speed: what the engine restores, against what "float" does.
nlohmann::json measure_fidelity(const Arguments& arguments) {
  nlohmann::json records;
  const FilterBank bank(FilterOptions{});
  std::vector<cv::Mat> photographs = natural_images();
  photographs.resize(std::min<std::size_t>(photographs.size(), 2));
  const auto in_float = make_engine("float", arguments.threads);
  std::printf(
      "\nUneven speed: parity with the engine float, worst angle; blurred, restored by float [dB], loss, worst\n");
  for (const Profile& profile : kProfiles) {
    for (const double extent_px : arguments.extents_px) {
      double parity = 0, worst_parity = 0, blurred_db = 0, restored_db = 0, loss_db = 0, worst_loss_db = -100;
      int count = 0;
      const Path1d path_px = path_of(profile, extent_px);
      for (const cv::Mat& photograph : photographs) {
        const cv::Rect middle((photograph.cols - 320) / 2, (photograph.rows - 256) / 2, 320, 256);
        for (int degrees = 0; degrees < 180; degrees += arguments.angle_step_deg) {
          const double angle_rad = degrees * CV_PI / 180;
          const cv::Mat sharp = photograph(middle);
          const cv::Mat blurred = test::expose(test::blur_along_path(photograph, angle_rad, path_px)(middle),
                                               kNoiseGreyLevels, static_cast<std::uint64_t>(degrees));
          FrameBlur field = uniform_blur_field(blurred.cols, blurred.rows, angle_rad, extent_px, wide_options());
          for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_px;
          cv::Mat expected, actual;
          deconvolve(blurred, PixelLayout::GRAY, field, bank, *in_float, expected);
          deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine(arguments.engine, arguments.threads),
                     actual);
          const double error = mean_square(expected, actual);
          const double float_db = psnr_of(mean_square(expected, sharp));
          const double loss = float_db - psnr_of(mean_square(actual, sharp));
          parity += error;
          worst_parity = std::max(worst_parity, error);
          blurred_db += psnr_of(mean_square(blurred, sharp));
          restored_db += float_db;
          loss_db += loss;
          worst_loss_db = std::max(worst_loss_db, loss);
          ++count;
        }
      }
      std::printf("%-22s %4.0f px  parity %5.1f, %5.1f;  blurred %5.2f restored %5.2f loss %+.3f, %+.3f\n",
                  profile.name, extent_px, psnr_of(parity / count), psnr_of(worst_parity), blurred_db / count,
                  restored_db / count, loss_db / count, worst_loss_db);
      std::fflush(stdout);
      records.push_back({{"profile", profile.name},
                         {"extent_px", extent_px},
                         {"parity_db", psnr_of(parity / count)},
                         {"worst_parity_db", psnr_of(worst_parity)},
                         {"blurred_db", blurred_db / count},
                         {"restored_db", restored_db / count},
                         {"mean_loss_db", loss_db / count},
                         {"worst_loss_db", worst_loss_db}});
    }
  }
  return records;
}

void run(const Arguments& arguments) {
  if (!make_engine(arguments.engine, 1)) throw std::runtime_error("engine " + arguments.engine + " cannot run here");
  cv::setNumThreads(arguments.threads);
  nlohmann::json result;
  result["clock"] = arguments.wall ? "wall" : "processor";
  if (!arguments.skip_first) result["first_frame"] = measure_first_frame(arguments);
  if (!arguments.skip_nonuniform) result["nonuniform"] = measure_nonuniform(arguments);
  if (!arguments.skip_fidelity) result["fidelity"] = measure_fidelity(arguments);
  write_json(arguments.json, result);
}

}  // namespace
}  // namespace gyro_deblur::benchmark

int main(int argc, char** argv) {
  gyro_deblur::benchmark::Arguments arguments;
  gyro_deblur::CommandLine app{
      "Times the first frame at new extents against later ones, and blur at non-uniform speed against even blur; and "
      "what "
      "of non-uniform blur is restored.",
      "compare_kernels"};
  app.add_option("--engine", arguments.engine).show_default();
  app.add_option("--max-extents", arguments.max_extents_px, "of the first frames [px]")
      .range(20.0, 500.0)
      .show_default();
  app.add_option("--extents", arguments.extents_px, "of non-uniform blur [px]").range(4.0, 500.0).show_default();
  app.add_option("--threads", arguments.threads).range(1, 256).show_default();
  app.add_option("--rounds", arguments.rounds).range(1, 10000).show_default();
  app.add_option("--angle-step", arguments.angle_step_deg, "of the restored photographs [deg]")
      .range(1, 90)
      .show_default();
  app.add_flag("--wall", arguments.wall, "time of the wall instead of the processors'");
  app.add_flag("--in-time", arguments.in_time, "make nothing ahead of the first frame");
  app.add_flag("--skip-first", arguments.skip_first);
  app.add_flag("--skip-nonuniform", arguments.skip_nonuniform);
  app.add_flag("--skip-fidelity", arguments.skip_fidelity);
  app.add_option("--json", arguments.json, "also write the numbers as JSON");
  return gyro_deblur::run_tool(app, argc, argv, [&arguments] { gyro_deblur::benchmark::run(arguments); });
}
