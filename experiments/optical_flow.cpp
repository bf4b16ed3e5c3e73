// What optical flow measures of the motion that the gyroscope does not, on recorded flights through a simulated room.
// Writes the tables of doc/reports/optical_flow.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "apparent_place.hpp"
#include "displacement_errors.hpp"
#include "feature_gain.hpp"
#include "footage.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "moving_object.hpp"
#include "recorded_burst.hpp"
#include "result_table.hpp"
#include "shutter_errors.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  std::vector<std::string> parts;
  double seconds = 4;
  bool quick = false, quiet = false;
};

std::vector<double> of(const std::vector<BlockErrors>& errors, double BlockErrors::*value) {
  std::vector<double> values;
  for (const BlockErrors& e : errors) {
    if (!std::isnan(e.*value)) values.push_back(e.*value);
  }
  return values;
}

std::string median_and_p90(const std::vector<double>& values) {
  return text_of(quantile(values, 0.5), 2) + " / " + text_of(quantile(values, 0.9), 2);
}

std::string used_share(const std::vector<BlockErrors>& errors) {
  const auto used = std::count_if(errors.begin(), errors.end(), [](const BlockErrors& e) { return e.from_images; });
  return text_of(100.0 * static_cast<double>(used) / static_cast<double>(errors.size()), 1);
}

std::string conditions(const FootageCase& c, const Light& light) {
  return c.conditions() + (light.name[0] == 0 ? "" : std::string(", ") + light.name);
}

/// Frames in which the images' median is worse than the gyroscope's by more than a limit.
int worse_frames(const std::vector<BlockErrors>& errors, int* frames) {
  constexpr double kLimitPx = 0.2;
  int worse = 0;
  *frames = 0;
  for (std::size_t begin = 0, end; begin < errors.size(); begin = end) {
    std::vector<double> alone, images;
    for (end = begin; end < errors.size() && errors[end].frame == errors[begin].frame; ++end) {
      alone.push_back(errors[end].residual_px);
      images.push_back(errors[end].images_px);
    }
    ++*frames;
    if (quantile(images, 0.5) > quantile(alone, 0.5) + kLimitPx) ++worse;
  }
  return worse;
}

class Study {
 public:
  explicit Study(const Arguments& arguments) : arguments_(arguments) {}

  void run();

 private:
  bool asked(const std::string& part) const {
    return arguments_.parts.empty() ||
           std::find(arguments_.parts.begin(), arguments_.parts.end(), part) != arguments_.parts.end();
  }
  void displacement(const FootageCase& c, const Footage& footage, const Light& light);
  void wrong_bias(const FootageCase& c, const Footage& footage);
  void held(const FootageCase& c, const Footage& footage, const Light& light);
  void hardship(const char* what, const FootageCase& c, const Sequence& sequence);
  void dropped(const FootageCase& c, const Footage& footage);
  void features(const FootageCase& c, Footage* footage, const Light& light);
  void shutter(const FootageCase& c, const Footage& footage, const Light& light);
  void straight_edges(const test::RecordedFlight& flight, const Footage& footage) const;
  void shown();
  void objects(const FootageCase& c, const Footage& footage);
  void burst();
  std::vector<std::function<void()>> flight_steps(const test::RecordedFlight& flight);
  void write() const;

  Arguments arguments_;
  ResultTable displacement_{{"flight", "conditions", "gyroscope alone [px]", "true velocity, median depth [px]",
                             "images, no accelerometer [px]", "images [px]", "error / standard deviation",
                             "blocks by images [%]"}};
  std::string samples_ = "flight,conditions,residual_px,velocity_px,images_px\n";
  ResultTable held_{{"flight", "camera", "conditions", "change, p99 [px]", "largest [px]", "blocks by images [%]",
                     "frames altered by the images"}};
  ResultTable bias_{{"flight", "camera", "gyroscope alone [px]", "images [px]", "blocks by images [%]"}};
  ResultTable hardship_{{"flight", "what", "gyroscope alone [px]", "images [px]", "blocks by images [%]",
                         "frames worse by more than 0.2 px"}};
  ResultTable features_{{"flight", "conditions", "tracks: blurred, rotation, images, truth", "SIFT", "ORB",
                         "images' share of the truth's gain: tracks, SIFT, ORB [%]"}};
  std::array<FeatureCounts, 4> all_features_;
  ResultTable shown_{{"extent [px]", "slope of measured over said", "over the path's mean", "over the chord's middle",
                      "largest error of what is said [px]"}};
  ResultTable objects_{{"flight", "object", "blocks of the", "deblurred by", "blocks", "error of the displacement [px]",
                        "deblurred, 3 px or more off", "left, though blurred by 3 px or more"}};
  ResultTable burst_{{"frame", "extent by the gyroscope [px]", "with images, times that: median", "quartiles",
                      "blocks by images [%]", "blocks deblurred: gyroscope, images",
                      "SIFT keypoints: blurred, gyroscope, images",
                      "matches with the frame before: blurred, gyroscope, images"}};
  ResultTable shutter_{{"flight", "conditions", "as it arrived [px]", "rotation [px]", "images [px]", "truth [px]"}};
};

