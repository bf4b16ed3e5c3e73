// Which corners of a shaken camera's frames are where they would be without blur, by status, extent and noise of their
// block, and whether a frame's score says so; and whether the exposures that are advised are those of which it holds.
// Writes the tables and data of doc/reports/image_quality.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "baselines.hpp"
#include "blur/exposure_advice.hpp"
#include "blur/frame_quality.hpp"
#include "footage.hpp"
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
  bool quick = false, quiet = false, exposures = false;
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
  std::string camera, what, grade;
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
          to_string(quality.grade),
          noise_to_contrast(field),
          quality.score.value_or(-1),
          all.share(),
          quality.before.median_px};
}

/// The frame as it came, and as the package leaves it with its defaults.
PipelineResult deblur(const cv::Mat& blurred, const Shot& shot) {
  PipelineOptions options;
  options.optical_flow = false;  // frames are not consecutive
  Pipeline pipeline(options);
  pipeline.set_calibration(shot.simulator.scene().camera.calibration);
  PipelineRequest request;
  request.keypoints = false;
  return pipeline.process(blurred, PixelLayout::GRAY, shot.rotation, shot.simulator.exposure(0), request);
}

/// Corners of the sharp view in this light, with other noise than the i-th frame's.
std::vector<cv::KeyPoint> sharp_corners(const Shot& shot, const Light& light, std::size_t i) {
  constexpr std::uint64_t kOther = 1'000'000;
  return corners_of(lit(shot.sharp, light, 1 + i + kOther)).keypoints;
}

/// How a sensor's noise depends on the exposure, and what that is to the advice.
struct NoiseLaw {
  const char* name;
  NoiseShares shares;
  double noise_at(double noise, TimeNs exposure_ns) const {
    const double shorter = static_cast<double>(kNoiseOfNs) / static_cast<double>(exposure_ns);
    return noise * std::sqrt(shares.constant + shares.photons * shorter + shares.reading * shorter * shorter);
  }
  static constexpr TimeNs kNoiseOfNs = 10'000'000;  ///< the lights' noise is that of this exposure
};

/// What was measured of the frames of one law, light and shake.
struct ExposureCase {
  std::map<TimeNs, Counts> by_exposure;
  std::vector<ExposureTerms> terms;  ///< of the frames exposed for kNoiseOfNs

  /// Between exposures linear over the logarithm; beyond them the last one's.
  double share_at(TimeNs exposure_ns) const {
    const auto after = by_exposure.lower_bound(exposure_ns);
    if (after == by_exposure.end()) return std::prev(after)->second.share();
    if (after == by_exposure.begin()) return after->second.share();
    const auto before = std::prev(after);
    const double part = std::log(static_cast<double>(exposure_ns) / static_cast<double>(before->first)) /
                        std::log(static_cast<double>(after->first) / static_cast<double>(before->first));
    return before->second.share() + part * (after->second.share() - before->second.share());
  }
};

/// By law, light and shake (index of each).
using ExposureCases = std::map<std::tuple<std::size_t, std::size_t, std::size_t>, ExposureCase>;

constexpr std::array<double, 2> kShakes{1, 0.3};
const std::vector<NoiseLaw> kLaws{{"falls with light", {1, 0, 0}}, {"stays", {0, 0, 1}}};

/// Deblurs a shot in every light, with the noise of either law, and counts.
void count_exposure(const Shot& shot, TimeNs exposure_ns, std::size_t view, std::size_t shake, ExposureCases* cases) {
  for (std::size_t law = 0; law < kLaws.size(); ++law) {
    for (std::size_t i = 0; i < kLights.size(); ++i) {
      Light light = kLights[i];
      light.noise = kLaws[law].noise_at(light.noise, exposure_ns);
      const cv::Mat blurred = lit(shot.blurred, light, 1 + view);
      const PipelineResult result = deblur(blurred, shot);
      const Features moved = rectified(corners_of(result.image.empty() ? blurred : result.image), result.field, shot);
      const std::vector<cv::KeyPoint> sharp = sharp_corners(shot, light, view);
      ExposureCase& of_case = (*cases)[{law, i, shake}];
      Counts& counts = of_case.by_exposure[exposure_ns];
      counts.corners += static_cast<double>(moved.keypoints.size());
      counts.repeated +=
          static_cast<double>(std::count_if(moved.keypoints.begin(), moved.keypoints.end(),
                                            [&](const cv::KeyPoint& corner) { return is_repeated(corner, sharp); }));
      if (exposure_ns != NoiseLaw::kNoiseOfNs) continue;
      auto terms = exposure_terms(result.field, assess_quality(result.field), BlurFieldOptions());
      if (!terms) continue;
      terms->noise = kLaws[law].shares;
      of_case.terms.push_back(*terms);
    }
  }
}

