// How well the exposure is estimated from the blur, on recorded flights through a simulated room and on recorded
// images. Writes the data of doc/reports/exposure.md; exposure_estimate.py makes its tables and plots.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "blur/blur_validation.hpp"
#include "blur/exposure_estimate.hpp"
#include "blur/exposure_filter.hpp"
#include "blur/image_noise.hpp"
#include "features/residual_flow.hpp"
#include "footage.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "recorded_exposure.hpp"
#include "result_table.hpp"
#include "tools/progress.hpp"
#include "tools/recording.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  std::vector<std::string> parts;
  std::vector<double> assumptions{0.35, 0.6, 1, 1.6, 3};
  double seconds = 2;
  std::uint64_t seed = 1;
  bool quick = false, quiet = false;
};

/// Milliseconds of processor time that `work` takes on one thread.
template <typename Work>
double ms_of(Work&& work) {
  const std::clock_t begin = std::clock();
  work();
  return 1e3 * static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
}

/// The same rows in the middle of the exposure, exposed for another time.
RowExposure assumed_exposure(const RowExposure& truth, int rows, TimeNs exposure_ns) {
  ShutterTiming timing = truth.timing();
  timing.exposure_ns = exposure_ns;
  timing.stamp_row = StampRow::FIRST;
  timing.stamp_phase = StampPhase::MIDDLE;
  return RowExposure(truth.middle(0), rows, timing);
}

/// Median over the blocks that see a wall [px].
double true_extent_px(const Footage& footage, int frame, const BlockGrid& grid) {
  std::vector<double> extents_px;
  for (int b = 0; b < grid.size(); ++b) {
    const Eigen::Vector2d moved_px = footage.truth().recorded_displacement(frame, grid.center(b));
    if (moved_px.allFinite()) extents_px.push_back(moved_px.norm());
  }
  return quantile(extents_px, 0.5);
}

/// What is looked at of one frame with one assumption.
struct Look {
  FrameBlur field;
  std::optional<double> noise;
  std::optional<ExposureEstimate> estimate;
  double flow_ms = 0, validation_ms = 0, estimate_ms = 0;
};

/// A camera whose exposure changes.
struct Change {
  const char* name;
  std::vector<TimeNs> exposures_ns;  ///< by frame
  double brightness;                 ///< power of the exposure that it goes with: 0: the camera keeps it
};

constexpr double kFps = 20, kMs = 1e6;

/// Auto exposure that glides from 5 to 30 ms within 2 s, that jumps to twice as much and back, and that hunts.
std::vector<Change> changes() {
  std::vector<Change> changes{{"glide", {}, 0}, {"jump", {}, 0}, {"hunt", {}, 1}};
  const auto add = [](double exposure_ms, Change* change) {
    change->exposures_ns.push_back(static_cast<TimeNs>(exposure_ms * kMs));
  };
  for (int i = 0; i < 4 * kFps; ++i) {
    const double t_s = i / kFps;
    add(5 * std::pow(6, std::clamp((t_s - 1) / 2, 0.0, 1.0)), &changes[0]);
    add(t_s >= 1.5 && t_s < 3 ? 30 : 15, &changes[1]);
    add(20 * std::exp(0.35 * std::sin(2 * CV_PI * t_s)), &changes[2]);
  }
  return changes;
}

constexpr TimeNs kPeriodNs = 1'000'000'000 / static_cast<TimeNs>(kFps);

/// Of consecutive frames, as the pipeline would.
class Looker {
 public:
  Looker(const Camera& camera, const RotationTrack& rotation)
      : camera_(camera), rotation_(rotation), estimator_(camera, BlurFieldOptions{}) {}

  Look look(const cv::Mat& image, const RowExposure& exposure, bool estimates) {
    Look look;
    ResidualField residuals;
    look.flow_ms = ms_of([&] { residuals = flow_.follow(image, camera_, rotation_, exposure, estimator_.grid(), 1); });
    look.field = estimator_.estimate(rotation_, exposure, residuals);
    look.noise = image_noise(image, PixelLayout::GRAY);
    look.validation_ms = ms_of([&] { validate_blur_field(look.field, image, ValidationOptions{}, 1, look.noise); });
    if (estimates) {
      look.estimate_ms = ms_of([&] { look.estimate = estimate_exposure(look.field, image, look.noise, 1, kPeriodNs); });
    }
    return look;
  }
  const BlockGrid& grid() const { return estimator_.grid(); }

 private:
  const Camera& camera_;
  const RotationTrack& rotation_;
  BlurFieldEstimator estimator_;
  ResidualFlow flow_;
};

class Study {
 public:
  explicit Study(const Arguments& arguments) : arguments_(arguments) {
    std::filesystem::create_directories(arguments.output);
  }
  void run();

