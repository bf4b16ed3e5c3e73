// How well validation distinguishes predicted blur from none and from a third of it: areas under the receiver operating
// characteristic, and what is accepted, by extent, noise and contrast.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <map>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "blur/blur_likelihood.hpp"
#include "blur/blur_validation.hpp"
#include "blur/image_noise.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "result_table.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"
#include "validation_scores.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::vector<std::string> photographs;  // none: the first images of the Oxford sets
  std::vector<double> extents_px = {5, 10, 20, 40}, noises = {1, 4, 8}, contrasts = {1, 0.35};
  int angles = 2;
  int hot_ppm = 0;
  double angle_error_deg = 0, extent_error = 0;
  std::uint64_t seed = 1;
  std::string out = "results";
  bool quiet = false;
};

/// Of the blocks of all photographs, by what is done with them.
struct Scores {
  std::vector<double> gradient, alone, together;
};
enum Truth { BLURRED, SHARP, THIRD };
using Cell = std::tuple<double, double, double>;  // extent, noise, contrast

void append(const std::vector<double>& from, std::vector<double>* to) {
  to->insert(to->end(), from.begin(), from.end());
}

void score(const FrameBlur& field, const cv::Mat& image, Scores* scores) {
  for (int i = 0; i < field.grid.size(); ++i) {
    scores->gradient.push_back(-max_gradient_along(image, field.grid.rect(i), field.blocks[i].angle_rad));
  }
  const std::vector<double> alone =
      log_ratios(field, BlurLikelihood(image, image_noise(image, PixelLayout::GRAY).value_or(0)));
  append(alone, &scores->alone);
  append(with_neighbours(field.grid, alone), &scores->together);
}

using AllScores = std::map<Cell, std::array<Scores, 3>>;

AllScores measure(const Arguments& arguments) {
  AllScores scores;
  std::uint64_t seed = arguments.seed;
  cv::RNG rng(seed);
  Progress progress(arguments.photographs.size(), "photographs", arguments.quiet);
  for (std::size_t p = 0; p < arguments.photographs.size(); ++p) {
    const cv::Mat photograph = cv::imread(arguments.photographs[p], cv::IMREAD_GRAYSCALE);
    if (photograph.empty()) throw std::runtime_error("cannot read " + arguments.photographs[p]);
    for (const double extent_px : arguments.extents_px) {
      for (int a = 0; a < arguments.angles; ++a) {
        const double angle_rad = rng.uniform(0.0, CV_PI);
        test::PredictedBlur images = test::predict_blur(photograph, angle_rad, extent_px);
        const double wrong_rad = angle_rad + rng.gaussian(arguments.angle_error_deg) * CV_PI / 180;
        const double wrong_px = extent_px * (1 + rng.uniform(-1.0, 1.0) * arguments.extent_error);
        images.field = uniform_blur_field(images.sharp.cols, images.sharp.rows, wrong_rad, wrong_px, {});
        for (const double noise : arguments.noises) {
          for (const double contrast : arguments.contrasts) {
            std::array<Scores, 3>& of_cell = scores[{extent_px, noise, contrast}];
            const test::Exposed how{noise, contrast, arguments.hot_ppm};
            score(images.field, test::expose(images.blurred, how, ++seed), &of_cell[BLURRED]);
            score(images.field, test::expose(images.sharp, how, ++seed), &of_cell[SHARP]);
            score(images.field, test::expose(images.third, how, ++seed), &of_cell[THIRD]);
          }
        }
      }
    }
    progress.done(p + 1);
  }
  return scores;
}

double share_above(const std::vector<double>& scores, double threshold) {
  const auto above = std::count_if(scores.begin(), scores.end(), [&](double s) { return s > threshold; });
  return static_cast<double>(above) / static_cast<double>(scores.size());
}

