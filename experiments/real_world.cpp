// The paper's real-world protocol (section V-B): simulates pairs of bursts sharp - blurred - sharp, and evaluates
// features on any such pair.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>

#include "baselines.hpp"
#include "burst.hpp"
#include "evaluation.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr char kTruthFile[] = "truth.csv";

struct SimulateArguments {
  std::string scene1, scene2, output;
  double sharp_noise = 0;
};

struct EvaluateArguments {
  std::string folder, json;
  int detections = 0;
  ProtocolOptions protocol;
};

/// A point of the scene in the middle frames of both bursts.
struct TruthPoint {
  cv::Point2d first_px, second_px;
};

Burst simulate_burst(sim::Simulator& middle, sim::Simulator& sharp) {
  Burst burst;
  const sim::Scene& scene = middle.scene();
  for (const BurstIndex i : {FIRST, MIDDLE, LAST}) {
    const sim::Frame frame = (i == MIDDLE ? middle : sharp).frame(i);
    burst.frames[i] = {frame.image, frame.stamp_ns, frame.timing.exposure_ns};
  }
  burst.calibration = scene.camera.calibration;
  burst.config.shutter = scene.timing(MIDDLE);
  burst.config.gyro.bias_rad_s = scene.imu.gyro_bias_rad_s;
  burst.config.gyro.time_offset_ns = scene.imu.time_offset_ns;
  burst.config.R_cam_imu = scene.imu.R_cam_imu;
  for (const sim::ImuSample& sample : middle.imu()) burst.gyro.push_back({sample.t_ns, sample.rate_rad_s});
  return burst;
}

std::vector<TruthPoint> true_correspondences(const sim::Simulator& first, const sim::Simulator& second) {
  constexpr int kColumns = 32, kRows = 18;
  const CameraCalibration& camera = first.scene().camera.calibration;
  const CameraCalibration& other = second.scene().camera.calibration;
  std::vector<TruthPoint> truth;
  for (int r = 0; r < kRows; ++r) {
    for (int c = 0; c < kColumns; ++c) {
      const Eigen::Vector2d pixel((c + 0.5) * camera.width_px / kColumns, (r + 0.5) * camera.height_px / kRows);
      const auto point = first.scene_point(MIDDLE, pixel);
      if (!point) continue;
      const Eigen::Vector2d seen = second.pixel_of(MIDDLE, *point);
      const bool inside = seen.x() >= 0 && seen.y() >= 0 && seen.x() <= other.width_px - 1 &&
                          seen.y() <= other.height_px - 1;  // false for NaN
      if (inside) truth.push_back({{pixel.x(), pixel.y()}, {seen.x(), seen.y()}});
    }
  }
  return truth;
}

void simulate(const SimulateArguments& arguments) {
  const auto simulators = [&](const std::string& path) {
    sim::Scene scene = sim::load_scene(path);
    scene.frames = 3;
    if (scene.camera.encoding != "mono8") throw OptionError(path + ": camera.encoding must be mono8 for a burst");
    sim::Scene sharp = scene;
    sharp.camera.noise = arguments.sharp_noise;
    return std::make_pair(sim::Simulator(std::move(scene)), sim::Simulator(std::move(sharp)));
  };
  auto [first, first_sharp] = simulators(arguments.scene1);
  auto [second, second_sharp] = simulators(arguments.scene2);
  const std::filesystem::path output(arguments.output);
  std::filesystem::create_directories(output / "first");
  std::filesystem::create_directories(output / "second");
  save_burst((output / "first").string(), simulate_burst(first, first_sharp));
  save_burst((output / "second").string(), simulate_burst(second, second_sharp));
  std::ofstream file(output / kTruthFile);
  file.precision(10);
  for (const TruthPoint& p : true_correspondences(first, second)) {
    file << p.first_px.x << ',' << p.first_px.y << ',' << p.second_px.x << ',' << p.second_px.y << '\n';
  }
  if (!file) throw std::runtime_error((output / kTruthFile).string() + ": cannot be written");
}

