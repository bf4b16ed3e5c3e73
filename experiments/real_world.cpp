// The paper's real-world protocol (section V-B): simulates pairs of bursts sharp - blurred - sharp, and evaluates
// features on any such pair.
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "base/median.hpp"
#include "baselines.hpp"
#include "burst.hpp"
#include "evaluation.hpp"
#include "features/point_motion.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "sim/simulator.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr char kTruthFile[] = "truth.csv";
constexpr char kShutterFile[] = "shutter.csv";
// Of the methods' smoothed variants: enough to take the finest details, where deblurred images hold the most noise,
// from all of them. OpenCV's SIFT starts at 1.6 px of the image at twice its size.
constexpr double kSmoothingPx = 2;

struct SimulateArguments {
  std::string scene1, scene2, output;
  double sharp_noise = 0;
};

struct EvaluateArguments {
  std::string folder, json;
  int detections = 0;
  bool only_dog = false;
  std::vector<std::string> given;  // two images, or none
  ProtocolOptions protocol;
};

/// A point of the scene in the middle frames of both bursts: where they show it, and where a global shutter at the
/// middle of the middle row's exposure would show it.
struct TruthPoint {
  cv::Point2d first_px, second_px, first_global_px, second_global_px;
};

/// What the rolling shutter did to a frame, at the nodes of a grid from corner to corner of the image.
class ShutterTruth {
 public:
  static constexpr int kColumns = 65, kRows = 37;  // 30 px at 1920x1080: linear in between errs by less than 0.1 px

  explicit ShutterTruth(const cv::Size& size) : size_(size), shift_px_(kRows, kColumns) {}

  cv::Point2d node_px(int row, int column) const {
    return {(size_.width - 1.0) * column / (kColumns - 1), (size_.height - 1.0) * row / (kRows - 1)};
  }
  cv::Vec2d& shift_px(int row, int column) { return shift_px_(row, column); }
  const cv::Vec2d& shift_px(int row, int column) const { return shift_px_(row, column); }

  /// The pixel at which a global shutter would show what this pixel shows. Precondition: inside the image.
  cv::Point2d global(const cv::Point2d& pixel) const {
    const double c = pixel.x * (kColumns - 1) / (size_.width - 1), r = pixel.y * (kRows - 1) / (size_.height - 1);
    const int c0 = std::clamp(static_cast<int>(c), 0, kColumns - 2), r0 = std::clamp(static_cast<int>(r), 0, kRows - 2);
    const cv::Vec2d above = (c0 + 1 - c) * shift_px_(r0, c0) + (c - c0) * shift_px_(r0, c0 + 1);
    const cv::Vec2d below = (c0 + 1 - c) * shift_px_(r0 + 1, c0) + (c - c0) * shift_px_(r0 + 1, c0 + 1);
    const cv::Vec2d shift = (r0 + 1 - r) * above + (r - r0) * below;
    return pixel + cv::Point2d(shift[0], shift[1]);
  }

 private:
  cv::Size size_;
  cv::Mat_<cv::Vec2d> shift_px_;
};

cv::Point2d as_point(const Eigen::Vector2d& v) { return {v.x(), v.y()}; }

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
      if (!inside) continue;
      truth.push_back({as_point(pixel), as_point(seen),
                       as_point(first.truth_rectified(MIDDLE, pixel, first.reference_time(MIDDLE))),
                       as_point(second.truth_rectified(MIDDLE, seen, second.reference_time(MIDDLE)))});
    }
  }
  return truth;
}

void save_shutter_truth(const std::string& path, const sim::Simulator& simulator) {
  const CameraCalibration& camera = simulator.scene().camera.calibration;
  const ShutterTruth grid(cv::Size(camera.width_px, camera.height_px));
  std::ofstream file(path);
  file.precision(10);
  for (int r = 0; r < ShutterTruth::kRows; ++r) {
    for (int c = 0; c < ShutterTruth::kColumns; ++c) {
      const cv::Point2d node = grid.node_px(r, c);
      const Eigen::Vector2d global =
          simulator.truth_rectified(MIDDLE, {node.x, node.y}, simulator.reference_time(MIDDLE));
      file << global.x() - node.x << ',' << global.y() - node.y << '\n';
    }
  }
  if (!file) throw std::runtime_error(path + ": cannot be written");
}

