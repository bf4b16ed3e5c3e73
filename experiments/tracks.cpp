// How far tracks are from their scene points, frame to frame and since they were first seen, and for how long they stay
// on them: FeatureTracker on raw and on sharp images, Lucas-Kanade on blurred, deblurred and sharp ones. Of recordings,
// which have no truth, how many corners are followed and how far they are from their epipolar lines. Writes the tables
// and data of doc/reports/tracks.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <Eigen/Dense>
#include <opencv2/core.hpp>

#include "blur/frame_quality.hpp"
#include "footage.hpp"
#include "gyro_deblur/feature_tracker.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "lk_tracker.hpp"
#include "recorded_tracks.hpp"
#include "result_table.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  std::vector<std::string> recording;  // folder and description; empty: simulated flights
  double seconds = 6;
  std::vector<std::uint64_t> flights{0, 1, 2};
  std::vector<double> exposures_ms{30}, speeds{1, 1.7};
  std::vector<double> readouts_ms{0};
  bool no_low_light = false, quick = false, quiet = false;
};

/// Of the median extent of a frame's blocks [px].
const std::vector<double> kExtentBordersPx{0, 3, 6, 12, 20, 40, 1000};
/// Images since a track was first seen.
constexpr std::array<int, 3> kDriftImages{5, 10, 20};
/// An image counts to a track's length as long as it is within so much of its scene point.
constexpr double kOnPointPx = 3;
/// Farther off it is not this point any more: an outlier to any estimator.
constexpr double kLostPx = 5;

enum class Images { BLURRED, DEBLURRED, SHARP };
struct Method {
  const char* name;
  bool is_new;
  Images images;
};
const std::vector<Method> kMethods{{"FeatureTracker, blurred", true, Images::BLURRED},
                                   {"LK, blurred", false, Images::BLURRED},
                                   {"LK, deblurred", false, Images::DEBLURRED},
                                   {"FeatureTracker, sharp", true, Images::SHARP},
                                   {"LK, sharp", false, Images::SHARP}};

struct Errors {
  std::vector<double> step_px;                                    // since the image before
  std::array<std::vector<double>, kDriftImages.size()> drift_px;  // since the first
  std::vector<double> mahalanobis;                                // since the first, within kLostPx
};
/// By light, speed, method and bin of extent; the last bin has them all.
using Key = std::tuple<std::string, double, std::size_t, std::size_t>;
/// By light, speed and method: images of a track on its point.
using LengthKey = std::tuple<std::string, double, std::size_t>;

struct Study {
  std::map<Key, Errors> errors;
  std::map<LengthKey, std::vector<double>> lengths;
};

/// Compares tracks of one sequence with the truth.
class TrackEvaluator {
 public:
  TrackEvaluator(const Footage& footage, std::string light, double speed, std::size_t method, Study* study)
      : footage_(footage), light_(std::move(light)), speed_(speed), method_(method), study_(study) {}

  void add(int frame, double extent_px, const std::vector<Track>& tracks) {
    const auto border = std::upper_bound(kExtentBordersPx.begin(), kExtentBordersPx.end(), extent_px);
    const auto bin = static_cast<std::size_t>(border - kExtentBordersPx.begin()) - 1;
    std::map<std::int32_t, Seen> now;
    for (const Track& track : tracks) {
      const auto last = seen_.find(track.id);
      if (last == seen_.end()) {
        const auto point_m = footage_.truth().scene_point(frame, track.pixel_px);
        if (point_m) now[track.id] = {*point_m, track.pixel_px, 1, 1, true};
        continue;
      }
      Seen seen = last->second;
      const Eigen::Vector2d error_px = track.pixel_px - footage_.truth().pixel_of(frame, seen.point_m);
      ++seen.age;
      seen.is_on_point = seen.is_on_point && error_px.norm() < kOnPointPx;
      seen.length += seen.is_on_point ? 1 : 0;
      const auto before_m = footage_.truth().scene_point(frame - 1, seen.pixel_px);
      for (const std::size_t of : {bin, kExtentBordersPx.size() - 1}) {
        Errors& errors = study_->errors[{light_, speed_, method_, of}];
        if (before_m) {
          errors.step_px.push_back((track.pixel_px - footage_.truth().pixel_of(frame, *before_m)).norm());
        }
        for (std::size_t k = 0; k < kDriftImages.size(); ++k) {
          if (seen.age == kDriftImages[k] + 1) errors.drift_px[k].push_back(error_px.norm());
        }
        if (error_px.norm() < kLostPx && track.covariance_px2.determinant() > 0) {
          errors.mahalanobis.push_back(error_px.dot(track.covariance_px2.inverse() * error_px));
        }
      }
      seen.pixel_px = track.pixel_px;
      now[track.id] = seen;
    }
    for (const auto& [id, seen] : seen_) {
      if (now.count(id) == 0) ended(seen);
    }
    seen_ = std::move(now);
  }
  ~TrackEvaluator() {
    for (const auto& [id, seen] : seen_) ended(seen);
  }