/// Nothing when the file does not exist.
std::vector<TruthPoint> read_truth(const std::string& path) {
  std::vector<TruthPoint> truth;
  std::ifstream file(path);
  TruthPoint p;
  char comma = ',';
  while (file >> p.first_px.x >> comma >> p.first_px.y >> comma >> p.second_px.x >> comma >> p.second_px.y) {
    truth.push_back(p);
  }
  if (file.is_open() && !file.eof()) throw std::runtime_error(path + ": does not hold lines x1,y1,x2,y2");
  return truth;
}

/// Distances [px, image 2] between where a homography takes the points and where they are.
nlohmann::json homography_errors(const Homography& H, const std::vector<TruthPoint>& truth) {
  std::vector<double> errors;
  for (const TruthPoint& p : truth) {
    const cv::Point2d d = project(H, p.first_px) - p.second_px;
    errors.push_back(std::hypot(d.x, d.y));
  }
  std::sort(errors.begin(), errors.end());
  return {{"median_px", errors[errors.size() / 2]}, {"p95_px", errors[errors.size() * 95 / 100]}};
}

Homography fitted_homography(const std::vector<TruthPoint>& truth) {
  std::vector<cv::Point2d> from, to;
  for (const TruthPoint& p : truth) {
    from.push_back(p.first_px);
    to.push_back(p.second_px);
  }
  const cv::Mat H = cv::findHomography(from, to, 0);
  if (H.empty()) throw std::runtime_error(std::string(kTruthFile) + ": no homography fits");
  return Homography(H.ptr<double>());
}

/// Keypoints of the middle frame by one method.
struct Detected {
  std::vector<cv::KeyPoint> first, second;
};

/// What the gyroscope says of the middle frame.
struct DeblurredMiddle {
  cv::Mat image;       ///< as the package deblurs it
  LineBlur mean_blur;  ///< over the blocks, for methods that take one blur for the whole frame
};

LineBlur mean_blur(const BlurField& field) {
  // Lines have no direction: angles are doubled for the sum.
  double x = 0, y = 0, extent = 0;
  for (const BlockBlur& block : field.blocks) {
    x += block.extent_px * std::cos(2 * block.angle_rad);
    y += block.extent_px * std::sin(2 * block.angle_rad);
    extent += block.extent_px;
  }
  return {std::atan2(y, x) / 2, extent / static_cast<double>(field.blocks.size())};
}

DeblurredMiddle deblurred_middle(const Burst& burst, nlohmann::json& report) {
  Pipeline pipeline(burst.config.pipeline);
  pipeline.set_calibration(burst.calibration);
  const RotationTrack track(burst.gyro, burst.config.gyro, *burst.config.R_cam_imu);
  PipelineRequest request;
  request.keypoints = false;
  const BurstFrame& middle = burst.frames[MIDDLE];
  const PipelineResult result =
      pipeline.process(middle.image, PixelLayout::GRAY, track, burst.exposure(MIDDLE), request);
  std::vector<float> extents;
  for (const BlockBlur& block : result.field.blocks) extents.push_back(block.extent_px);
  std::nth_element(extents.begin(), extents.begin() + extents.size() / 2, extents.end());
  report.push_back({{"median_extent_px", extents[extents.size() / 2]},
                    {"blocks", result.field.grid.size()},
                    {"deblurred", result.field.count(BlockStatus::DEBLURRED)},
                    {"rejected", result.field.count(BlockStatus::REJECTED)}});
  return {result.image.empty() ? middle.image : result.image, mean_blur(result.field)};
}

nlohmann::json evaluate_methods(const std::vector<std::pair<std::string, Detected>>& methods, const Homography& H,
                                const cv::Size& size1, const cv::Size& size2, int detections) {
  nlohmann::json report;
  for (const auto& [name, detected] : methods) {
    const Repeatability r =
        evaluate_repeatability(detected.first, size1, detected.second, size2, H, detections, OverlapOptions{});
    report[name] = {{"repeatability", r.ratio},
                    {"error_px", r.error_px},
                    {"correspondences", r.correspondences},
                    {"keypoints", {r.keypoints1, r.keypoints2}}};
  }
  return report;
}