ShutterTruth read_shutter_truth(const std::string& path, const cv::Size& size) {
  ShutterTruth truth(size);
  std::ifstream file(path);
  char comma = ',';
  for (int r = 0; r < ShutterTruth::kRows; ++r) {
    for (int c = 0; c < ShutterTruth::kColumns; ++c) {
      cv::Vec2d& shift = truth.shift_px(r, c);
      file >> shift[0] >> comma >> shift[1];
    }
  }
  if (!file) throw std::runtime_error(path + ": does not hold the lines dx,dy of the grid");
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
  save_shutter_truth((output / "first" / kShutterFile).string(), first);
  save_shutter_truth((output / "second" / kShutterFile).string(), second);
  std::ofstream file(output / kTruthFile);
  file.precision(10);
  for (const TruthPoint& p : true_correspondences(first, second)) {
    file << p.first_px.x << ',' << p.first_px.y << ',' << p.second_px.x << ',' << p.second_px.y << ','
         << p.first_global_px.x << ',' << p.first_global_px.y << ',' << p.second_global_px.x << ','
         << p.second_global_px.y << '\n';
  }
  if (!file) throw std::runtime_error((output / kTruthFile).string() + ": cannot be written");
}

/// Nothing when the file does not exist.
std::vector<TruthPoint> read_truth(const std::string& path) {
  std::vector<TruthPoint> truth;
  std::ifstream file(path);
  std::array<double, 8> v;
  while (file >> v[0]) {
    for (std::size_t i = 1; i < v.size(); ++i) file.ignore(1) >> v[i];
    if (!file) throw std::runtime_error(path + ": does not hold lines of eight numbers");
    truth.push_back({{v[0], v[1]}, {v[2], v[3]}, {v[4], v[5]}, {v[6], v[7]}});
  }
  if (file.is_open() && !file.eof()) throw std::runtime_error(path + ": does not hold lines of eight numbers");
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
  return {{"median_px", median(errors)}, {"p95_px", errors[errors.size() * 95 / 100]}};
}

/// The homography that fits best between what the frames show, or between what global shutters would show.
Homography fitted_homography(const std::vector<TruthPoint>& truth, bool global) {
  std::vector<cv::Point2d> from, to;
  for (const TruthPoint& p : truth) {
    from.push_back(global ? p.first_global_px : p.first_px);
    to.push_back(global ? p.second_global_px : p.second_px);
  }
  const cv::Mat H = cv::findHomography(from, to, 0);
  if (H.empty()) throw std::runtime_error(std::string(kTruthFile) + ": no homography fits");
  return Homography(H.ptr<double>());
}

/// Keypoints of the middle frame by one method.
struct Detected {
  std::vector<cv::KeyPoint> first, second;
};

/// What the package makes of a middle frame.
struct DeblurredMiddle {
  cv::Mat image;
  LineBlur mean_blur;  ///< over the blocks, for methods that take one blur for the whole frame
  PipelineResult result;
};

LineBlur mean_blur(const FrameBlur& field) {
  // Lines have no direction: angles are doubled for the sum.
  double x = 0, y = 0, extent = 0;
  for (const BlockBlur& block : field.blocks) {
    x += block.extent_px * std::cos(2 * block.angle_rad);
    y += block.extent_px * std::sin(2 * block.angle_rad);
    extent += block.extent_px;
  }
  return {std::atan2(y, x) / 2, extent / static_cast<double>(field.blocks.size())};
}

RotationTrack rotation_track(const Burst& burst) {
  return RotationTrack(burst.gyro, burst.config.gyro, *burst.config.R_cam_imu);
}

DeblurredMiddle deblurred_middle(const Burst& burst, nlohmann::json& report) {
  Pipeline pipeline(burst.config.pipeline);
  pipeline.set_calibration(burst.calibration);
  PipelineRequest request;
  request.keypoints = false;
  const BurstFrame& middle = burst.frames[MIDDLE];
  PipelineResult result =
      pipeline.process(middle.image, PixelLayout::GRAY, rotation_track(burst), burst.exposure(MIDDLE), request);
  std::vector<float> extents;
  for (const BlockBlur& block : result.field.blocks) extents.push_back(block.extent_px);
  report.push_back({{"median_extent_px", median(extents)},
                    {"blocks", result.field.grid.size()},
                    {"deblurred", result.field.count(BlockStatus::DEBLURRED)},
                    {"rejected", result.field.count(BlockStatus::REJECTED)},
                    {"too_curved", result.field.count(BlockStatus::TOO_CURVED)}});
  const cv::Mat image = result.image.empty() ? middle.image : result.image;
  const LineBlur blur = mean_blur(result.field);
  return {image, blur, std::move(result)};
}

