// Features of a simulated sequence for the paper's reconstruction experiment (section V-C): SIFT on the blurred frames
// and on the deblurred ones, each raw and rectified, with the true poses.
#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <opencv2/imgcodecs.hpp>

#include "baselines.hpp"
#include "blur/frame_quality.hpp"
#include "feature_files.hpp"
#include "features/point_motion.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "sim/simulator.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string scene, output;
  int frames = 0;       // 0: as the scene says
  int first_frame = 0;  // of the scene
  int step = 1;         // from frame to frame
  int max_keypoints = 0;
  int image_period = 0;  // 0: no images
  bool quiet = false;
};

std::vector<Eigen::Vector2d> positions(const std::vector<cv::KeyPoint>& keypoints) {
  std::vector<Eigen::Vector2d> points;
  for (const cv::KeyPoint& keypoint : keypoints) points.emplace_back(keypoint.pt.x, keypoint.pt.y);
  return points;
}

/// The features whose contrast is that of SIFT in VisualSFM and COLMAP (SiftGPU's peak threshold, 0.02 over the three
/// layers of an octave). They are sorted by it.
void drop_weak(Features& features) {
  constexpr float kPeakThreshold = 0.02f / 3;
  std::vector<cv::KeyPoint>& keypoints = features.keypoints;
  const auto end = std::find_if(keypoints.begin(), keypoints.end(),
                                [](const cv::KeyPoint& keypoint) { return keypoint.response < kPeakThreshold; });
  keypoints.erase(end, keypoints.end());
  features.descriptors.resize(keypoints.size());
}

std::string frame_name(int i) {
  const std::string digits = std::to_string(i);
  return "frame_" + std::string(digits.size() < 4 ? 4 - digits.size() : 0, '0') + digits;
}

void run(const Arguments& arguments) {
  sim::Scene scene = sim::load_scene(arguments.scene);
  if (scene.camera.encoding != "mono8") throw OptionError(arguments.scene + ": camera.encoding must be mono8");
  std::vector<int> frames;
  for (int i = arguments.first_frame; i < scene.frames; i += arguments.step) frames.push_back(i);
  if (static_cast<int>(frames.size()) < std::max(1, arguments.frames)) {
    throw OptionError(arguments.scene + " has " + std::to_string(scene.frames) + " frames: there are only " +
                      std::to_string(frames.size()) + " in steps of " + std::to_string(arguments.step) +
                      " from frame " + std::to_string(arguments.first_frame));
  }
  if (arguments.frames > 0) frames.resize(static_cast<std::size_t>(arguments.frames));
  sim::Simulator simulator(std::move(scene));
  const sim::ImuModel& imu = simulator.scene().imu;

  PipelineOptions options;
  options.keypoints.max_keypoints = arguments.max_keypoints;
  Pipeline pipeline(options);
  pipeline.set_calibration(simulator.camera().calibration());
  GyroOptions gyro;
  gyro.bias_rad_s = imu.gyro_bias_rad_s;
  gyro.time_offset_ns = imu.time_offset_ns;
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& sample : simulator.imu()) samples.push_back({sample.t_ns, sample.rate_rad_s});
  const RotationTrack track(samples, gyro, imu.R_cam_imu);
  FeatureExtractor extractor(options.keypoints);

  const std::filesystem::path output(arguments.output);
  for (const char* folder : {"blurred", "deblurred", "images"}) std::filesystem::create_directories(output / folder);
  std::ofstream truth(output / "truth.csv");
  truth.precision(12);
  truth << "frame,t_s,qw,qx,qy,qz,x_m,y_m,z_m,rate_rad_s,median_extent_px,blocks,deblurred,rejected,"
           "keypoints_blurred,keypoints_deblurred\n";
  const CameraCalibration& camera = simulator.camera().calibration();
  std::ofstream(output / "camera.csv") << "width_px,height_px,fx_px,fy_px,cx_px,cy_px\n"
                                       << camera.width_px << ',' << camera.height_px << ',' << camera.fx_px << ','
                                       << camera.fy_px << ',' << camera.cx_px << ',' << camera.cy_px << '\n';

  Progress progress(frames.size(), "frames", arguments.quiet);
  std::size_t done = 0;
  for (const int i : frames) {
    const sim::Frame frame = simulator.frame(i);
    const RowExposure exposure = simulator.exposure(i);
    PipelineResult result = pipeline.process(frame.image, PixelLayout::GRAY, track, exposure, PipelineRequest{});
    drop_weak(result.features);
    result.points.resize(result.features.keypoints.size());
    const std::string name = frame_name(i);
    write_features((output / "deblurred" / name).string(), result.features, result.points);
    Features blurred = extractor.extract(frame.image);
    drop_weak(blurred);
    write_features((output / "blurred" / name).string(), blurred,
                   rectify_points(positions(blurred.keypoints), as_blurred(result.field), simulator.camera(), track,
                                  exposure, result.reference_ns));
    if (arguments.image_period > 0 && i % arguments.image_period == 0) {
      cv::imwrite((output / "images" / (name + "_blurred.png")).string(), frame.image);
      const cv::Mat& image = result.image.empty() ? frame.image : result.image;
      cv::imwrite((output / "images" / (name + "_deblurred.png")).string(), image);
    }
    const sim::Pose pose = simulator.pose(result.reference_ns);
    const double t_s = to_seconds(result.reference_ns - simulator.scene().start_ns);
    truth << i << ',' << t_s << ',' << pose.R_world_cam.w() << ',' << pose.R_world_cam.x() << ','
          << pose.R_world_cam.y() << ',' << pose.R_world_cam.z() << ',' << pose.p_world_m.x() << ','
          << pose.p_world_m.y() << ',' << pose.p_world_m.z() << ',' << simulator.scene().motion->rate(t_s).norm() << ','
          << median_extent_px(result.field, [](BlockStatus) { return true; }) << ',' << result.field.grid.size() << ','
          << result.field.count(BlockStatus::DEBLURRED) << ',' << result.field.count(BlockStatus::REJECTED) << ','
          << blurred.keypoints.size() << ',' << result.features.keypoints.size() << '\n';
    progress.done(++done);
  }
  if (!truth) throw std::runtime_error((output / "truth.csv").string() + ": cannot be written");
}

int main_of(int argc, char** argv) {
  CommandLine app{
      "SIFT features of a simulated sequence, blurred and deblurred, raw and rectified, and the true poses.",
      "reconstruction"};
  Arguments arguments;
  arguments.max_keypoints = 8192;  // SiftGPU's limit
  app.add_option("SCENE", arguments.scene, "YAML scene; config/scenes/handheld.yaml documents the keys").required();
  app.add_option("OUT", arguments.output, "folder to write: blurred/, deblurred/, images/, truth.csv, camera.csv")
      .required();
  app.add_option("--frames", arguments.frames, "how many [all]").range(1, 1000000);
  app.add_option("--first-frame", arguments.first_frame, "of the scene [0]").range(0, 1000000);
  app.add_option("--step", arguments.step, "from frame to frame [1]").range(1, 1000000);
  app.add_option("--max-features", arguments.max_keypoints, "of each frame [8192]").range(10, 100000);
  app.add_option("--image-period", arguments.image_period, "write every n-th image [none]").range(1, 1000000);
  app.add_flag("--quiet", arguments.quiet, "no progress on stderr");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