void evaluate(const EvaluateArguments& arguments) {
  const std::filesystem::path folder(arguments.folder);
  const Burst first = load_burst((folder / "first").string()), second = load_burst((folder / "second").string());
  const PairHomography H =
      estimate_pair_homography(interpolated_points(first, arguments.protocol),
                               interpolated_points(second, arguments.protocol), arguments.protocol);
  nlohmann::json report;
  report["homography"] = {{"matches", H.matches},
                          {"inliers", H.inliers},
                          {"residual_px", H.residual_px},
                          {"H_2_1", std::vector<double>(H.H_2_1.val, H.H_2_1.val + 9)}};

  const cv::Mat &blurred1 = first.frames[MIDDLE].image, &blurred2 = second.frames[MIDDLE].image;
  nlohmann::json frames = nlohmann::json::array();
  const DeblurredMiddle middle1 = deblurred_middle(first, frames), middle2 = deblurred_middle(second, frames);
  report["frames"] = frames;
  const std::vector<std::pair<std::string, Detected>> methods = {
      {"dog", {detect_dog(blurred1), detect_dog(blurred2)}},
      {"pretto",
       {detect_motion_adapted_dog(blurred1, middle1.mean_blur),
        detect_motion_adapted_dog(blurred2, middle2.mean_blur)}},
      {"proposed", {detect_dog(middle1.image), detect_dog(middle2.image)}},
  };
  report["protocol"] = evaluate_methods(methods, H.H_2_1, blurred1.size(), blurred2.size(), arguments.detections);
  const std::vector<TruthPoint> truth = read_truth((folder / kTruthFile).string());
  if (!truth.empty()) {
    const Homography fitted = fitted_homography(truth);
    report["homography"]["error"] = homography_errors(H.H_2_1, truth);
    report["homography"]["error_of_best_homography"] = homography_errors(fitted, truth);
    report["truth"] = evaluate_methods(methods, fitted, blurred1.size(), blurred2.size(), arguments.detections);
  }

  const std::string text = report.dump(2);
  if (arguments.json.empty()) {
    std::cout << text << '\n';
    return;
  }
  std::ofstream file(arguments.json);
  file << text << '\n';
  if (!file) throw std::runtime_error(arguments.json + ": cannot be written");
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) {
  using namespace gyro_deblur::experiments;
  CLI::App app{"The paper's real-world protocol on pairs of bursts sharp - blurred - sharp of a plane.", "real_world"};
  app.require_subcommand(1);

  SimulateArguments simulate_arguments;
  simulate_arguments.sharp_noise = 8;
  CLI::App* simulate_command = app.add_subcommand("simulate", "renders a pair of bursts with known truth");
  simulate_command->add_option("SCENE1", simulate_arguments.scene1, "YAML scene of the first burst")->required();
  simulate_command->add_option("SCENE2", simulate_arguments.scene2, "YAML scene of the second burst")->required();
  simulate_command->add_option("OUT", simulate_arguments.output, "folder to write: first/, second/ and truth.csv")
      ->required();
  simulate_command->add_option("--sharp-noise", simulate_arguments.sharp_noise, "of the sharp frames [grey levels] [8]")
      ->check(CLI::Range(0.0, 64.0));

  EvaluateArguments evaluate_arguments;
  evaluate_arguments.detections = 500;
  CLI::App* evaluate_command = app.add_subcommand("evaluate", "repeatability on a pair of bursts, as JSON");
  evaluate_command->add_option("FOLDER", evaluate_arguments.folder, "with first/ and second/, see burst.hpp")
      ->required();
  evaluate_command->add_option("--json", evaluate_arguments.json, "write here instead of to standard output");
  evaluate_command->add_option("--detections", evaluate_arguments.detections, "keypoints of each image [500]")
      ->check(CLI::Range(10, 100000));
  CLI11_PARSE(app, argc, argv);
  try {
    if (*simulate_command) simulate(simulate_arguments);
    if (*evaluate_command) evaluate(evaluate_arguments);
    return 0;
  } catch (const std::exception& error) {
    std::cerr << "real_world: " << error.what() << '\n';
    return 1;
  }
}
