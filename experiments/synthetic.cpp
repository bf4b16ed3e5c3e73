// The paper's experiment with synthetic blur (section V-A): repeatability and localisation error of every method
// against the number of detections, matches, and what wrong blur estimates cost.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>

#include "baselines.hpp"
#include "evaluation.hpp"
#include "image_pairs.hpp"
#include "synthetic_blur.hpp"
#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

// The paper's blur of the first and the second image of every pair.
const LineBlur kBlurs[] = {{30 * CV_PI / 180, 27}, {110 * CV_PI / 180, 47}};
// The blurred image is cut out of a larger one, so that its border holds real light from outside.
constexpr int kMarginPx = 32;
constexpr double kNormalizedRadiusPx = 30;  // Mikolajczyk et al. 2005

/// Error of the blur that a method is given, as in the paper.
struct BlurError {
  double angle_deg = 0, extent_px = 0;
};

struct Method {
  std::string name;
  enum { SHARP, BLURRED, ADAPTED_DETECTOR, FREQUENCY, FREQUENCY_TAPERED, PROPOSED, TRANSFORMED, BEYOND } kind;
  BlurError error = {};
};

std::string proposed_with(const BlurError& error) {
  const auto text = [](double v) { return std::to_string(static_cast<int>(v)); };
  return "proposed eps=[" + text(error.angle_deg) + "," + text(error.extent_px) + "]";
}

std::vector<Method> all_methods() {
  std::vector<Method> methods = {{"sharp", Method::SHARP},
                                 {"DoG", Method::BLURRED},
                                 {"Pretto et al.", Method::ADAPTED_DETECTOR},
                                 {"frequency domain", Method::FREQUENCY},
                                 {"frequency domain, tapered", Method::FREQUENCY_TAPERED},
                                 {"proposed", Method::PROPOSED},
                                 {"proposed, taps of the transform", Method::TRANSFORMED}};
  // The paper's, in the order of its legend.
  for (const BlurError& error : {BlurError{-5, -5}, {5, 5}, {0, 5}, {0, -5}, {5, 0}, {-5, 0}}) {
    methods.push_back({proposed_with(error), Method::PROPOSED, error});
  }
  methods.push_back({"beyond the paper", Method::BEYOND});
  return methods;
}

/// Those of the names given, or all. Throws std::runtime_error that lists the names.
std::vector<Method> chosen_methods(const std::vector<std::string>& names) {
  const std::vector<Method> all = all_methods();
  if (names.empty()) return all;
  std::vector<Method> chosen;
  for (const std::string& name : names) {
    const auto found = std::find_if(all.begin(), all.end(), [&](const Method& m) { return m.name == name; });
    if (found == all.end()) {
      std::string list;
      for (const Method& method : all) list += (list.empty() ? "\"" : ", \"") + method.name + "\"";
      throw std::runtime_error("method \"" + name + "\" is unknown; available: " + list);
    }
    chosen.push_back(*found);
  }
  return chosen;
}

struct Arguments {
  std::string out = "results";
  std::string data = GYRO_DEBLUR_DATA_DIR;
  double snr_db = 30;  // mean square of the image over the variance of the noise
  std::uint64_t seed = 1;
  int threads = 0;
  std::vector<std::string> methods;  // empty: all
  bool quick = false, quiet = false;
};

struct Record {
  std::string pair, method;
  int count;
  Repeatability plain, normalized;
};
struct MatchingRecord {
  std::string pair, method;
  Matching sift, orb;
};

/// One image as the camera gives it.
struct Exposure {
  cv::Mat sharp, blurred;
};

Exposure expose(const cv::Mat& photograph, const LineBlur& blur, double snr_db, std::uint64_t seed) {
  const cv::Rect inner(kMarginPx, kMarginPx, photograph.cols - 2 * kMarginPx, photograph.rows - 2 * kMarginPx);
  const auto noisy = [&](const cv::Mat& light) {
    const double mean_square = light.dot(light) / static_cast<double>(light.total());
    return test::expose(light, std::sqrt(mean_square * std::pow(10, -snr_db / 10)), seed);
  };
  cv::Mat sharp;
  photograph(inner).convertTo(sharp, CV_64F);
  return {noisy(sharp), noisy(test::blur_along_line(photograph, blur.angle_rad, blur.extent_px)(inner).clone())};
}

cv::Mat rounded(const cv::Mat& image) {
  cv::Mat out;
  image.convertTo(out, CV_8U);
  return out;
}

