// compare_tracks: corners followed by Lucas-Kanade through sharp, blurred and deblurred images of a simulated camera,
// against its truth.
//
// Part 1: constant shake with a median blur of 5, 10, 20 and 40 px. Part 2: a sequence that goes from sharp to blurred
// and back; SIFT and ORB matches between the sharp image before the shake and those within, and tracks across it.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <limits>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <yaml-cpp/yaml.h>
#include <opencv2/features2d.hpp>

#include "base/median.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "lk_tracker.hpp"
#include "sim/scene.hpp"
#include "sim/simulator.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

using sim::Simulator;

/// A track or match that is further from the truth counts as lost or wrong. The usual limit of the matching
/// literature is 3 to 5 px.
constexpr double kCorrectPx = 3;
constexpr double kRatioTest = 0.8;  // Lowe 2004

struct Arguments {
  int frames = 40;
  int scenes = 4;
  std::vector<double> extents_px{5, 10, 20, 40};
  double noise_to_signal_ratio = FilterOptions{}.noise_to_signal_ratio;
  double noise = 1.5;
  std::vector<int> borders_px{TrackerOptions{}.border_px};
  std::string csv;
};

/// 752x480 at 20 Hz, 30 ms exposures, 15 ms readout, a distorting lens; a wall 2 m away.
/// @param amplitude  of the shake; the median blur is about 40 px at 1
/// @param scene      0, 1, ...: each has its own texture, noise and phases of the shake
Simulator shaken_camera(double amplitude, int frames, double noise, const std::string& window, int scene = 0) {
  std::ostringstream yaml;
  yaml << "frames: " << frames << "\nseed: " << 5 + scene << "\n"
       << "camera: {size: [752, 480], intrinsics: [458.7, 457.3, 367.2, 248.4], distortion_model: plumb_bob,\n"
       << "  distortion_coefficients: [-0.2834, 0.0740, 0.0002, 0.0000176], fps: 20, exposure_time: 0.030,\n"
       << "  readout_time: 0.015, noise: " << noise << "}\n"
       << "imu: {rate: 200, gyro_noise: 0.003, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}\n"
       << "planes: [{texture: procedural, texture_seed: " << 11 + scene
       << ", texture_size: [3600, 2800], size: [10.8, 8.4], "
       << "position: [0, 0, 2]}]\n"
       << "motion:\n  type: curve\n  rotation:\n    sines:\n"
       << "      - {amplitude: [" << 6 * amplitude << ", " << 14 * amplitude << ", " << 2 * amplitude
       << "], frequency: 2.1, phase: " << 20 + 70 * scene << window << "}\n"
       << "      - {amplitude: [" << 7 * amplitude << ", " << -3 * amplitude << ", " << 3 * amplitude
       << "], frequency: 2.7, phase: " << 100 + 130 * scene << window << "}\n"
       << "  position:\n    sines:\n      - {amplitude: [0.03, 0.02, 0.01], frequency: 0.7}\n";
  return Simulator(sim::parse_scene(YAML::Load(yaml.str()), "", "compare_tracks"));
}

double median_extent_px(const Simulator& simulator) {
  std::vector<double> extents;
  for (int i = 0; i < simulator.frames(); ++i) {
    for (double y = 40; y < 480; y += 80) {
      for (double x = 47; x < 752; x += 94) extents.push_back(simulator.truth_displacement(i, {x, y}).norm());
    }
  }
  return median(extents);
}

RotationTrack rotation_of(const Simulator& simulator) {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu()) samples.push_back({s.t_ns, s.rate_rad_s});
  GyroOptions options;
  options.time_offset_ns = simulator.scene().imu.time_offset_ns;
  return RotationTrack(samples, options, simulator.scene().imu.R_cam_imu);
}

/// Pixel in frame `to` of what a pixel of frame `from` shows; NaN outside of the image.
Eigen::Vector2d truth(const Simulator& simulator, int from, const Eigen::Vector2d& pixel_px, int to) {
  const RowExposure exposure = simulator.exposure(to);
  const CameraCalibration& camera = simulator.camera().calibration();
  double row = pixel_px.y();
  Eigen::Vector2d at_px = pixel_px;
  for (int iteration = 0; iteration < 8; ++iteration) {
    at_px = simulator.truth_rectified(from, pixel_px, exposure.middle(row));
    if (!at_px.allFinite()) return at_px;
    row = std::clamp(at_px.y(), 0.0, camera.height_px - 1.0);
  }
  const bool inside =
      at_px.x() >= 0 && at_px.y() >= 0 && at_px.x() <= camera.width_px - 1 && at_px.y() <= camera.height_px - 1;
  return inside ? at_px : Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
}