void Study::displacement(const FootageCase& c, const Footage& footage, const Light& light) {
  const auto errors = displacement_errors(all_frames(footage), light, footage.rotation());
  const auto without = displacement_errors(all_frames(footage), light, footage.rotation(0, false));
  displacement_.add({c.flight.name, conditions(c, light), median_and_p90(of(errors, &BlockErrors::residual_px)),
                     median_and_p90(of(errors, &BlockErrors::velocity_px)),
                     median_and_p90(of(without, &BlockErrors::images_px)),
                     median_and_p90(of(errors, &BlockErrors::images_px)),
                     median_and_p90(of(errors, &BlockErrors::normalized)), used_share(errors)});
  constexpr std::size_t kEvery = 7;  // no divisor of the number of blocks of a row or a frame
  for (std::size_t k = 0; k < errors.size(); k += kEvery) {
    samples_ += std::string(c.flight.name) + ",\"" + conditions(c, light) + "\"," + text_of(errors[k].residual_px, 3) +
                "," + text_of(errors[k].velocity_px, 3) + "," + text_of(errors[k].images_px, 3) + "\n";
  }
}

void Study::wrong_bias(const FootageCase& c, const Footage& footage) {
  constexpr double kBiasRadS = 0.05;
  const auto errors = displacement_errors(all_frames(footage), kDaylight, footage.rotation(kBiasRadS));
  bias_.add({c.flight.name, c.path == CameraPath::ROTATING ? "rotates" : "flies",
             median_and_p90(of(errors, &BlockErrors::residual_px)), median_and_p90(of(errors, &BlockErrors::images_px)),
             used_share(errors)});
}

void Study::held(const FootageCase& c, const Footage& footage, const Light& light) {
  const RotationTrack rotation = footage.rotation();
  const auto errors = displacement_errors(all_frames(footage), light, rotation);
  PipelineOptions with, without;
  without.optical_flow = false;
  Pipeline images(with), alone(without);
  PipelineRequest request;
  request.keypoints = false;
  int altered = 0;
  for (Pipeline* pipeline : {&images, &alone}) pipeline->set_calibration(footage.camera().calibration());
  for (int i = 0; i < footage.frames(); ++i) {
    const cv::Mat image = footage.image(i, light);
    std::vector<cv::Mat> shown;
    for (Pipeline* pipeline : {&images, &alone}) {
      const cv::Mat deblurred =
          pipeline->process(image, PixelLayout::GRAY, rotation, footage.exposure(i), request).image;
      shown.push_back(deblurred.empty() ? image : deblurred);
    }
    if (cv::norm(shown[0], shown[1], cv::NORM_INF) != 0) ++altered;
  }
  const std::vector<double> changes = of(errors, &BlockErrors::change_px);
  held_.add({c.flight.name, c.path == CameraPath::ROTATING ? "rotates" : "rests", conditions(c, light),
             text_of(quantile(changes, 0.99), 2), text_of(quantile(changes, 1), 2), used_share(errors),
             std::to_string(altered) + " of " + std::to_string(footage.frames())});
}

void Study::hardship(const char* what, const FootageCase& c, const Sequence& sequence) {
  const auto errors = displacement_errors(sequence, kDaylight, sequence.of_frame.front()->rotation());
  int frames = 0;
  const int worse = worse_frames(errors, &frames);
  hardship_.add({c.flight.name, what, median_and_p90(of(errors, &BlockErrors::residual_px)),
                 median_and_p90(of(errors, &BlockErrors::images_px)), used_share(errors),
                 std::to_string(worse) + " of " + std::to_string(frames)});
}

