// What a wrong exposure_time costs, and none at all: correct matches of deblurred frames with the sharp ones, of a
// flight through a room. Writes a table of doc/reports/exposure.md.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <iostream>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>

#include "evaluation.hpp"
#include "footage.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "pipeline/exposure_choice.hpp"
#include "result_table.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  double seconds = 15, speed = 1.7, exposure_s = 0.03;
  std::size_t flight = 0;
  int step = 4;
  bool low_light = false, quiet = false;
};

constexpr double kFromS = 5;  // of which on matches are counted
constexpr int kFeatures = 1000;
constexpr double kMaxErrorPx = 3;
constexpr TimeNs kPeriodNs = 50'000'000;  // of Footage

/// What is given: an exposure_time, or nothing; and whether the images may replace it.
struct Case {
  std::string name;
  std::optional<double> factor;  ///< of the true exposure
  OnExposureConflict policy = OnExposureConflict::IMAGES;
};

struct Outcome {
  int matches = 0, frames = 0;         ///< of the frames that are counted
  int unknown = 0;                     ///< frames that stay blurred since the exposure is not known, of all
  std::optional<double> right_from_s;  ///< the exposure in use is within 5 % of the true one from then on
  std::vector<double> errors;          ///< |exposure in use / true one - 1|, of the frames that are counted
};

/// Deblurs as the nodelet does, but for messages.
class Front {
 public:
  Front(const Footage& footage, const Case& given) : rotation_(footage.rotation()), pipeline_(PipelineOptions()) {
    pipeline_.set_calibration(footage.camera().calibration());
    choice_.set_policy(given.policy);
  }

  /// @return the exposure that was used; nothing: it is not known
  std::optional<TimeNs> next(const cv::Mat& image, TimeNs stamp_ns, const RowExposure& truth,
                             const std::optional<TimeNs>& given_ns, cv::Mat* deblurred) {
    std::optional<GivenExposure> given;
    if (given_ns) given = GivenExposure{ExposureOrigin::PARAMETER, *given_ns};
    const ExposurePlan plan = choice_.plan(given, kPeriodNs);
    PipelineRequest request;
    request.keypoints = false;
    request.exposure = ExposureQuestion{plan.estimate, plan.longest_ns};
    const RowExposure planned = truth.with_exposure(plan.exposure_ns);
    const PipelineResult& estimated = pipeline_.estimate(image, PixelLayout::GRAY, rotation_, planned, request);
    const ChosenExposure chosen =
        choice_.decide(stamp_ns, plan, estimated.exposure_estimate, estimated.mean_brightness);
    const bool is_known = chosen.origin != ExposureOrigin::ASSUMED;
    pipeline_.validate(ExposureAnswer{chosen.exposure_ns, is_known});
    const PipelineResult result = pipeline_.deblur();
    *deblurred = result.image.empty() ? image : result.image;
    return is_known ? std::optional(chosen.exposure_ns) : std::nullopt;
  }

 private:
  RotationTrack rotation_;
  Pipeline pipeline_;
  ExposureChoice choice_;
};

Outcome outcome_of(Footage& footage, const Light& light, const Case& given, int step,
                   const std::vector<Features>& sharp) {
  Outcome outcome;
  Front front(footage, given);
  for (int i = 0; i < footage.frames(); ++i) {
    const RowExposure exposure = footage.exposure(i);
    const auto true_ns = static_cast<double>(exposure.timing().exposure_ns);
    std::optional<TimeNs> given_ns;
    if (given.factor) given_ns = std::llround(*given.factor * true_ns);
    const cv::Mat image = footage.image(i, light);
    cv::Mat deblurred;
    const std::optional<TimeNs> used_ns = front.next(image, footage.truth().stamp(i), exposure, given_ns, &deblurred);
    const double at_s = i * to_seconds(kPeriodNs);
    if (!used_ns) ++outcome.unknown;
    const double error = used_ns ? std::abs(static_cast<double>(*used_ns) / true_ns - 1) : 1;
    if (error > 0.05) {
      outcome.right_from_s.reset();
    } else if (!outcome.right_from_s) {
      outcome.right_from_s = at_s;
    }
    if (at_s < kFromS) continue;
    outcome.errors.push_back(error);
    if (i % step != 0) continue;
    MatchingOptions options;
    options.max_error_px = kMaxErrorPx;
    outcome.matches += evaluate_matching(sharp[static_cast<std::size_t>(i)], image.size(),
                                         extract_orb(deblurred, kFeatures), Homography::eye(), options)
                           .correct;
    ++outcome.frames;
  }
  return outcome;
}

void run(const Arguments& arguments) {
  const Light light = arguments.low_light ? kLowLight : kDaylight;
  FootageCase flight;
  flight.flight = test::recorded_flights().at(arguments.flight);
  flight.exposure_ns = to_ns(arguments.exposure_s);
  flight.speed = arguments.speed;
  Footage footage(flight, arguments.data, arguments.seconds);
  std::vector<Features> sharp(static_cast<std::size_t>(footage.frames()));
  for (int i = 0; i < footage.frames(); ++i) {
    if (i % arguments.step == 0) sharp[static_cast<std::size_t>(i)] = extract_orb(footage.sharp(i, light), kFeatures);
  }
  std::vector<Case> cases{{"right", 1.0}, {"nothing", {}}};
  for (const double factor : {0.5, 0.6, 0.8, 0.9, 1.1, 1.25, 1.6, 2.0})
    cases.push_back({"x" + text_of(factor, 2), factor});
  for (const double factor : {0.6, 1.6}) {
    cases.push_back({"x" + text_of(factor, 2) + ", `configured`", factor, OnExposureConflict::CONFIGURED});
  }
  ResultTable table({"exposure_time", "matches from 5 s on", "of those with the right one [%]",
                     "exposure within 5 % from [s]", "error of the exposure, median [%]", "frames not known"});
  Progress progress(cases.size(), "cases", arguments.quiet);
  std::size_t done = 0;
  double right = 0;
  for (const Case& given : cases) {
    const Outcome outcome = outcome_of(footage, light, given, arguments.step, sharp);
    const double mean = outcome.frames > 0 ? outcome.matches / static_cast<double>(outcome.frames) : 0;
    if (done == 0) right = mean;
    table.add({given.name, text_of(mean, 0), text_of(100 * mean / right, 1),
               outcome.right_from_s ? text_of(*outcome.right_from_s, 2) : "-",
               text_of(100 * quantile(outcome.errors, 0.5), 1), std::to_string(outcome.unknown)});
    progress.done(++done);
  }
  std::cout << flight.conditions() << ", " << (arguments.low_light ? "low light" : "day") << "\n" << table.markdown();
  if (!arguments.output.empty()) table.write(arguments.output, "wrong_exposure");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"What a wrong exposure_time costs where the images may replace it, and none at all.",
                  "wrong_exposure"};
  app.add_option("--out", arguments.output, "folder for the table");
  app.add_option("--data", arguments.data, "recorded data, with trajectories/");
  app.add_option("--flight", arguments.flight, "number of the recorded flight, 0 to 2 [0]");
  app.add_option("--seconds", arguments.seconds, "of the flight [15]");
  app.add_option("--speed", arguments.speed, "factor on the flight's [1.7]");
  app.add_option("--exposure", arguments.exposure_s, "[s] [0.03]");
  app.add_option("--step", arguments.step, "compare matches of every n-th frame [4]");
  app.add_flag("--low-light", arguments.low_light, "contrast .35, noise 4");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