 private:
  struct Seen {
    Eigen::Vector3d point_m;
    Eigen::Vector2d pixel_px;
    int age, length;
    bool is_on_point;
  };
  void ended(const Seen& seen) { study_->lengths[{light_, speed_, method_}].push_back(seen.length); }

  const Footage& footage_;
  std::string light_;
  double speed_;
  std::size_t method_;
  Study* study_;
  std::map<std::int32_t, Seen> seen_;
};

/// A sharp image is one of a short exposure in the middle of the blurred one's.
RowExposure sharp_exposure(const RowExposure& blurred, int rows) {
  ShutterTiming timing = blurred.timing();
  timing.exposure_ns = 2'000;
  timing.stamp_row = StampRow::FIRST;
  timing.stamp_phase = StampPhase::MIDDLE;
  return RowExposure(blurred.middle(0), rows, timing);
}

void follow(Footage* footage, const Light& light, double speed, Study* study) {
  const RotationTrack rotation = footage->rotation();
  Pipeline blurred_pipeline{PipelineOptions{}}, sharp_pipeline{PipelineOptions{}};
  blurred_pipeline.set_calibration(footage->camera().calibration());
  sharp_pipeline.set_calibration(footage->camera().calibration());
  PipelineRequest request;
  request.keypoints = request.image = false;
  request.luminance = true;
  std::vector<std::function<const std::vector<Track>&(const cv::Mat&, const RowExposure&, const FrameBlur&)>> trackers;
  std::vector<TrackEvaluator> evaluators;
  evaluators.reserve(kMethods.size());
  for (std::size_t m = 0; m < kMethods.size(); ++m) {
    if (kMethods[m].is_new) {
      const auto tracker = std::make_shared<FeatureTracker>(TrackerOptions{});
      trackers.push_back([&rotation, footage, tracker](const cv::Mat& image, const RowExposure& exposure,
                                                       const FrameBlur& field) -> const std::vector<Track>& {
        return tracker->track(image, footage->camera(), rotation, exposure, &field);
      });
    } else {
      const auto tracker = std::make_shared<LkTracker>(TrackerOptions{});
      trackers.push_back([&rotation, footage, tracker](const cv::Mat& image, const RowExposure& exposure,
                                                       const FrameBlur&) -> const std::vector<Track>& {
        return tracker->track(image, footage->camera(), rotation, exposure);
      });
    }
    evaluators.emplace_back(*footage, light.name, speed, m, study);
  }
  for (int i = 0; i < footage->frames(); ++i) {
    const cv::Mat raw = footage->image(i, light), sharp = footage->sharp(i, light);
    const RowExposure exposure = footage->exposure(i), short_exposure = sharp_exposure(exposure, raw.rows);
    const PipelineResult of_blurred = blurred_pipeline.process(raw, PixelLayout::GRAY, rotation, exposure, request),
                         of_sharp = sharp_pipeline.process(sharp, PixelLayout::GRAY, rotation, short_exposure, request);
    const double extent_px = median_extent_px(of_blurred.field, [](BlockStatus) { return true; });
    for (std::size_t m = 0; m < kMethods.size(); ++m) {
      const bool is_sharp = kMethods[m].images == Images::SHARP;
      const cv::Mat& image = is_sharp ? sharp : kMethods[m].images == Images::DEBLURRED ? of_blurred.luminance : raw;
      evaluators[m].add(
          i, extent_px,
          trackers[m](image, is_sharp ? short_exposure : exposure, is_sharp ? of_sharp.field : of_blurred.field));
    }
  }
}

std::string extents_text(std::size_t bin) {
  if (bin + 1 == kExtentBordersPx.size()) return "all";
  const int from = static_cast<int>(kExtentBordersPx[bin]), to = static_cast<int>(kExtentBordersPx[bin + 1]);
  return bin + 2 == kExtentBordersPx.size() ? std::to_string(from) + "+"
                                            : std::to_string(from) + "-" + std::to_string(to);
}

double mean_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