void Study::dropped(const FootageCase& c, const Footage& footage) {
  constexpr double kShare = 0.1;
  constexpr std::uint64_t kSeed = 5;
  cv::RNG rng(kSeed);
  Sequence kept;
  for (int i = 0; i < footage.frames(); ++i) {
    if (rng.uniform(0.0, 1.0) < kShare) continue;
    kept.frames.push_back(i);
    kept.of_frame.push_back(&footage);
  }
  hardship("one frame in ten lost", c, kept);
}

std::string gain_share(const std::array<FeatureCounts, 4>& counts, double FeatureCounts::*count) {
  constexpr double kLeastGain = 0.03;  // of what the blurred frames have; less is chance
  const double blurred = counts[0].*count, images = counts[2].*count, truth = counts[3].*count;
  if (truth < (1 + kLeastGain) * blurred) return "-";
  return text_of(100 * (images - blurred) / (truth - blurred), 0);
}

std::vector<std::string> feature_cells(const std::array<FeatureCounts, 4>& counts) {
  std::vector<std::string> cells;
  std::string shares;
  for (double FeatureCounts::*count : {&FeatureCounts::tracks, &FeatureCounts::sift, &FeatureCounts::orb}) {
    std::string cell;
    for (const FeatureCounts& of_knowledge : counts)
      cell += (cell.empty() ? "" : ", ") + text_of(of_knowledge.*count, 0);
    cells.push_back(cell);
    shares += (shares.empty() ? "" : ", ") + gain_share(counts, count);
  }
  cells.push_back(shares);
  return cells;
}

void Study::features(const FootageCase& c, Footage* footage, const Light& light) {
  constexpr int kStep = 4;
  const auto counts = feature_counts(*footage, light, kStep);
  std::vector<std::string> row = {c.flight.name, conditions(c, light)};
  for (std::string& cell : feature_cells(counts)) row.push_back(std::move(cell));
  features_.add(row);
  for (std::size_t k = 0; k < counts.size(); ++k) {
    all_features_[k].tracks += counts[k].tracks;
    all_features_[k].sift += counts[k].sift;
    all_features_[k].orb += counts[k].orb;
  }
}

void Study::shutter(const FootageCase& c, const Footage& footage, const Light& light) {
  std::vector<std::string> row = {c.flight.name, conditions(c, light)};
  for (const std::vector<double>& distances : shutter_errors(footage, light)) row.push_back(median_and_p90(distances));
  shutter_.add(row);
}

void Study::straight_edges(const test::RecordedFlight& flight, const Footage& footage) const {
  const CurvedFrame curved = most_curved_frame(footage);
  const std::string start = arguments_.output + "/shutter_" + std::filesystem::path(flight.file).stem().string() + "_";
  cv::imwrite(start + "arrived.png", curved.arrived);
  cv::imwrite(start + "global.png", curved.global_shutter);
}

void Study::shown() {
  const std::vector<ApparentPlace> places = apparent_places(arguments_.quick ? 1 : 2);
  for (std::size_t begin = 0; begin < places.size(); ++begin) {
    const double extent_px = places[begin].extent_px;
    const auto is_of_extent = [&](const ApparentPlace& p) { return p.extent_px == extent_px; };
    if (std::any_of(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(begin), is_of_extent)) continue;
    std::vector<double> measured, said, mean, chord;
    double largest = 0;
    for (const ApparentPlace& p : places) {
      if (!is_of_extent(p)) continue;
      measured.push_back(p.measured_px);
      said.push_back(p.said_px);
      mean.push_back(p.mean_place_px);
      chord.push_back(p.chord_middle_px);
      largest = std::max(largest, std::abs(p.measured_px - p.said_px));
    }
    shown_.add({text_of(extent_px, 0), text_of(slope(said, measured), 2), text_of(slope(mean, measured), 2),
                text_of(slope(chord, measured), 2), text_of(largest, 2)});
  }
}