/// The three versions of every frame.
struct Footage {
  std::vector<cv::Mat> sharp, blurred, deblurred;
};

Footage render(Simulator& simulator, const RotationTrack& rotation, double noise_to_signal_ratio) {
  PipelineOptions options;
  options.filter.noise_to_signal_ratio = noise_to_signal_ratio;
  Pipeline pipeline(options);
  pipeline.set_calibration(simulator.camera().calibration());
  Footage footage;
  cv::RNG rng(3);
  for (int i = 0; i < simulator.frames(); ++i) {
    cv::Mat sharp = simulator.sharp(i), noise(sharp.size(), CV_16S);
    rng.fill(noise, cv::RNG::NORMAL, 0, simulator.scene().camera.noise);
    cv::add(sharp, noise, sharp, cv::noArray(), CV_8U);
    footage.sharp.push_back(sharp);
    footage.blurred.push_back(simulator.frame(i).image);
    const cv::Mat result =
        pipeline.process(footage.blurred.back(), simulator.layout(), rotation, simulator.exposure(i), {true, false})
            .image;
    footage.deblurred.push_back(result.empty() ? footage.blurred.back() : result);
    std::fprintf(stderr, "\r%d / %d frames", i + 1, simulator.frames());
  }
  std::fprintf(stderr, "\r\033[K");
  return footage;
}

//// What became of the corners of one sequence or more.
struct TrackScore {
  std::vector<double> errors_px;  ///< of all corners in all images, against what they were in their first
  std::size_t could_survive = 0;  ///< correct corners whose place is in view one image later
  std::size_t survived = 0;       ///< of them: still there, and correct
  std::size_t corners = 0;
  double length_sum = 0;   ///< over corners: images for which it is followed correctly
  double in_view_sum = 0;  ///< over corners: that, as a part of the images until its place has left the view
  int steps = 0;           ///< from image to image

  void add(const TrackScore& other) {
    errors_px.insert(errors_px.end(), other.errors_px.begin(), other.errors_px.end());
    could_survive += other.could_survive;
    survived += other.survived;
    corners += other.corners;
    length_sum += other.length_sum;
    in_view_sum += other.in_view_sum;
    steps += other.steps;
  }
  /// NaN when nothing was tracked.
  double median_error_px() const {
    return errors_px.empty() ? std::numeric_limits<double>::quiet_NaN() : median(errors_px);
  }
  double survival() const { return static_cast<double>(survived) / static_cast<double>(could_survive); }
  double mean_length() const { return length_sum / static_cast<double>(corners); }
  double part_of_view() const { return in_view_sum / static_cast<double>(corners); }
  /// Corners followed from an earlier image, and correct.
  double correct_per_frame() const { return static_cast<double>(survived) / steps; }
};

struct Birth {
  int frame;
  Eigen::Vector2d pixel_px;
  int correct_until;  // newest frame in which it was correct, without a break
};

/// Corners of every frame, and which of them are correct.
struct Tracked {
  TrackScore score;
  std::vector<std::set<std::int32_t>> correct;  // ids by frame
};