/// The exposures that the advice names, from frames of one exposure, and what was measured at all of them.
void run_exposures(const Arguments& arguments) {
  const std::vector<TimeNs> exposures_ns{1'000'000,  2'000'000,  5'000'000, 10'000'000,
                                         20'000'000, 30'000'000, 50'000'000};
  const std::vector<sim::TraceSample> trace = load_hand_shake(arguments.data);
  std::string source;
  const std::vector<ImagePair> photographs = load_pairs(arguments.data, source);
  const std::vector<View> views = random_views(arguments.seed, trace.back().t_s);
  ExposureCases cases;
  Progress progress(kShakes.size() * exposures_ns.size(), "exposures", arguments.quiet);
  std::size_t done = 0;
  for (std::size_t shake = 0; shake < kShakes.size(); ++shake) {
    for (const TimeNs exposure_ns : exposures_ns) {
      for (std::size_t view = 0; view < views.size(); view += 2) {
        const Shot shot = take_shot(kVga, trace, kShakes[shake], exposure_ns, views[view], photographs);
        count_exposure(shot, exposure_ns, view, shake, &cases);
      }
      progress.done(++done);
    }
  }

  std::vector<std::string> header{"noise", "light", "shake", "speed [px/s]"};
  for (const TimeNs exposure_ns : exposures_ns) header.push_back(text_of(to_seconds(exposure_ns) * 1e3, 0) + " ms");
  for (const char* name : {"best of them [ms]", "best advised [ms]", "longest advised [ms]", "expected there",
                           "measured there", "of the best measured"}) {
    header.emplace_back(name);
  }
  ResultTable table(header);
  for (const auto& [key, of_case] : cases) {
    const auto& [law, light, shake] = key;
    std::vector<ExposureTerms> terms = of_case.terms;
    std::sort(terms.begin(), terms.end(),
              [](const ExposureTerms& a, const ExposureTerms& b) { return a.speed_px_s < b.speed_px_s; });
    std::vector<std::string> row{kLaws[law].name, kLights[light].name, "x" + text_of(kShakes[shake], 1)};
    if (terms.empty()) continue;  // nothing is known of its noise or contrast
    const ExposureTerms& typical = terms[terms.size() / 2];
    row.push_back(text_of(typical.speed_px_s, 0));
    double most = 0;
    TimeNs best_ns = 0;
    for (const auto& [exposure_ns, counts] : of_case.by_exposure) {
      row.push_back(text_of(counts.share(), 2));
      if (counts.share() > most) most = counts.share(), best_ns = exposure_ns;
    }
    row.push_back(text_of(to_seconds(best_ns) * 1e3, 0));
    const auto advice = advise_exposure(typical, 1'000'000'000);
    if (!advice) {
      row.insert(row.end(), {"-", "-", "-", "-", "-"});
    } else {
      const double there = of_case.share_at(advice->longest_ns);
      row.insert(row.end(),
                 {text_of(to_seconds(advice->best_ns) * 1e3, 1), text_of(to_seconds(advice->longest_ns) * 1e3, 1),
                  text_of(expected_repeatability_at(typical, advice->longest_ns), 2), text_of(there, 2),
                  text_of(there / most, 2)});
    }
    table.add(row);
  }
  std::printf("Photographs: %s.\n%s", source.c_str(), table.markdown().c_str());
  if (arguments.output.empty()) return;
  std::filesystem::create_directories(arguments.output);
  table.write(arguments.output, "image_quality_exposures");
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
            const cv::Mat blurred = lit(shot.blurred, kLights[light], 1 + i);
            const std::vector<cv::KeyPoint> sharp = sharp_corners(shot, kLights[light], i);
            const PipelineResult result = deblur(blurred, shot);
            FrameBlur as_it_arrived = as_blurred(result.field);
            for (const bool deblurred : {false, true}) {
              frames.push_back(count(deblurred && !result.image.empty() ? result.image : blurred,
                                     deblurred ? result.field : as_it_arrived, shot, sharp, light, &bins));
              frames.back().camera = camera.name;
              frames.back().what = deblurred ? "deblurred" : "blurred";
              if (!deblurred) frames.back().grade = "-";  // it has no status of its own
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
  ResultTable all({"camera", "image", "grade", "noise over contrast", "extent [px]", "score", "repeated"});
  for (const Frame& frame : frames) {
    all.add({frame.camera, frame.what, frame.grade, text_of(frame.noise_to_contrast, 3), text_of(frame.extent_px, 1),
             text_of(frame.score, 3), text_of(frame.measured, 3)});
  }
  all.write(arguments.output, "image_quality_frames");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"Whether the score of an image says how many of its corners are those of a sharp one.",
                  "image_quality"};
  app.add_option("--out", arguments.output, "folder for the tables");
  app.add_option("--data", arguments.data, "recorded data, with handshake_gyro/");
  app.add_option("--seed", arguments.seed, "of the times and views [1]");
  app.add_flag("--quick", arguments.quick, "eight views of one camera, at one strength");
  app.add_flag("--exposures", arguments.exposures,
               "compare exposures that are advised with those of which most corners come back, instead");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { arguments.exposures ? run_exposures(arguments) : run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