void Study::objects(const FootageCase& c, const Footage& footage) {
  const cv::Point2d kCrossing(300, 60);  // px/s: 9 px within an exposure
  for (const auto& [name, velocity_px_s] : {std::pair("panned", cv::Point2d(0, 0)), std::pair("crosses", kCrossing)}) {
    const ObjectScene scene = film_object(footage, velocity_px_s);
    for (const auto part : {&ObjectResult::object, &ObjectResult::surroundings}) {
      for (const auto& [by, result] : {std::pair("gyroscope", &scene.alone), std::pair("images", &scene.images)}) {
        const BlockCounts& counts = result->*part;
        objects_.add({c.flight.name, name, part == &ObjectResult::object ? "object" : "surroundings", by,
                      std::to_string(counts.blocks), median_and_p90(counts.errors_px), std::to_string(counts.wrong),
                      std::to_string(counts.left) + " of " + std::to_string(counts.blurred)});
      }
    }
    if (arguments_.output.empty()) continue;
    const std::string start =
        arguments_.output + "/object_" + name + "_" + std::filesystem::path(c.flight.file).stem().string() + "_";
    cv::imwrite(start + "blurred.png", scene.blurred);
    cv::imwrite(start + "gyroscope.png", scene.alone.shown);
    cv::imwrite(start + "images.png", scene.images.shown);
  }
}

void Study::burst() {
  const auto three = [](int a, int b, int c) {
    return std::to_string(a) + ", " + std::to_string(b) + ", " + std::to_string(c);
  };
  for (const BurstFrame& f :
       burst_frames(arguments_.data + "/shield_burst", GYRO_DEBLUR_CONFIG_DIR "/recordings/shield_burst.yaml")) {
    burst_.add({std::to_string(f.number), text_of(f.extent_px, 0), text_of(f.ratio_median, 2),
                text_of(f.ratio_low, 2) + " to " + text_of(f.ratio_high, 2), text_of(100 * f.from_images, 0),
                std::to_string(f.deblurred_alone) + ", " + std::to_string(f.deblurred_images),
                three(f.keypoints_blurred, f.keypoints_alone, f.keypoints_images),
                three(f.matches_blurred, f.matches_alone, f.matches_images)});
  }
}

std::vector<std::function<void()>> Study::flight_steps(const test::RecordedFlight& flight) {
  const double seconds = arguments_.quick ? std::min(arguments_.seconds, 0.5) : arguments_.seconds;
  const double few_seconds = std::min(seconds, 2.0);
  constexpr TimeNs kLongNs = 30'000'000, kShortNs = 15'000'000, kReadoutNs = 20'000'000;
  constexpr double kFast = 1.7;
  const bool moving = asked("displacement");
  std::vector<std::function<void()>> steps;
  const auto film = [&arguments = arguments_](const FootageCase& c, double s) { return Footage(c, arguments.data, s); };
  const FootageCase normal{flight, kLongNs};
  steps.push_back([=] {
    if (!moving && !asked("bias") && !asked("hardship") && !asked("features")) return;
    Footage footage = film(normal, seconds);
    if (moving) displacement(normal, footage, kDaylight), displacement(normal, footage, kLowLight);
    if (asked("features")) features(normal, &footage, kDaylight), features(normal, &footage, kLowLight);
    if (asked("bias")) wrong_bias(normal, footage);
    if (!asked("hardship")) return;
    dropped(normal, footage);
    FootageCase other = normal;
    other.first_photograph = 4;
    const Footage elsewhere = film(other, seconds);
    constexpr int kScene = 10;  // frames
    Sequence cut = all_frames(footage);
    for (int i = 0; i < footage.frames(); ++i) {
      if (i / kScene % 2 == 1) cut.of_frame[i] = &elsewhere;
    }
    hardship("another scene every ten frames", normal, cut);
  });
  steps.push_back([=] {
    const FootageCase c{flight, kShortNs};
    if (moving) displacement(c, film(c, seconds), kDaylight);
  });
  steps.push_back([=] {
    const FootageCase c{flight, kLongNs, kReadoutNs};
    if (!moving && !asked("shutter")) return;
    const Footage footage = film(c, seconds);
    if (moving) displacement(c, footage, kDaylight);
    if (!asked("shutter")) return;
    shutter(c, footage, kDaylight), shutter(c, footage, kLowLight);
    if (arguments_.output.empty()) return;
    const FootageCase straight{flight, kShortNs, kReadoutNs, kFast, CameraPath::FLIGHT, Walls::CHECKERED};
    straight_edges(flight, film(straight, few_seconds));
  });
  steps.push_back([=] {
    const FootageCase c{flight, kLongNs, 0, kFast};
    if (!moving && !asked("features")) return;
    Footage footage = film(c, seconds);
    if (moving) displacement(c, footage, kDaylight), displacement(c, footage, kLowLight);
    if (asked("features")) features(c, &footage, kDaylight), features(c, &footage, kLowLight);
  });
  for (const CameraPath path : {CameraPath::ROTATING, CameraPath::RESTING}) {
    steps.push_back([=] {
      const FootageCase c{flight, kLongNs, 0, 1, path};
      const bool rotates = path == CameraPath::ROTATING;
      if (!asked("held") && !(rotates && (asked("objects") || asked("bias")))) return;
      const Footage footage = film(c, few_seconds);
      if (asked("held")) held(c, footage, kDaylight), held(c, footage, kLowLight);
      if (rotates && asked("bias")) wrong_bias(c, footage);
      if (rotates && asked("objects")) objects(c, footage);
    });
  }
  for (const Walls walls : {Walls::PLAIN, Walls::CHECKERED}) {
    steps.push_back([=] {
      const FootageCase c{flight, kLongNs, 0, 1, CameraPath::FLIGHT, walls};
      if (!asked("hardship")) return;
      const Footage footage = film(c, few_seconds);
      hardship(walls == Walls::PLAIN ? "walls without texture" : "checkered walls", c, all_frames(footage));
    });
  }
  return steps;
}