void report(const Arguments& arguments, const Study& study) {
  ResultTable errors({"light", "speed", "tracker", "extent [px]", "tracks", "median [px]", "p90 [px]", "above 2 px [%]",
                      "drift after 5 [px]", "after 10", "after 20", "e^T C^-1 e"});
  for (const auto& [key, of_bin] : study.errors) {
    const auto& [light, speed, method, bin] = key;
    const auto wrong = static_cast<double>(
        std::count_if(of_bin.step_px.begin(), of_bin.step_px.end(), [](double error_px) { return error_px > 2; }));
    errors.add({light.empty() ? "day" : light, text_of(speed, 1), kMethods[method].name, extents_text(bin),
                std::to_string(of_bin.step_px.size()), text_of(quantile(of_bin.step_px, 0.5), 3),
                text_of(quantile(of_bin.step_px, 0.9), 3),
                text_of(100 * wrong / static_cast<double>(of_bin.step_px.size()), 2),
                text_of(quantile(of_bin.drift_px[0], 0.5), 2), text_of(quantile(of_bin.drift_px[1], 0.5), 2),
                text_of(quantile(of_bin.drift_px[2], 0.5), 2),
                of_bin.mahalanobis.empty() ? "-" : text_of(mean_of(of_bin.mahalanobis), 2)});
  }
  ResultTable lengths({"light", "speed", "tracker", "tracks", "length [images]", "standard error"});
  for (const auto& [key, of_tracks] : study.lengths) {
    const auto& [light, speed, method] = key;
    const double mean = mean_of(of_tracks);
    double squares = 0;
    for (const double length : of_tracks) squares += (length - mean) * (length - mean);
    const auto count = static_cast<double>(of_tracks.size());
    lengths.add({light.empty() ? "day" : light, text_of(speed, 1), kMethods[method].name,
                 std::to_string(of_tracks.size()), text_of(mean, 2), text_of(std::sqrt(squares) / count, 2)});
  }
  std::printf("%s\n%s", errors.markdown().c_str(), lengths.markdown().c_str());
  if (arguments.output.empty()) return;
  errors.write(arguments.output, "tracks");
  lengths.write(arguments.output, "track_lengths");
}

void follow_recording(const Arguments& arguments) {
  constexpr double kNearPx = 1;
  ResultTable table({"tracker", "images apart", "tracks an image", "within 1 px", "median [px]", "p90 [px]"});
  for (const SharedCorners& followed : recorded_tracks(arguments.recording[0], arguments.recording[1])) {
    if (followed.pairs == 0) continue;
    const std::vector<double>& px = followed.distances_px;
    const auto near = std::count_if(px.begin(), px.end(), [](double distance_px) { return distance_px <= kNearPx; });
    table.add({followed.tracker, std::to_string(followed.images_apart),
               text_of(static_cast<double>(px.size()) / followed.pairs, 1),
               text_of(static_cast<double>(near) / followed.pairs, 1), text_of(quantile(px, 0.5), 2),
               text_of(quantile(px, 0.9), 2)});
  }
  std::printf("%s", table.markdown().c_str());
  if (arguments.output.empty()) return;
  std::filesystem::create_directories(arguments.output);
  table.write(arguments.output, "recorded_tracks");
}

void run(Arguments arguments) {
  if (!arguments.recording.empty()) return follow_recording(arguments);
  if (arguments.quick) {
    arguments.flights = {0, 2};
    arguments.speeds = {1.7};
    arguments.seconds = 1;
    arguments.no_low_light = true;
  }
  if (!arguments.output.empty()) std::filesystem::create_directories(arguments.output);
  const std::vector<test::RecordedFlight> flights = test::recorded_flights();
  Study study;
  Progress progress(
      arguments.flights.size() * arguments.speeds.size() * arguments.exposures_ms.size() * arguments.readouts_ms.size(),
      "flights", arguments.quiet);
  std::size_t done = 0;
  for (const std::size_t flight : arguments.flights) {
    for (const double speed : arguments.speeds) {
      for (const double exposure_ms : arguments.exposures_ms) {
        for (const double readout_ms : arguments.readouts_ms) {
          FootageCase footage_case;
          footage_case.flight = flights.at(flight);
          footage_case.exposure_ns = static_cast<TimeNs>(1e6 * exposure_ms);
          footage_case.readout_ns = static_cast<TimeNs>(1e6 * readout_ms);
          footage_case.speed = speed;
          Footage footage(footage_case, arguments.data, arguments.seconds);
          follow(&footage, kDaylight, speed, &study);
          if (!arguments.no_low_light) follow(&footage, kLowLight, speed, &study);
          progress.done(++done);
        }
      }
    }
  }
  report(arguments, study);
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"How far tracks are from their scene points, and for how long they stay on them.", "tracks"};
  app.add_option("--out", arguments.output, "folder for the tables");
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--recording", arguments.recording,
                 "folder and description, see config/recordings: its images instead of simulated flights")
      .values(2);
  app.add_option("--seconds", arguments.seconds, "of each flight [6]").range(1.0, 30.0);
  app.add_option("--flights", arguments.flights, "numbers of flights, from 0 [0 1 2]").range(0, 2);
  app.add_option("--exposures", arguments.exposures_ms, "[30 ms]").range(1.0, 50.0);
  app.add_option("--readouts", arguments.readouts_ms, "[0 ms: global shutter]").range(0.0, 50.0);
  app.add_option("--speeds", arguments.speeds, "1: as recorded [1 1.7]").range(0.5, 3.0);
  app.add_flag("--no-low-light", arguments.no_low_light, "daylight alone");
  app.add_flag("--quick", arguments.quick, "a second of two fast flights by day");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