Tracked follow(const Simulator& simulator, const RotationTrack& rotation, const std::vector<cv::Mat>& images,
               const TrackerOptions& options = {}) {
  experiments::LkTracker tracker(options);
  std::map<std::int32_t, Birth> births;
  Tracked result;
  TrackScore& score = result.score;
  for (int i = 0; i < simulator.frames(); ++i) {
    const std::size_t n = static_cast<std::size_t>(i);
    std::set<std::int32_t> correct;
    for (const Track& track : tracker.track(images[n], simulator.camera(), rotation, simulator.exposure(i))) {
      const auto [birth, is_new] = births.insert({track.id, {i, track.pixel_px, i}});
      if (!is_new) {
        const double error_px =
            (track.pixel_px - truth(simulator, birth->second.frame, birth->second.pixel_px, i)).norm();
        // Beyond the image there is no truth: a corner that is followed there is wrong.
        score.errors_px.push_back(std::isfinite(error_px) ? error_px : simulator.camera().calibration().width_px);
        if (!(error_px <= kCorrectPx) || birth->second.correct_until != i - 1) continue;
        birth->second.correct_until = i;
      }
      correct.insert(track.id);
    }
    if (i > 0) {
      for (const std::int32_t id : result.correct.back()) {
        const Birth& birth = births.at(id);
        if (!truth(simulator, birth.frame, birth.pixel_px, i).allFinite()) continue;  // left the view
        ++score.could_survive;
        score.survived += correct.count(id);
      }
    }
    result.correct.push_back(std::move(correct));
  }
  score.steps = simulator.frames() - 1;
  score.corners = births.size();
  for (const auto& [id, birth] : births) {
    const int length = birth.correct_until - birth.frame + 1;
    int end = birth.correct_until + 1;  // it was in view until here
    while (end < simulator.frames() && truth(simulator, birth.frame, birth.pixel_px, end).allFinite()) ++end;
    score.length_sum += length;
    score.in_view_sum += static_cast<double>(length) / (end - birth.frame);
  }
  return result;
}

/// Correct matches of `from` in `to` by ratio test and truth.
std::size_t correct_matches(const Simulator& simulator, const Features& from, int from_frame, const Features& to,
                            int to_frame) {
  if (from.keypoints.empty() || to.keypoints.size() < 2) return 0;
  const cv::BFMatcher matcher(from.descriptors.depth() == CV_32F ? cv::NORM_L2 : cv::NORM_HAMMING);
  std::vector<std::vector<cv::DMatch>> candidates;
  matcher.knnMatch(from.descriptors, to.descriptors, candidates, 2);
  std::size_t correct = 0;
  for (const std::vector<cv::DMatch>& pair : candidates) {
    if (pair.size() < 2 || pair[0].distance >= kRatioTest * pair[1].distance) continue;
    const cv::Point2f a = from.keypoints[static_cast<std::size_t>(pair[0].queryIdx)].pt;
    const cv::Point2f b = to.keypoints[static_cast<std::size_t>(pair[0].trainIdx)].pt;
    const Eigen::Vector2d goal = truth(simulator, from_frame, {a.x, a.y}, to_frame);
    if ((goal - Eigen::Vector2d(b.x, b.y)).norm() <= kCorrectPx) ++correct;
  }
  return correct;
}

/// The versions of the images, in the order of the tables.
constexpr const char* kVersions[] = {"sharp", "blurred", "deblurred"};
using Scores = std::array<TrackScore, 3>;

struct Measure {
  const char* name;
  double (TrackScore::*value)() const;
  double factor;         // of the printed value
  const char* format;    // of a value
  const char* decimals;  // of a difference and its error
};
constexpr Measure kMeasures[] = {
    {"median error", &TrackScore::median_error_px, 1, "%.2f px", "%+.3f +- %.3f px"},
    {"survival", &TrackScore::survival, 100, "%.2f %%", "%+.2f +- %.2f %%"},
    {"of its time in view", &TrackScore::part_of_view, 100, "%.1f %%", "%+.1f +- %.1f %%"},
    {"correct length", &TrackScore::mean_length, 1, "%.1f", "%+.2f +- %.2f"},
    {"correct corners a frame", &TrackScore::correct_per_frame, 1, "%.0f", "%+.1f +- %.1f"}};

std::string table_head(const char* second) {
  std::string names = std::string("| blur (median) | ") + second, line = "| --- | ---";
  for (const Measure& measure : kMeasures) {
    names += std::string(" | ") + measure.name;
    line += " | ---";
  }
  return names + " |\n" + line + " |\n";
}

