// How close the fast engines come to the float engine, what that costs the restored image, and whether block
// borders show.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

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

struct Arguments {
  std::vector<std::string> engines;  // empty: the fastest that is available
  std::vector<double> extents_px = {2, 3, 5, 8, 11, 15, 20, 25, 30, 35, 40, 45, 50, 60, 70, 80, 90, 110, 130};
  int angle_step_deg = 1;
  int uniform_images = 2;
  int threads = 2;
  bool skip_uniform = false, skip_roll = false, skip_seams = false;
  std::string json;
};

double mean_square(const cv::Mat& a, const cv::Mat& b) {
  const double norm = cv::norm(a, b, cv::NORM_L2);
  return norm * norm / static_cast<double>(a.total());
}
double psnr_of(double mean_square_error) { return 10 * std::log10(255.0 * 255.0 / std::max(mean_square_error, 1e-9)); }

/// Comparison of one engine with the float engine over a set of images.
struct Comparison {
  double parity_sum = 0;  // of mean squares
  int count = 0;
  double worst_parity_db = std::numeric_limits<double>::infinity();
  double worst_parity_at = 0;
  double worst_loss_db = -std::numeric_limits<double>::infinity();
  double worst_loss_at = 0;
  double loss_sum_db = 0, restored_sum_db = 0;

  /// @param at  angle [deg] that the worst cases are known by
  void add(const cv::Mat& in_float, const cv::Mat& actual, const cv::Mat& sharp, double at) {
    const double parity = mean_square(in_float, actual);
    const double restored_db = psnr_of(mean_square(in_float, sharp));
    const double loss_db = restored_db - psnr_of(mean_square(actual, sharp));
    parity_sum += parity;
    ++count;
    loss_sum_db += loss_db;
    restored_sum_db += restored_db;
    if (psnr_of(parity) < worst_parity_db) {
      worst_parity_db = psnr_of(parity);
      worst_parity_at = at;
    }
    if (loss_db > worst_loss_db) {
      worst_loss_db = loss_db;
      worst_loss_at = at;
    }
  }

  nlohmann::json to_json() const {
    return {{"parity_db", psnr_of(parity_sum / count)}, {"worst_parity_db", worst_parity_db},
            {"worst_parity_at_deg", worst_parity_at},   {"mean_loss_db", loss_sum_db / count},
            {"worst_loss_db", worst_loss_db},           {"worst_loss_at_deg", worst_loss_at},
            {"restored_db", restored_sum_db / count}};
  }
};

void print(const char* what, const std::string& engine, double extent_px, const Comparison& c) {
  std::printf(
      "%-8s %-13s %6.1f px  parity %5.1f dB, worst %5.1f at %3.0f deg;  loss %+.3f dB, worst %+.3f at %3.0f deg;"
      "  restored %.2f dB\n",
      what, engine.c_str(), extent_px, psnr_of(c.parity_sum / c.count), c.worst_parity_db, c.worst_parity_at,
      c.loss_sum_db / c.count, c.worst_loss_db, c.worst_loss_at, c.restored_sum_db / c.count);
  std::fflush(stdout);
}

/// One angle and extent for the whole image, every angle.
nlohmann::json measure_uniform(const Arguments& arguments, const std::vector<cv::Mat>& photographs,
                               const FilterBank& bank) {
  nlohmann::json records;
  const auto float_engine = make_engine("float", arguments.threads);
  for (const double extent_px : arguments.extents_px) {
    std::map<std::string, Comparison> comparisons;
    for (int i = 0; i < std::min<int>(arguments.uniform_images, static_cast<int>(photographs.size())); ++i) {
      // A patch from the middle, blurred with what lies around it.
      const cv::Mat& photograph = photographs[i];
      const cv::Rect middle((photograph.cols - 320) / 2, (photograph.rows - 256) / 2, 320, 256);
      const cv::Mat sharp = photograph(middle).clone();
      for (int degrees = 0; degrees < 180; degrees += arguments.angle_step_deg) {
        const double angle_rad = degrees * CV_PI / 180;
        const int around = 72;
        const cv::Rect larger(middle.x - around, middle.y - around, 320 + 2 * around, 256 + 2 * around);
        const cv::Mat wide = photograph(larger & cv::Rect({}, photograph.size()));
        const cv::Mat wide_blurred = test::blur_along_line(wide, angle_rad, extent_px);
        const cv::Point at = middle.tl() - (larger & cv::Rect({}, photograph.size())).tl();
        const cv::Mat blurred =
            test::expose(wide_blurred(cv::Rect(at, middle.size())), kNoiseGreyLevels, 1000 * i + degrees);
        const FrameBlur field = uniform_blur_field(blurred.cols, blurred.rows, angle_rad, extent_px, wide_options());
        cv::Mat expected, actual;
        deconvolve(blurred, PixelLayout::GRAY, field, bank, *float_engine, expected);
        for (const std::string& name : arguments.engines) {
          const auto engine = make_engine(name, arguments.threads);
          deconvolve(blurred, PixelLayout::GRAY, field, bank, *engine, actual);
          comparisons[name].add(expected, actual, sharp, degrees);
        }
      }
    }
    for (const auto& [name, comparison] : comparisons) {
      print("uniform", name, extent_px, comparison);
      nlohmann::json record = comparison.to_json();
      record["engine"] = name;
      record["extent_px"] = extent_px;
      records.push_back(record);
    }
  }
  return records;
}