void report(const Arguments& arguments, const AllScores& scores) {
  std::vector<std::string> header = {"", "contrast", "noise"};
  for (const double extent_px : arguments.extents_px) header.push_back(text_of(extent_px, 0) + " px");
  ResultTable areas(header), accepted(header);
  for (const Truth truth : {SHARP, THIRD}) {
    for (const double contrast : arguments.contrasts) {
      for (const double noise : arguments.noises) {
        std::vector<std::string> row = {truth == SHARP ? "sharp" : "a third", text_of(contrast, 2), text_of(noise, 0)};
        std::vector<std::string> rates = row;
        for (const double extent_px : arguments.extents_px) {
          const std::array<Scores, 3>& of_cell = scores.at({extent_px, noise, contrast});
          const auto area = [&](std::vector<double> Scores::*of) {
            return text_of(test::area_under_roc(of_cell[BLURRED].*of, of_cell[truth].*of), 4);
          };
          row.push_back(area(&Scores::together) + " (" + area(&Scores::alone) + ", " + area(&Scores::gradient) + ")");
          rates.push_back(text_of(share_above(of_cell[truth].together, 0), 3) + " of " +
                          text_of(share_above(of_cell[BLURRED].together, 0), 3));
        }
        areas.add(row);
        accepted.add(rates);
      }
    }
  }
  std::printf("Areas: together with neighbours (each block alone, the paper's gradient)\n\n%s\n",
              areas.markdown().c_str());
  std::printf("Log ratio above 0: of those, of the truly blurred\n\n%s\n", accepted.markdown().c_str());
  // Of all cells.
  ResultTable thresholds({"falsely accepted", "log ratio above", "of sharp", "of blurred"});
  std::array<std::vector<double>, 3> together;
  for (const auto& [cell, of_cell] : scores) {
    for (const Truth truth : {BLURRED, SHARP, THIRD}) append(of_cell[truth].together, &together[truth]);
  }
  for (const double rate : {0.2, 0.1, 0.05, 0.02, 0.01, 0.005}) {
    const double threshold = quantile(together[THIRD], 1 - rate);
    thresholds.add({text_of(rate, 3), text_of(threshold, 1), text_of(share_above(together[SHARP], threshold), 4),
                    text_of(share_above(together[BLURRED], threshold), 4)});
  }
  std::printf("Blocks blurred by a third that a threshold accepts\n\n%s", thresholds.markdown().c_str());
  std::filesystem::create_directories(arguments.out);
  areas.write(arguments.out, "validation_areas");
  accepted.write(arguments.out, "validation_accepted");
  thresholds.write(arguments.out, "validation_thresholds");
}

void run(Arguments arguments) {
  if (arguments.photographs.empty()) {
    for (const char* set : {"bark", "bikes", "boat", "graf", "leuven", "trees", "ubc", "wall"}) {
      arguments.photographs.push_back(std::string(GYRO_DEBLUR_DATA_DIR) + "/oxford_affine/" + set + "/img1.png");
    }
  }
  report(arguments, measure(arguments));
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app("Measures how well validation separates predicted blur from none and from a third of it.",
                  "validation");
  app.add_option("--photographs", arguments.photographs, "image files (default: the first images of the Oxford sets)");
  app.add_option("--extents-px", arguments.extents_px, "predicted blur").show_default();
  app.add_option("--noises", arguments.noises, "grey levels").show_default();
  app.add_option("--contrasts", arguments.contrasts, "about the middle grey").show_default();
  app.add_option("--angles", arguments.angles, "for each extent").show_default();
  app.add_option("--hot-ppm", arguments.hot_ppm, "white pixels per million").show_default();
  app.add_option("--angle-error-deg", arguments.angle_error_deg, "standard deviation of the prediction's error");
  app.add_option("--extent-error", arguments.extent_error, "the prediction's largest error, as a share of the extent");
  app.add_option("--seed", arguments.seed, "of angles and noise").show_default();
  app.add_option("--out", arguments.out, "folder for the tables").show_default();
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