/// The table of all corners, and that of the differences scene by scene, which shows what is chance.
void print_tables(const std::map<double, std::vector<Scores>>& scenes_by_extent) {
  std::cout << table_head("images");
  for (const auto& [extent_px, scenes] : scenes_by_extent) {
    for (std::size_t v = 0; v < 3; ++v) {
      TrackScore all;
      for (const Scores& scores : scenes) all.add(scores[v]);
      std::cout << cv::format("| %.0f px | %s", extent_px, kVersions[v]);
      for (const Measure& measure : kMeasures) {
        std::cout << " | " << cv::format(measure.format, measure.factor * (all.*measure.value)());
      }
      std::cout << " |\n";
    }
  }
  std::cout << "\nDeblurred less blurred, mean over the scenes and its standard error:\n\n" << table_head("scenes");
  for (const auto& [extent_px, scenes] : scenes_by_extent) {
    std::cout << cv::format("| %.0f px | %zu", extent_px, scenes.size());
    for (const Measure& measure : kMeasures) {
      double sum = 0, squares = 0;
      for (const Scores& scores : scenes) {
        const double gain = measure.factor * ((scores[2].*measure.value)() - (scores[1].*measure.value)());
        sum += gain;
        squares += gain * gain;
      }
      const auto n = static_cast<double>(scenes.size());
      const double error = std::sqrt(std::max(squares - sum * sum / n, 0.0) / (n - 1) / n);  // NaN for one scene
      std::cout << " | " << cv::format(measure.decimals, sum / n, error);
    }
    std::cout << " |\n";
  }
  std::cout << std::flush;
}

void run_constant(const Arguments& arguments, std::ostream& csv) {
  std::map<int, std::map<double, std::vector<Scores>>> scores_by_border;
  for (const double target_px : arguments.extents_px) {
    for (int scene = 0; scene < arguments.scenes; ++scene) {
      const double probe_px = median_extent_px(shaken_camera(target_px / 40, arguments.frames, 0, "", scene));
      Simulator simulator =
          shaken_camera(target_px / 40 * target_px / probe_px, arguments.frames, arguments.noise, "", scene);
      const RotationTrack rotation = rotation_of(simulator);
      const Footage footage = render(simulator, rotation, arguments.noise_to_signal_ratio);
      const std::vector<cv::Mat>* versions[] = {&footage.sharp, &footage.blurred, &footage.deblurred};
      for (const int border_px : arguments.borders_px) {
        TrackerOptions options;
        options.border_px = border_px;
        Scores scores;
        for (std::size_t v = 0; v < 3; ++v) {
          scores[v] = follow(simulator, rotation, *versions[v], options).score;
          for (const Measure& measure : kMeasures) {
            csv << "constant," << target_px << ',' << border_px << ',' << scene << ',' << kVersions[v] << ','
                << measure.name << ',' << (scores[v].*measure.value)() << '\n';
          }
        }
        scores_by_border[border_px][target_px].push_back(std::move(scores));
      }
      std::cerr << target_px << " px, scene " << scene << " done\n";
    }
  }
  for (const auto& [border_px, scores] : scores_by_border) {
    std::cout << "\nCorners start " << border_px << " px from the edge:\n\n";
    print_tables(scores);
  }
}

