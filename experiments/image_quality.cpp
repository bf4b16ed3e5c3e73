// Which corners of a shaken camera's frames are where they would be without blur, by status, extent and noise of their
// block, and whether a frame's score says so. Writes the tables and data of doc/reports/image_quality.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include <CLI/CLI.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "baselines.hpp"
#include "footage.hpp"
#include "gyro_deblur/frame_quality.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "image_pairs.hpp"
#include "result_table.hpp"
#include "shaken_frames.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  std::uint64_t seed = 1;
  bool quick = false, quiet = false;
};

constexpr int kCorners = 500;
constexpr double kMinQuality = 0.001, kMinDistancePx = 5, kSamePx = 2;
const std::vector<double> kExtentBordersPx{0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 60, 100, 500};
const std::vector<Light> kLights{{"contrast 1, noise 1", 1, 1},
                                 {"contrast 1, noise 2", 1, 2},
                                 {"contrast 1, noise 6", 1, 6},
                                 {"contrast .35, noise 4", 0.35, 4}};

Features corners_of(const cv::Mat& image) {
  std::vector<cv::Point2f> places_px;
  cv::goodFeaturesToTrack(image, places_px, kCorners, kMinQuality, kMinDistancePx);
  Features corners;
  for (const cv::Point2f& place_px : places_px) corners.keypoints.emplace_back(place_px, 1.f);
  return corners;
}

/// Is there one of the others within kSamePx?
bool is_repeated(const cv::KeyPoint& corner, const std::vector<cv::KeyPoint>& others) {
  return std::any_of(others.begin(), others.end(), [&corner](const cv::KeyPoint& other) {
    return std::hypot(corner.pt.x - other.pt.x, corner.pt.y - other.pt.y) <= kSamePx;
  });
}

struct Counts {
  double corners = 0, repeated = 0, expected = 0, extent_px = 0, noise_to_contrast = 0;
  double share() const { return repeated / corners; }
};

/// By status, light, and extent.
using Bin = std::tuple<BlockStatus, std::size_t, std::size_t>;

std::size_t extent_bin(double extent_px) {
  return std::upper_bound(kExtentBordersPx.begin(), kExtentBordersPx.end() - 1, extent_px) - kExtentBordersPx.begin() -
         1;
}

struct Frame {
  std::string camera, what, verdict;
  double noise_to_contrast, score, measured, extent_px;
};

/// Counts the corners of one output of a frame.
Frame count(const cv::Mat& image, const FrameBlur& field, const Shot& shot, const std::vector<cv::KeyPoint>& sharp,
            std::size_t light, std::map<Bin, Counts>* bins) {
  const Features found = corners_of(image);
  const Features moved = rectified(found, field, shot);
  const FrameQuality quality = assess_quality(field);
  Counts all;
  for (std::size_t i = 0; i < found.keypoints.size(); ++i) {
    const cv::Point2f& pt = found.keypoints[i].pt;
    const BlockBlur& block = field.blocks[field.grid.index_at(pt.x, pt.y)];
    Counts& bin = (*bins)[{block.status, light, extent_bin(block.extent_px)}];
    const bool repeated = is_repeated(moved.keypoints[i], sharp);
    const double expected = expected_repeatability(block, noise_to_contrast(field)).value_or(0);
    for (Counts* counts : {&bin, &all}) {
      counts->corners += 1;
      counts->repeated += repeated ? 1 : 0;
      counts->expected += expected;
      counts->extent_px += block.extent_px;
      counts->noise_to_contrast += noise_to_contrast(field);
    }
  }
  return {"",
          "",
          to_string(quality.verdict),
          noise_to_contrast(field),
          quality.score.value_or(-1),
          all.share(),
          quality.before.median_px};
}