/// What the detector of a method gets to see.
cv::Mat restore(const Method& method, const Exposure& exposure, const LineBlur& truth) {
  const double ratio = FilterOptions().noise_to_signal_ratio;
  switch (method.kind) {
    case Method::SHARP:
      return exposure.sharp;
    case Method::BLURRED:
    case Method::ADAPTED_DETECTOR:
      return exposure.blurred;
    case Method::FREQUENCY:
    case Method::FREQUENCY_TAPERED:
      return rounded(deblur_in_frequency(exposure.blurred, truth, ratio, method.kind == Method::FREQUENCY_TAPERED));
    case Method::PROPOSED:
      return deblur_in_space(exposure.blurred, {truth.angle_rad + method.error.angle_deg * CV_PI / 180,
                                                truth.extent_px + method.error.extent_px});
    case Method::TRANSFORMED: {
      FilterOptions options;
      options.regularization = Regularization::PAPER;
      return deblur_in_space(exposure.blurred, truth, options);
    }
    case Method::BEYOND:
      return restore_beyond_borders(exposure.blurred, truth);
  }
  throw std::logic_error("unknown method");
}

/// Everything that is computed for one method on one pair.
struct Task {
  const ImagePair* pair;
  const Exposure* exposures;  // two
  const Method* method;
};
struct Outcome {
  std::vector<Record> records;
  std::vector<MatchingRecord> matching;
};

Outcome run_task(const Task& task, const std::vector<int>& counts) {
  // Cropping moves the origin of both images by the same.
  const Homography shift(1, 0, kMarginPx, 0, 1, kMarginPx, 0, 0, 1);
  const Homography H = shift.inv() * task.pair->H_2_1 * shift;
  cv::Mat images[2];
  std::vector<cv::KeyPoint> keypoints[2];
  for (int i = 0; i < 2; ++i) {
    images[i] = restore(*task.method, task.exposures[i], kBlurs[i]);
    keypoints[i] = task.method->kind == Method::ADAPTED_DETECTOR ? detect_motion_adapted_dog(images[i], kBlurs[i])
                                                                 : detect_dog(images[i]);
  }
  Outcome outcome;
  OverlapOptions normalized;
  normalized.normalized_radius_px = kNormalizedRadiusPx;
  for (const int count : counts) {
    const auto evaluate = [&](const OverlapOptions& options) {
      return evaluate_repeatability(keypoints[0], images[0].size(), keypoints[1], images[1].size(), H, count, options);
    };
    outcome.records.push_back({task.pair->name, task.method->name, count, evaluate({}), evaluate(normalized)});
  }
  if (task.method->kind == Method::ADAPTED_DETECTOR) return outcome;  // a detector only
  const MatchingOptions options;
  const int n = options.max_keypoints;
  outcome.matching.push_back(
      {task.pair->name, task.method->name,
       evaluate_matching(extract_sift(images[0], n), images[0].size(), extract_sift(images[1], n), H, options),
       evaluate_matching(extract_orb(images[0], n), images[0].size(), extract_orb(images[1], n), H, options)});
  return outcome;
}

/// Mean over pairs; those without a value (NaN) do not count.
struct Mean {
  double sum = 0;
  int n = 0;
  void add(double value) {
    if (!std::isfinite(value)) return;
    sum += value;
    ++n;
  }
  nlohmann::json value() const { return n == 0 ? nlohmann::json() : nlohmann::json(sum / n); }
};