 private:
  bool asked(const std::string& part) const {
    return arguments_.parts.empty() ||
           std::find(arguments_.parts.begin(), arguments_.parts.end(), part) != arguments_.parts.end();
  }
  std::ofstream file(const std::string& name, const std::string& header) const {
    std::ofstream file(arguments_.output + "/" + name);
    if (!file) throw std::runtime_error("cannot write " + arguments_.output + "/" + name);
    file << header << "\n";
    return file;
  }
  void frames();
  void changing();
  void recorded();
  void frames_of(const FootageCase& c, const Footage& footage, std::ofstream* single, std::ofstream* filtered);

  const Arguments& arguments_;
};

const std::vector<Light> kLights{{"day", 1, 2}, {"low light", 0.35, 4}};

void Study::frames_of(const FootageCase& c, const Footage& footage, std::ofstream* single, std::ofstream* filtered) {
  const RotationTrack rotation = footage.rotation();
  const int rows = footage.camera().calibration().height_px;
  std::vector<double> extents_px;
  const BlockGrid grid = BlurFieldEstimator(footage.camera(), BlurFieldOptions{}).grid();
  for (int i = 0; i < footage.frames(); ++i) extents_px.push_back(true_extent_px(footage, i, grid));
  for (const Light& light : kLights) {
    for (const double assumption : arguments_.assumptions) {
      Looker looker(footage.camera(), rotation), filter_looker(footage.camera(), rotation);
      ExposureFilter filter;
      int blurred = 0;
      for (int i = 0; i < footage.frames(); ++i) {
        const cv::Mat image = footage.image(i, light);
        const RowExposure truth = footage.exposure(i);
        const auto true_ns = static_cast<double>(truth.timing().exposure_ns);
        const auto assumed_ns = static_cast<TimeNs>(assumption * true_ns);
        const double extent_px = extents_px[i];
        constexpr int kFirst = 2;  // flow is known from there on
        const Look look = looker.look(image, assumed_exposure(truth, rows, assumed_ns), i >= kFirst);
        if (i < kFirst) continue;
        char line[300];
        std::snprintf(line, sizeof(line), "%s,\"%s\",%s,%g,%d,%.2f,%.4f,%.4f,%.2f\n", c.flight.name,
                      c.conditions().c_str(), light.name, assumption, i, extent_px,
                      look.estimate ? look.estimate->ratio * assumption : NAN,
                      look.estimate ? look.estimate->log_stddev : NAN, look.estimate_ms);
        *single << line;
        // The filter's own answer is assumed as soon as there is one.
        const std::optional<ExposureFilter::State> before = filter.state();
        const TimeNs now_ns = before ? before->exposure_ns : assumed_ns;
        const bool wanted = filter.wants_estimate();
        const Look next = filter_looker.look(image, assumed_exposure(truth, rows, now_ns), wanted);
        filter.add(truth.middle(0), now_ns, next.estimate, cv::mean(image)[0]);
        constexpr double kBlurredPx = 8;
        if (extent_px >= kBlurredPx) ++blurred;
        const std::optional<ExposureFilter::State> state = filter.state();
        std::snprintf(line, sizeof(line), "%s,\"%s\",%s,%g,%d,%.2f,%d,%d,%.4f,%.4f,%.2f,%.2f\n", c.flight.name,
                      c.conditions().c_str(), light.name, assumption, i, extent_px, blurred, wanted ? 1 : 0,
                      state ? static_cast<double>(state->exposure_ns) / true_ns : NAN, state ? state->log_stddev : NAN,
                      next.estimate_ms, next.flow_ms + next.validation_ms);
        *filtered << line;
      }
    }
  }
}

void Study::frames() {
  std::vector<test::RecordedFlight> flights = test::recorded_flights();
  std::vector<FootageCase> cases;
  const auto add = [&](TimeNs exposure_ns, TimeNs readout_ns, double speed) {
    FootageCase c{flights.front()};
    c.exposure_ns = exposure_ns;
    c.readout_ns = readout_ns;
    c.speed = speed;
    cases.push_back(c);
  };
  constexpr TimeNs kMsNs = 1'000'000;
  add(30 * kMsNs, 0, 1.7);
  add(20 * kMsNs, 20 * kMsNs, 1);
  add(10 * kMsNs, 20 * kMsNs, 1.7);
  add(30 * kMsNs, 0, 1);
  add(20 * kMsNs, 0, 1.7);
  add(30 * kMsNs, 20 * kMsNs, 1.7);
  std::ofstream single =
      file("exposure_frames.csv", "flight,conditions,light,assumed,frame,extent_px,ratio,log_stddev,ms");
  std::ofstream filtered =
      file("exposure_filtered.csv",
           "flight,conditions,light,assumed,frame,extent_px,blurred,looked,ratio,log_stddev,ms,others_ms");
  if (arguments_.quick) flights.resize(1), cases.resize(1);
  const double seconds = arguments_.quick ? 1.25 : arguments_.seconds;
  Progress progress(flights.size() * cases.size(), "flights", arguments_.quiet);
  std::size_t done = 0;
  for (FootageCase c : cases) {
    for (const test::RecordedFlight& flight : flights) {
      // Each in a room with other walls, at another part of the flight.
      constexpr double kApartS = 1.7;
      c.flight = flight;
      c.flight.start_s += kApartS * static_cast<double>((done + arguments_.seed) % cases.size());
      c.first_photograph = done + arguments_.seed;
      frames_of(c, Footage(c, arguments_.data, seconds), &single, &filtered);
      progress.done(++done);
    }
  }
}