void run_change(const Arguments& arguments, std::ostream& csv) {
  // Still until 0.9 s, shaken until 2.1 s, still again.
  Simulator simulator = shaken_camera(0.8, 50, arguments.noise, ", window: [0.9, 2.1]");
  const RotationTrack rotation = rotation_of(simulator);
  const Footage footage = render(simulator, rotation, arguments.noise_to_signal_ratio);
  std::vector<double> extents;
  for (int i = 0; i < simulator.frames(); ++i) extents.push_back(simulator.truth_displacement(i, {376, 240}).norm());
  constexpr double kBlurredPx = 8;  // from here on a frame counts as blurred
  int before = -1, after = -1;
  std::vector<int> within;
  for (int i = 0; i < simulator.frames(); ++i) {
    if (extents[static_cast<std::size_t>(i)] >= kBlurredPx) within.push_back(i);
  }
  if (within.empty()) throw std::runtime_error("no frame of the sequence is blurred");
  for (int i = within.front(); i >= 0 && before < 0; --i) {
    if (extents[static_cast<std::size_t>(i)] < 2) before = i;
  }
  for (int i = within.back(); i < simulator.frames() && after < 0; ++i) {
    if (extents[static_cast<std::size_t>(i)] < 2) after = i;
  }
  std::cout << "\nSharp until frame " << before << ", blurred by 8 px or more in " << within.size()
            << " frames, sharp from frame " << after << " on.\n\n"
            << "| correct across the change | blurred | deblurred | ratio |\n| --- | --- | --- | --- |\n";
  const auto report = [&csv](const std::string& what, double blurred, double deblurred) {
    char line[200];
    std::snprintf(line, sizeof(line), "| %s | %.1f | %.1f | %s |\n", what.c_str(), blurred, deblurred,
                  blurred > 0 ? cv::format("%.2f", deblurred / blurred).c_str() : "-");
    std::cout << line << std::flush;
    csv << "change,,,,blurred," << what << ',' << blurred << "\nchange,,,,deblurred," << what << ',' << deblurred
        << '\n';
  };
  for (const char* detector : {"SIFT", "ORB"}) {
    KeypointOptions options;
    options.detector = options.descriptor = detector;
    FeatureExtractor extractor(options);
    // The pipeline leaves sharp frames as they are, so that these are the same in both versions.
    const Features sharp_before = extractor.extract(footage.blurred[static_cast<std::size_t>(before)]);
    const Features sharp_after = extractor.extract(footage.blurred[static_cast<std::size_t>(after)]);
    double sums[2] = {0, 0};
    for (const int i : within) {
      const std::vector<cv::Mat>* versions[] = {&footage.blurred, &footage.deblurred};
      for (int v = 0; v < 2; ++v) {
        const Features features = extractor.extract((*versions[v])[static_cast<std::size_t>(i)]);
        sums[v] += static_cast<double>(correct_matches(simulator, sharp_before, before, features, i) +
                                       correct_matches(simulator, features, i, sharp_after, after)) /
                   (2.0 * static_cast<double>(within.size()));
      }
    }
    report(std::string(detector) + " matches with the sharp image before and after, mean of the blurred frames",
           sums[0], sums[1]);
  }
  const Tracked blurred = follow(simulator, rotation, footage.blurred);
  const Tracked deblurred = follow(simulator, rotation, footage.deblurred);
  const auto common = [](const Tracked& tracked, int a, int b) {
    std::size_t count = 0;
    for (const std::int32_t id : tracked.correct[static_cast<std::size_t>(a)]) {
      count += tracked.correct[static_cast<std::size_t>(b)].count(id);
    }
    return static_cast<double>(count);
  };
  const int middle = within[within.size() / 2];
  report("tracks from the sharp image before into the middle of the shake", common(blurred, before, middle),
         common(deblurred, before, middle));
  report("tracks from the middle of the shake into the sharp image after", common(blurred, middle, after),
         common(deblurred, middle, after));
  report("tracks from the sharp image before to the sharp image after", common(blurred, before, after),
         common(deblurred, before, after));
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  std::string part = "all";
  CommandLine app{"Tracks and matches in sharp, blurred and deblurred images of a simulated camera, against its truth.",
                  "compare_tracks"};
  app.add_option("--frames", arguments.frames, "images of each sequence of constant shake [40]").range(5, 1000);
  app.add_option("--scenes", arguments.scenes, "scenes: each has its own texture, noise and shake [4]").range(1, 100);
  app.add_option("--extents", arguments.extents_px, "median blur of the sequences, px [5 10 20 40]").range(1.0, 100.0);
  app.add_option("--noise-to-signal-ratio", arguments.noise_to_signal_ratio, "of the Wiener filter [0.01]")
      .range(1e-5, 1.0);
  app.add_option("--noise", arguments.noise, "standard deviation of each pixel, grey levels [1.5]").range(0.0, 64.0);
  app.add_option("--borders", arguments.borders_px,
                 "px from the image's edge at which corners start; a table each [32]")
      .range(0, 500);
  app.add_option("--part", part, "constant, change or all").one_of({"constant", "change", "all"});
  app.add_option("--csv", arguments.csv, "also write every number to this file");
  return run_tool(app, argc, argv, [&] {
    std::ostringstream csv;
    csv << "part,extent_px,border_px,scene,images,measure,value\n";
    if (part != "change") run_constant(arguments, csv);
    if (part != "constant") run_change(arguments, csv);
    if (!arguments.csv.empty()) write_text(arguments.csv, csv.str());
  });
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