/// Keypoints where `move` takes them; those that leave the image are dropped.
template <typename Move>
std::vector<cv::KeyPoint> moved(const std::vector<cv::KeyPoint>& keypoints, const cv::Size& size, const Move& move) {
  std::vector<cv::KeyPoint> result;
  for (cv::KeyPoint keypoint : keypoints) {
    keypoint.pt = move(keypoint.pt);
    const bool inside =
        keypoint.pt.x >= 0 && keypoint.pt.y >= 0 && keypoint.pt.x <= size.width - 1 && keypoint.pt.y <= size.height - 1;
    if (inside) result.push_back(keypoint);
  }
  return result;
}

/// As the package rectifies them, with the rotation and the blocks' status alone.
/// @param field  of the image that they are found in
std::vector<cv::KeyPoint> rectified(const std::vector<cv::KeyPoint>& keypoints, const Burst& burst,
                                    const DeblurredMiddle& middle, const FrameBlur& field) {
  const Camera camera(burst.calibration);
  const RotationTrack track = rotation_track(burst);
  const RowExposure exposure = burst.exposure(MIDDLE);
  return moved(keypoints, middle.image.size(), [&](const cv::Point2f& pixel) {
    const RectifiedPoint point = rectify_points({Eigen::Vector2d(pixel.x, pixel.y)}, field, camera, track, exposure,
                                                middle.result.reference_ns)[0];
    return cv::Point2f(as_point(point.rectified_px));
  });
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

/// Keypoints of a smoothed image.
std::vector<cv::KeyPoint> detect_smoothed_dog(const cv::Mat& image) {
  cv::Mat smoothed;
  cv::GaussianBlur(image, smoothed, {}, kSmoothingPx);
  return detect_dog(smoothed);
}

cv::Mat read_like(const std::string& path, const cv::Mat& frame) {
  const cv::Mat image = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (image.size() == frame.size()) return image;
  throw std::runtime_error(path + ": expected an image of " + std::to_string(frame.cols) + " x " +
                           std::to_string(frame.rows) + " px, as the blurred frame's, found " +
                           std::to_string(image.cols) + " x " + std::to_string(image.rows));
}

void evaluate(const EvaluateArguments& arguments) {
  const std::filesystem::path folder(arguments.folder);
  const Burst first = load_burst((folder / "first").string()), second = load_burst((folder / "second").string());
  nlohmann::json report;
  const cv::Mat &blurred1 = first.frames[MIDDLE].image, &blurred2 = second.frames[MIDDLE].image;
  nlohmann::json frames = nlohmann::json::array();
  std::vector<std::pair<std::string, Detected>> methods = {{"dog", {detect_dog(blurred1), detect_dog(blurred2)}}};
  std::vector<std::pair<std::string, Detected>> rectified_methods;
  if (!arguments.only_dog) {
    const DeblurredMiddle middle1 = deblurred_middle(first, frames), middle2 = deblurred_middle(second, frames);
    methods.push_back({"pretto",
                       {detect_motion_adapted_dog(blurred1, middle1.mean_blur),
                        detect_motion_adapted_dog(blurred2, middle2.mean_blur)}});
    methods.push_back({"proposed", {detect_dog(middle1.image), detect_dog(middle2.image)}});
    // Smoothing alone raises the repeatability of any method: what the table says is not to come from it.
    methods.push_back({"dog_smoothed", {detect_smoothed_dog(blurred1), detect_smoothed_dog(blurred2)}});
    methods.push_back({"proposed_smoothed", {detect_smoothed_dog(middle1.image), detect_smoothed_dog(middle2.image)}});
    for (const auto& [name, detected] : methods) {
      const bool deblurred = name.rfind("proposed", 0) == 0;
      const FrameBlur &field1 = middle1.result.field, &field2 = middle2.result.field;
      rectified_methods.push_back(
          {name,
           {rectified(detected.first, first, middle1, deblurred ? field1 : as_blurred(field1)),
            rectified(detected.second, second, middle2, deblurred ? field2 : as_blurred(field2))}});
    }
  }
  if (!arguments.given.empty()) {
    methods.push_back(
        {"given",
         {detect_dog(read_like(arguments.given[0], blurred1)), detect_dog(read_like(arguments.given[1], blurred2))}});
  }
  report["frames"] = frames;
  const cv::Size size1 = blurred1.size(), size2 = blurred2.size();
  const std::vector<TruthPoint> truth = read_truth((folder / kTruthFile).string());
  if (!arguments.only_dog) {
    const PairHomography H =
        estimate_pair_homography(interpolated_points(first, arguments.protocol),
                                 interpolated_points(second, arguments.protocol), arguments.protocol);
    report["homography"] = {{"matches", H.matches},
                            {"inliers", H.inliers},
                            {"residual_px", H.residual_px},
                            {"H_2_1", std::vector<double>(H.H_2_1.val, H.H_2_1.val + 9)}};
    if (!truth.empty()) report["homography"]["error"] = homography_errors(H.H_2_1, truth);
    report["protocol"] = evaluate_methods(methods, H.H_2_1, size1, size2, arguments.detections);
  }
  if (!truth.empty()) {
    const Homography fitted = fitted_homography(truth, false), global = fitted_homography(truth, true);
    report["homography"]["error_of_best_homography"] = homography_errors(fitted, truth);
    report["best_homography"] = evaluate_methods(methods, fitted, size1, size2, arguments.detections);
    const ShutterTruth shutter1 = read_shutter_truth((folder / "first" / kShutterFile).string(), size1);
    const ShutterTruth shutter2 = read_shutter_truth((folder / "second" / kShutterFile).string(), size2);
    for (auto& [name, detected] : methods) {
      detected.first =
          moved(detected.first, size1, [&](const cv::Point2f& p) { return cv::Point2f(shutter1.global(p)); });
      detected.second =
          moved(detected.second, size2, [&](const cv::Point2f& p) { return cv::Point2f(shutter2.global(p)); });
    }
    report["truth"] = evaluate_methods(methods, global, size1, size2, arguments.detections);
    report["rectified"] = evaluate_methods(rectified_methods, global, size1, size2, arguments.detections);
  }

  if (arguments.json.empty()) std::cout << report.dump(2) << '\n';
  write_json(arguments.json, report);
}

int simulate_main(int argc, char** argv) {
  SimulateArguments arguments;
  arguments.sharp_noise = 8;
  CommandLine app{"Renders a pair of bursts with known truth.", "real_world simulate"};
  app.add_option("SCENE1", arguments.scene1, "YAML scene of the first burst").required();
  app.add_option("SCENE2", arguments.scene2, "YAML scene of the second burst").required();
  app.add_option("OUT", arguments.output, "folder to write: first/, second/ and truth.csv").required();
  app.add_option("--sharp-noise", arguments.sharp_noise, "of the sharp frames [grey levels] [8]").range(0.0, 64.0);
  return run_tool(app, argc, argv, [&arguments] { simulate(arguments); });
}

int evaluate_main(int argc, char** argv) {
  EvaluateArguments arguments;
  arguments.detections = 500;
  CommandLine app{"Repeatability on a pair of bursts, as JSON.", "real_world evaluate"};
  app.add_option("FOLDER", arguments.folder, "with first/ and second/, see burst.hpp").required();
  app.add_option("--json", arguments.json, "write here instead of to standard output");
  app.add_option("--detections", arguments.detections, "keypoints of each image [500]").range(10, 100000);
  app.add_flag("--only-dog", arguments.only_dog, "the baseline DoG alone, without the protocol's homography");
  app.add_option("--given", arguments.given,
                 "two images to compare with the rest, made from the blurred frames in another way")
      .values(2);
  return run_tool(app, argc, argv, [&arguments] { evaluate(arguments); });
}

/// The paper's real-world protocol on pairs of bursts sharp - blurred - sharp of a plane.
int main_of(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "simulate") return simulate_main(argc - 1, argv + 1);
  if (command == "evaluate") return evaluate_main(argc - 1, argv + 1);
  std::cerr << "usage: real_world simulate ..., or real_world evaluate ...; each has --help\n";
  return command == "-h" || command == "--help" ? SUCCESS : BAD_USAGE;
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