void write_csv(const std::string& path, const std::vector<Outcome>& outcomes) {
  std::ofstream file(path);
  file << "pair,method,detections,keypoints1,keypoints2,repeatability,error_px,repeatability_normalized,"
          "error_px_normalized\n";
  for (const Outcome& outcome : outcomes) {
    for (const Record& r : outcome.records) {
      file << r.pair << ",\"" << r.method << "\"," << r.count << ',' << r.plain.keypoints1 << ',' << r.plain.keypoints2
           << ',' << r.plain.ratio << ',' << r.plain.error_px << ',' << r.normalized.ratio << ','
           << r.normalized.error_px << '\n';
    }
  }
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

void write_matching_csv(const std::string& path, const std::vector<Outcome>& outcomes) {
  std::ofstream file(path);
  file << "pair,method,sift_matches,sift_correct,sift_homography,orb_matches,orb_correct,orb_homography\n";
  for (const Outcome& outcome : outcomes) {
    for (const MatchingRecord& r : outcome.matching) {
      file << r.pair << ",\"" << r.method << "\"," << r.sift.matches << ',' << r.sift.correct << ','
           << r.sift.homography_found << ',' << r.orb.matches << ',' << r.orb.correct << ',' << r.orb.homography_found
           << '\n';
    }
  }
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

/// Means over pairs by method and number of detections.
nlohmann::json summarize(const std::vector<Outcome>& outcomes, const std::vector<Method>& methods,
                         const std::vector<int>& counts) {
  struct Cell {
    Mean ratio, error, normalized_ratio, normalized_error, keypoints;
  };
  struct MatchingCell {
    Mean sift, orb, sift_homography, orb_homography;
  };
  std::map<std::pair<std::string, int>, Cell> cells;
  std::map<std::string, MatchingCell> matching;
  for (const Outcome& outcome : outcomes) {
    for (const Record& r : outcome.records) {
      Cell& cell = cells[{r.method, r.count}];
      cell.ratio.add(r.plain.ratio);
      cell.error.add(r.plain.error_px);
      cell.normalized_ratio.add(r.normalized.ratio);
      cell.normalized_error.add(r.normalized.error_px);
      cell.keypoints.add(std::min(r.plain.keypoints1, r.plain.keypoints2));
    }
    for (const MatchingRecord& r : outcome.matching) {
      MatchingCell& cell = matching[r.method];
      cell.sift.add(r.sift.correct);
      cell.orb.add(r.orb.correct);
      cell.sift_homography.add(r.sift.homography_found);
      cell.orb_homography.add(r.orb.homography_found);
    }
  }
  nlohmann::json result = nlohmann::json::array();
  for (const Method& method : methods) {
    nlohmann::json curve = nlohmann::json::array();
    for (const int count : counts) {
      const Cell& cell = cells[{method.name, count}];
      curve.push_back({{"detections", count},
                       {"keypoints", cell.keypoints.value()},
                       {"repeatability", cell.ratio.value()},
                       {"error_px", cell.error.value()},
                       {"repeatability_normalized", cell.normalized_ratio.value()},
                       {"error_px_normalized", cell.normalized_error.value()}});
    }
    nlohmann::json entry = {{"method", method.name}, {"curve", curve}};
    const auto found = matching.find(method.name);
    if (found != matching.end()) {
      entry["matching"] = {{"sift_correct", found->second.sift.value()},
                           {"orb_correct", found->second.orb.value()},
                           {"sift_homographies", found->second.sift_homography.value()},
                           {"orb_homographies", found->second.orb_homography.value()}};
    }
    result.push_back(entry);
  }
  return result;
}

void run(const Arguments& arguments) {
  std::string source;
  std::vector<ImagePair> pairs = load_pairs(arguments.data, source);
  const std::vector<Method> methods = chosen_methods(arguments.methods);
  std::vector<int> counts;
  for (int count = 100; count <= 1000; count += 100) counts.push_back(count);
  if (arguments.quick) {
    // One pair with a change of viewpoint and one without.
    pairs = {pairs[3], pairs[6]};
    counts = {100, 500, 1000};
  }
  std::filesystem::create_directories(arguments.out);

  std::vector<std::vector<Exposure>> exposures(pairs.size());
  std::vector<Task> tasks;
  for (std::size_t p = 0; p < pairs.size(); ++p) {
    const std::uint64_t seed = arguments.seed * 1000 + 2 * p;
    exposures[p] = {expose(pairs[p].image1, kBlurs[0], arguments.snr_db, seed),
                    expose(pairs[p].image2, kBlurs[1], arguments.snr_db, seed + 1)};
    for (const Method& method : methods) tasks.push_back({&pairs[p], exposures[p].data(), &method});
  }

  // Methods on pairs are independent; OpenCV's own threads would only get in each other's way.
  cv::setNumThreads(1);
  Progress progress(tasks.size(), "methods on pairs", arguments.quiet);
  std::vector<Outcome> outcomes(tasks.size());
  std::atomic<std::size_t> next{0};
  std::size_t done = 0;
  std::exception_ptr failure;
  std::mutex mutex;
  const auto work = [&] {
    for (std::size_t i; (i = next++) < tasks.size();) {
      try {
        outcomes[i] = run_task(tasks[i], counts);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(mutex);
        failure = std::current_exception();
        next = tasks.size();
        return;
      }
      const std::lock_guard<std::mutex> lock(mutex);
      progress.done(++done);
    }
  };
  std::vector<std::thread> workers;
  const unsigned hardware = std::max(1u, std::thread::hardware_concurrency());
  for (unsigned i = 0; i < (arguments.threads > 0 ? arguments.threads : hardware); ++i) workers.emplace_back(work);
  for (std::thread& worker : workers) worker.join();
  if (failure) std::rethrow_exception(failure);

  write_csv(arguments.out + "/synthetic.csv", outcomes);
  write_matching_csv(arguments.out + "/synthetic_matching.csv", outcomes);
  const nlohmann::json summary = {{"images", source},
                                  {"pairs", pairs.size()},
                                  {"snr_db", arguments.snr_db},
                                  {"seed", arguments.seed},
                                  {"methods", summarize(outcomes, methods, counts)}};
  write_json(arguments.out + "/synthetic.json", summary);
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app("The experiment with synthetic blur: writes synthetic.csv, synthetic_matching.csv, synthetic.json",
                  "synthetic");
  app.add_option("--out", arguments.out, "folder for the results").show_default();
  app.add_option("--data", arguments.data, "folder with oxford_affine; without it, photographs of opencv-doc")
      .show_default();
  app.add_option("--snr-db", arguments.snr_db, "mean square of the image over the variance of the noise")
      .range(0, 100)
      .show_default();
  app.add_option("--seed", arguments.seed, "of the noise").show_default();
  app.add_option("--threads", arguments.threads, "0: as many as there are cores").range(0, 256).show_default();
  app.add_option("--methods", arguments.methods, "names of the methods to run; default: all");
  app.add_flag("--quick", arguments.quick, "two pairs and three numbers of detections");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