/// Rolls about the image centre.
nlohmann::json measure_roll(const Arguments& arguments, const std::vector<cv::Mat>& photographs,
                            const FilterBank& bank) {
  nlohmann::json records;
  const auto float_engine = make_engine("float", arguments.threads);
  for (const double extent_px : {5, 15, 30, 60, 90, 130}) {
    std::map<std::string, Comparison> comparisons;
    for (std::size_t i = 0; i < photographs.size(); ++i) {
      const cv::Mat& sharp = photographs[i];
      const test::Roll roll = test::Roll::about_center(sharp.cols, sharp.rows, extent_px);
      const cv::Mat blurred = test::expose(roll.blur(sharp), kNoiseGreyLevels, i);
      const FrameBlur field = roll.field(sharp.cols, sharp.rows, wide_options());
      cv::Mat expected, actual;
      deconvolve(blurred, PixelLayout::GRAY, field, bank, *float_engine, expected);
      for (const std::string& name : arguments.engines) {
        const auto engine = make_engine(name, arguments.threads);
        deconvolve(blurred, PixelLayout::GRAY, field, bank, *engine, actual);
        comparisons[name].add(expected, actual, sharp, 0);
      }
    }
    for (const auto& [name, comparison] : comparisons) {
      print("roll", name, extent_px, comparison);
      nlohmann::json record = comparison.to_json();
      record["engine"] = name;
      record["mean_extent_px"] = extent_px;
      records.push_back(record);
    }
  }
  return records;
}

/// Gradient across block borders against that inside, relative to the sharp image.
nlohmann::json measure_seams(const Arguments& arguments, const std::vector<cv::Mat>& photographs,
                             const FilterBank& bank) {
  nlohmann::json records;
  std::vector<std::string> engines = arguments.engines;
  engines.insert(engines.begin(), "float");
  for (const double extent_px : {5, 15, 30, 60, 90, 130}) {
    std::map<std::string, std::vector<double>> contrasts;
    for (std::size_t i = 0; i < photographs.size(); ++i) {
      const cv::Mat sharp = extend(photographs[i], {1920, 1080});
      const test::Roll roll = test::Roll::about_center(sharp.cols, sharp.rows, extent_px);
      const cv::Mat blurred = test::expose(roll.blur(sharp), kNoiseGreyLevels, i);
      const FrameBlur field = roll.field(sharp.cols, sharp.rows, wide_options());
      const double of_sharp = test::border_contrast(sharp, field.grid);
      cv::Mat deblurred;
      for (const std::string& name : engines) {
        const auto engine = make_engine(name, arguments.threads);
        deconvolve(blurred, PixelLayout::GRAY, field, bank, *engine, deblurred);
        contrasts[name].push_back(test::border_contrast(deblurred, field.grid) / of_sharp);
      }
    }
    for (auto& [name, values] : contrasts) {
      const double largest = *std::max_element(values.begin(), values.end());
      double mean = 0;
      for (const double value : values) mean += value / static_cast<double>(values.size());
      std::printf("seams    %-13s %6.1f px  border / inside, relative to sharp: mean %.4f, largest %.4f\n",
                  name.c_str(), extent_px, mean, largest);
      std::fflush(stdout);
      records.push_back({{"engine", name}, {"mean_extent_px", extent_px}, {"mean", mean}, {"largest", largest}});
    }
  }
  return records;
}

void run(Arguments arguments) {
  if (arguments.engines.empty()) arguments.engines = {available_engines().front()};
  for (const std::string& name : arguments.engines) {
    if (!make_engine(name, 1)) throw std::runtime_error("engine " + name + " cannot run here");
  }
  const std::vector<cv::Mat> photographs = natural_images();
  const FilterBank bank(FilterOptions{});
  nlohmann::json result;
  result["images"] = photographs.size();
  result["noise_grey_levels"] = kNoiseGreyLevels;
  if (!arguments.skip_seams) result["seams"] = measure_seams(arguments, photographs, bank);
  if (!arguments.skip_roll) result["roll"] = measure_roll(arguments, photographs, bank);
  if (!arguments.skip_uniform) result["uniform"] = measure_uniform(arguments, photographs, bank);
  write_json(arguments.json, result);
}

}  // namespace
}  // namespace gyro_deblur::benchmark

int main(int argc, char** argv) {
  gyro_deblur::benchmark::Arguments arguments;
  gyro_deblur::CommandLine app{
      "Compares engines with the float engine: parity and restored PSNR over angles and extents, and seams.",
      "measure_fidelity"};
  app.add_option("--engines", arguments.engines,
                 "engines to compare with the float engine; default: the fastest that is available");
  app.add_option("--extents", arguments.extents_px, "of the uniform fields [px]").show_default();
  app.add_option("--angle-step", arguments.angle_step_deg, "of the uniform fields [deg]").range(1, 90).show_default();
  app.add_option("--uniform-images", arguments.uniform_images, "photographs used for the uniform fields")
      .range(1, 8)
      .show_default();
  app.add_option("--threads", arguments.threads).range(1, 256).show_default();
  app.add_flag("--skip-uniform", arguments.skip_uniform);
  app.add_flag("--skip-roll", arguments.skip_roll);
  app.add_flag("--skip-seams", arguments.skip_seams);
  app.add_option("--json", arguments.json, "also write the numbers as JSON");
  return gyro_deblur::run_tool(app, argc, argv, [&arguments] { gyro_deblur::benchmark::run(arguments); });
}