void Study::changing() {
  std::ofstream data = file("exposure_changes.csv",
                            "change,flight,t_s,extent_px,true_ms,looked,one_ms,one_stddev,filtered_ms,filtered_stddev");
  constexpr double kSpeed = 1.7, kFirstAssumedMs = 10;
  std::vector<test::RecordedFlight> flights = test::recorded_flights();
  flights.erase(flights.begin() + 1);
  std::vector<Change> all = changes();
  if (arguments_.quick) {
    constexpr int kShort = 45;  // frames: the jump alone
    flights.resize(1);
    all = {all[1]};
    all[0].exposures_ns.resize(kShort);
  }
  for (const test::RecordedFlight& flight : flights) {
    for (const Change& change : all) {
      FootageCase c{flight};
      c.speed = kSpeed;
      c.exposures_ns = change.exposures_ns;
      const Footage footage(c, arguments_.data, static_cast<double>(change.exposures_ns.size()) / kFps);
      const RotationTrack rotation = footage.rotation();
      const int rows = footage.camera().calibration().height_px;
      Looker looker(footage.camera(), rotation);
      ExposureFilter filter;
      for (int i = 0; i < footage.frames(); ++i) {
        const RowExposure truth = footage.exposure(i);
        const double true_ns = static_cast<double>(truth.timing().exposure_ns);
        cv::Mat image = footage.image(i, kDaylight);
        if (change.brightness != 0) image.convertTo(image, CV_8U, std::pow(true_ns / (20 * kMs), change.brightness));
        const std::optional<ExposureFilter::State> before = filter.state();
        const TimeNs assumed_ns = before ? before->exposure_ns : static_cast<TimeNs>(kFirstAssumedMs * kMs);
        const bool wanted = filter.wants_estimate();
        const Look look = looker.look(image, assumed_exposure(truth, rows, assumed_ns), wanted);
        filter.add(truth.middle(0), assumed_ns, look.estimate, cv::mean(image)[0]);
        const std::optional<ExposureFilter::State> state = filter.state();
        char line[300];
        std::snprintf(line, sizeof(line), "%s,%s,%.3f,%.2f,%.3f,%d,%.3f,%.4f,%.3f,%.4f\n", change.name, flight.name,
                      i / kFps, true_extent_px(footage, i, looker.grid()), true_ns / kMs, wanted ? 1 : 0,
                      look.estimate ? look.estimate->ratio * static_cast<double>(assumed_ns) / kMs : NAN,
                      look.estimate ? look.estimate->log_stddev : NAN,
                      state ? static_cast<double>(state->exposure_ns) / kMs : NAN, state ? state->log_stddev : NAN);
        data << line;
      }
    }
  }
}

void Study::recorded() {
  std::ofstream data = file("exposure_recorded.csv", "recording,assumed_ms,frame,ms,log_stddev");
  const auto add = [&](const char* name, const Recording& recording, const std::vector<double>& assumed_ms) {
    for (const double assumed : assumed_ms) {
      const auto estimates = test::recorded_exposures(recording, static_cast<TimeNs>(assumed * kMs));
      for (std::size_t i = 0; i < estimates.size(); ++i) {
        char line[200];
        std::snprintf(line, sizeof(line), "%s,%g,%zu,%.3f,%.4f\n", name, assumed, i + 1,
                      estimates[i] ? estimates[i]->ratio * assumed : NAN,
                      estimates[i] ? estimates[i]->log_stddev : NAN);
        data << line;
      }
    }
  };
  const std::string descriptions = GYRO_DEBLUR_CONFIG_DIR "/recordings/";
  add("shield_burst", read_frames(arguments_.data + "/shield_burst", descriptions + "shield_burst.yaml"), {10, 20, 30});
  add("phone_sharp", read_frames(arguments_.data + "/phone_sharp", descriptions + "phone_sharp.yaml"), {2, 5, 15, 30});
}

void Study::run() {
  if (asked("frames")) frames();
  if (asked("changes")) changing();
  if (asked("recorded")) recorded();
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"How well the exposure is estimated from the blur.", "exposure_estimate"};
  app.add_option("--out", arguments.output, "folder for the data").required();
  app.add_option("--data", arguments.data, "recorded data, with trajectories/ and shield_burst/");
  app.add_option("--parts", arguments.parts, "frames, changes, recorded [all]");
  app.add_option("--assumptions", arguments.assumptions, "assumed over true exposures [0.35 0.6 1 1.6 3]");
  app.add_option("--seconds", arguments.seconds, "of each flight [2]");
  app.add_option("--seed", arguments.seed, "of walls and parts of flights [1]");
  app.add_flag("--quick", arguments.quick, "one flight, one change");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { Study(arguments).run(); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