void run(const Arguments& arguments) {
  const std::vector<sim::TraceSample> trace = load_hand_shake(arguments.data);
  std::string source;
  const std::vector<ImagePair> photographs = load_pairs(arguments.data, source);
  std::vector<View> views = random_views(arguments.seed, trace.back().t_s);
  std::vector<ShakenCamera> cameras{kVga, kFullHd};
  std::vector<double> scales{1, 0.6, 0.3};
  std::vector<TimeNs> exposures_ns{5'000'000, 10'000'000, 20'000'000, 30'000'000};
  if (arguments.quick) views.resize(2 * kViewsOfEach), cameras.resize(1), scales.resize(1);

  std::map<Bin, Counts> bins;
  std::vector<Frame> frames;
  Progress progress(cameras.size() * scales.size() * exposures_ns.size(), "shakes", arguments.quiet);
  std::size_t done = 0;
  for (const ShakenCamera& camera : cameras) {
    for (const double scale : scales) {
      for (const TimeNs exposure_ns : exposures_ns) {
        for (std::size_t i = 0; i < views.size(); ++i) {
          const Shot shot = take_shot(camera, trace, scale, exposure_ns, views[i], photographs);
          for (std::size_t light = 0; light < kLights.size(); ++light) {
            constexpr std::uint64_t kOther = 1'000'000;
            const cv::Mat blurred = lit(shot.blurred, kLights[light], 1 + i);
            const std::vector<cv::KeyPoint> sharp =
                corners_of(lit(shot.sharp, kLights[light], 1 + i + kOther)).keypoints;
            PipelineOptions options;
            options.motion_from_images = false;  // frames are not consecutive
            Pipeline pipeline(options);
            pipeline.set_calibration(shot.simulator.scene().camera.calibration);
            PipelineRequest request;
            request.keypoints = false;
            const PipelineResult result =
                pipeline.process(blurred, PixelLayout::GRAY, shot.rotation, shot.simulator.exposure(0), request);
            FrameBlur as_it_arrived = as_blurred(result.field);
            for (const bool deblurred : {false, true}) {
              frames.push_back(count(deblurred && !result.image.empty() ? result.image : blurred,
                                     deblurred ? result.field : as_it_arrived, shot, sharp, light, &bins));
              frames.back().camera = camera.name;
              frames.back().what = deblurred ? "deblurred" : "blurred";
              if (!deblurred) frames.back().verdict = "-";  // it has no status of its own
            }
          }
        }
        progress.done(++done);
      }
    }
  }

  ResultTable table(
      {"status", "extent [px]", "light", "mean extent [px]", "noise over contrast", "corners", "repeated", "expected"});
  for (const auto& [bin, counts] : bins) {
    const auto& [status, light, extent] = bin;
    table.add({to_string(status),
               text_of(kExtentBordersPx[extent], 0) + " to " + text_of(kExtentBordersPx[extent + 1], 0),
               kLights[light].name, text_of(counts.extent_px / counts.corners, 2),
               text_of(counts.noise_to_contrast / counts.corners, 4), text_of(counts.corners, 0),
               text_of(counts.share(), 3), text_of(counts.expected / counts.corners, 3)});
  }
  std::printf("Photographs: %s.\n%s", source.c_str(), table.markdown().c_str());
  if (arguments.output.empty()) return;
  std::filesystem::create_directories(arguments.output);
  table.write(arguments.output, "image_quality_blocks");
  ResultTable all({"camera", "image", "verdict", "noise over contrast", "extent [px]", "score", "repeated"});
  for (const Frame& frame : frames) {
    all.add({frame.camera, frame.what, frame.verdict, text_of(frame.noise_to_contrast, 3), text_of(frame.extent_px, 1),
             text_of(frame.score, 3), text_of(frame.measured, 3)});
  }
  all.write(arguments.output, "image_quality_frames");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CLI::App app{"Whether the score of an image says how many of its corners are those of a sharp one.", "image_quality"};
  app.add_option("--out", arguments.output, "folder for the tables");
  app.add_option("--data", arguments.data, "recorded data, with handshake_gyro/");
  app.add_option("--seed", arguments.seed, "of the times and views [1]");
  app.add_flag("--quick", arguments.quick, "eight views of one camera, at one strength");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