void Study::run() {
  if (!std::filesystem::exists(arguments_.data + "/trajectories")) {
    throw std::runtime_error("there is no " + arguments_.data + "/trajectories; see test/data/README.md");
  }
  if (!arguments_.output.empty()) std::filesystem::create_directories(arguments_.output);
  std::vector<test::RecordedFlight> flights = test::recorded_flights();
  if (arguments_.quick) flights.resize(1);
  std::vector<std::function<void()>> steps;
  if (asked("shown")) steps.emplace_back([this] { shown(); });
  if (asked("burst")) steps.emplace_back([this] { burst(); });
  for (const test::RecordedFlight& flight : flights) {
    for (std::function<void()>& step : flight_steps(flight)) steps.push_back(std::move(step));
  }
  Progress progress(steps.size(), "steps", arguments_.quiet);
  for (std::size_t k = 0; k < steps.size(); ++k) {
    steps[k]();
    progress.done(k + 1);
  }
  if (asked("features")) {
    for (FeatureCounts& sum : all_features_) {
      const auto rows = static_cast<double>(4 * flights.size());
      sum.tracks /= rows, sum.sift /= rows, sum.orb /= rows;
    }
    std::vector<std::string> row = {"all", "mean"};
    for (std::string& cell : feature_cells(all_features_)) row.push_back(std::move(cell));
    features_.add(row);
  }
  write();
}

void Study::write() const {
  const std::vector<std::pair<const char*, const ResultTable*>> tables = {
      {"displacement", &displacement_}, {"held", &held_},         {"bias", &bias_},
      {"hardship", &hardship_},         {"features", &features_}, {"shutter", &shutter_},
      {"objects", &objects_},           {"burst", &burst_},       {"shown", &shown_}};
  for (const auto& [name, table] : tables) {
    if (!asked(name)) continue;
    std::printf("%s\n", table->markdown().c_str());
    if (!arguments_.output.empty()) table->write(arguments_.output, name);
  }
  if (!arguments_.output.empty() && asked("displacement")) {
    write_text(arguments_.output + "/displacement_samples.csv", samples_);
  }
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{
      "Flies recorded trajectories through a room of photographs and compares the motion that images add to the "
      "gyroscope's with what is true.",
      "optical_flow"};
  app.add_option("--out", arguments.output, "folder for tables and samples");
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--seconds", arguments.seconds, "of each flight [4]").range(0.5, 15.0);
  app.add_option("--part", arguments.parts, "of the measurements, again for more [all]")
      .one_of({"displacement", "held", "bias", "hardship", "features", "shutter", "objects", "burst", "shown"});
  app.add_flag("--quick", arguments.quick, "half a second of one flight");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { Study(arguments).run(); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
