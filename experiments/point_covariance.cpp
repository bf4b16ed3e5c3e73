// Whether the covariances of keypoints are those of their errors, by status, extent and noise of their
// block. Writes the tables and data of doc/reports/point_covariance.md.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include <Eigen/Dense>
#include <opencv2/core.hpp>

#include "baselines.hpp"
#include "features/point_covariance.hpp"
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
  bool quick = false, quiet = false;
};

const std::vector<double> kExtentBordersPx{0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 60, 100, 500};
const std::vector<Light> kLights{{"contrast 1, noise 1", 1, 1},
                                 {"contrast 1, noise 2", 1, 2},
                                 {"contrast 1, noise 6", 1, 6},
                                 {"contrast .35, noise 4", 0.35, 4}};

/// One place that was published, and by how much it was wrong.
struct Sample {
  std::string points;  ///< what they are, and since when
  BlockStatus status = BlockStatus::SHARP;
  std::size_t light = 0;
  double extent_px = 0, angle_rad = 0;
  double radius_px = 0;
  Eigen::Vector2d error_px;
  Eigen::Matrix2d covariance_px2;
  /// Of it, by noise with a factor of 1 and kUnseenPx, and by the motion's uncertainty within the exposure.
  Eigen::Matrix2d by_noise_px2, by_motion_px2;
  Eigen::Vector2d shown_px = Eigen::Vector2d::Zero();
};

/// By what they are, status, light, and extent.
using Bin = std::tuple<std::string, BlockStatus, std::size_t, std::size_t>;

std::size_t extent_bin(double extent_px) {
  return std::upper_bound(kExtentBordersPx.begin(), kExtentBordersPx.end() - 1, extent_px) - kExtentBordersPx.begin() -
         1;
}

/// Of a bin: squares over what they ought to be, 1 where covariances are right.
struct Calibration {
  std::vector<double> squares;  ///< e^T C^-1 e
  double along = 0, across = 0, extent_px = 0, rms_along = 0, rms_across = 0;

  void add(const Sample& sample) {
    squares.push_back(sample.error_px.dot(sample.covariance_px2.inverse() * sample.error_px));
    const Eigen::Vector2d line(std::cos(sample.angle_rad), std::sin(sample.angle_rad)), normal(-line.y(), line.x());
    const auto squared = [&](const Eigen::Vector2d& axis) { return std::pow(axis.dot(sample.error_px), 2); };
    along += squared(line) / line.dot(sample.covariance_px2 * line);
    across += squared(normal) / normal.dot(sample.covariance_px2 * normal);
    rms_along += squared(line);
    rms_across += squared(normal);
    extent_px += sample.extent_px;
  }
  double count() const { return static_cast<double>(squares.size()); }
  double mean() const {
    double sum = 0;
    for (const double square : squares) sum += square;
    return sum / count() / 2;
  }
  /// Of chi^2 with two degrees of freedom half is below 2 ln 2.
  double median() const { return quantile(squares, 0.5) / (2 * std::log(2.0)); }
  /// Share within what holds 95 of 100.
  double within() const {
    const double limit = -2 * std::log(0.05);
    return static_cast<double>(
               std::count_if(squares.begin(), squares.end(), [limit](double square) { return square < limit; })) /
           count();
  }
};

class Study {
 public:
  explicit Study(const Arguments& arguments) : arguments_(arguments) {
    if (arguments.output.empty()) return;
    std::filesystem::create_directories(arguments.output);
    samples_.open(arguments.output + "/point_covariance_samples.csv");
    if (!samples_) throw std::runtime_error("cannot write into " + arguments.output);
    samples_ << "points,status,light,extent,angle,radius,ex,ey,cxx,cxy,cyy,nxx,nxy,nyy,motion,sx,sy\n";
  }

  void add(const Sample& sample) {
    bins_[{sample.points, sample.status, sample.light, extent_bin(sample.extent_px)}].add(sample);
    if (!samples_.is_open()) return;
    const Eigen::Matrix2d &c = sample.covariance_px2, &n = sample.by_noise_px2;
    char line[400];
    std::snprintf(line, sizeof(line),
                  "%s,%s,%zu,%.3f,%.4f,%.3f,%.4g,%.4g,%.5g,%.5g,%.5g,%.5g,%.5g,%.5g,%.5g,%.4g,%.4g\n",
                  sample.points.c_str(), to_string(sample.status), sample.light, sample.extent_px, sample.angle_rad,
                  sample.radius_px, sample.error_px.x(), sample.error_px.y(), c(0, 0), c(0, 1), c(1, 1), n(0, 0),
                  n(0, 1), n(1, 1), sample.by_motion_px2(0, 0), sample.shown_px.x(), sample.shown_px.y());
    samples_ << line;
  }

  void report() const {
    ResultTable table({"points", "status", "extent [px]", "light", "mean extent [px]", "points in it", "mean", "median",
                       "along", "across", "within 95 %", "error along [px]", "error across [px]"});
    for (const auto& [bin, c] : bins_) {
      const auto& [points, status, light, extent] = bin;
      table.add({points, to_string(status),
                 text_of(kExtentBordersPx[extent], 0) + " to " + text_of(kExtentBordersPx[extent + 1], 0),
                 kLights[light].name, text_of(c.extent_px / c.count(), 2), text_of(c.count(), 0), text_of(c.mean(), 3),
                 text_of(c.median(), 3), text_of(c.along / c.count(), 3), text_of(c.across / c.count(), 3),
                 text_of(c.within(), 3), text_of(std::sqrt(c.rms_along / c.count()), 3),
                 text_of(std::sqrt(c.rms_across / c.count()), 3)});
    }
    std::printf("%s", table.markdown().c_str());
    if (!arguments_.output.empty()) table.write(arguments_.output, "point_covariance");
  }

 private:
  const Arguments& arguments_;
  std::ofstream samples_;
  std::map<Bin, Calibration> bins_;
};

/// Large enough to distinguish texture from none.
constexpr double kUnseenPx = 10;
constexpr PointErrors kNoiseAlone{1, kUnseenPx, 0, 0, 0, 0, 1, 0, 0};

/// A sample without its error.
Sample sample_at(const std::string& points, const PointCovariance& covariance, const FrameBlur& field,
                 const Eigen::Vector2d& pixel_px, double radius_px, const PointErrors& errors) {
  const BlockBlur& block = field.blocks[field.grid.index_at(pixel_px.x(), pixel_px.y())];
  Sample sample;
  sample.points = points;
  sample.status = block.status;
  sample.extent_px = block.extent_px;
  sample.angle_rad = block.angle_rad;
  sample.shown_px = block.apparent_offset_px();
  sample.radius_px = radius_px;
  sample.covariance_px2 = covariance.at(pixel_px, radius_px, errors);
  sample.by_motion_px2 = covariance_of_moving(block, to_seconds(field.exposure_ns));
  sample.by_noise_px2 = covariance.at(pixel_px, radius_px, kNoiseAlone) - sample.by_motion_px2;
  return sample;
}

/// For each keypoint the one with the most similar descriptor, if that is mutual; -1: none.
std::vector<int> mutual_matches(const Features& a, const Features& b) {
  std::vector<int> matches(a.keypoints.size(), -1);
  if (a.keypoints.empty() || b.keypoints.empty()) return matches;
  std::vector<cv::DMatch> found;
  const int norm = a.descriptors.depth() == CV_8U ? cv::NORM_HAMMING : cv::NORM_L2;
  cv::BFMatcher(norm, true).match(a.descriptors, b.descriptors, found);
  for (const cv::DMatch& match : found) matches[static_cast<std::size_t>(match.queryIdx)] = match.trainIdx;
  return matches;
}

/// Keypoints of a frame against those of the sharp one, of which they have the descriptors.
void add_keypoints(const std::string& detector, std::size_t light, const cv::Mat& image, const FrameBlur& field,
                   const Features& found, const Features& moved, const Features& sharp, Study* study) {
  // Farther away it is another feature, as those who match find out: a part of a smear, and what noise does.
  constexpr double kFarPx = 2, kFarOfExtent = 0.25;
  const PointCovariance covariance(image, field);
  const std::vector<int> matches = mutual_matches(found, sharp);
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (matches[i] < 0) continue;
    const cv::KeyPoint& keypoint = found.keypoints[i];
    const cv::Point2f error = moved.keypoints[i].pt - sharp.keypoints[static_cast<std::size_t>(matches[i])].pt;
    const Eigen::Vector2d pixel_px(keypoint.pt.x, keypoint.pt.y);
    Sample sample = sample_at(detector, covariance, field, pixel_px, corner_radius_px(keypoint, detector),
                              detector == "SIFT" ? kBlobErrors : kCornerErrors);
    sample.light = light;
    sample.error_px = {error.x, error.y};
    if (sample.error_px.norm() > kFarPx + kFarOfExtent * sample.extent_px) continue;
    if (sample.covariance_px2.allFinite()) study->add(sample);
  }
}

void study_keypoints(const Arguments& arguments, Study* study) {
  const std::vector<sim::TraceSample> trace = load_hand_shake(arguments.data);
  std::string source;
  const std::vector<ImagePair> photographs = load_pairs(arguments.data, source);
  std::vector<View> views = random_views(arguments.seed, trace.back().t_s);
  std::vector<double> scales{1, 0.6, 0.3};
  const std::vector<TimeNs> exposures_ns{5'000'000, 10'000'000, 20'000'000, 30'000'000};
  if (arguments.quick) views.resize(2 * kViewsOfEach), scales.resize(1);
  Progress progress(scales.size() * exposures_ns.size(), "shakes", arguments.quiet);
  std::size_t done = 0;
  std::map<std::string, FeatureExtractor> extractors;
  for (const std::string detector : {"SIFT", "ORB"}) {
    KeypointOptions options;
    options.detector = options.descriptor = detector;
    extractors.emplace(detector, options);
  }
  for (const double scale : scales) {
    for (const TimeNs exposure_ns : exposures_ns) {
      for (std::size_t i = 0; i < views.size(); ++i) {
        const Shot shot = take_shot(kVga, trace, scale, exposure_ns, views[i], photographs);
        PipelineOptions options;
        options.optical_flow = false;  // frames are not consecutive
        Pipeline pipeline(options);
        pipeline.set_calibration(shot.simulator.scene().camera.calibration);
        PipelineRequest request;
        request.keypoints = false;
        // A view in one light, all lights in turn: those of a strength and an exposure have four of each.
        const std::size_t light = (i + i / kLights.size() + done) % kLights.size();
        const cv::Mat blurred = lit(shot.blurred, kLights[light], 1 + i);
        const cv::Mat truth = lit(shot.sharp, {"", kLights[light].contrast, 0}, 1);
        const PipelineResult result =
            pipeline.process(blurred, PixelLayout::GRAY, shot.rotation, shot.simulator.exposure(0), request);
        for (auto& [detector, extractor] : extractors) {
          const Features sharp = extractor.extract(truth);
          for (const bool deblurred : {false, true}) {
            if (deblurred && result.image.empty()) continue;
            const cv::Mat& image = deblurred ? result.image : blurred;
            const FrameBlur field = deblurred ? result.field : as_blurred(result.field);
            const Features found = extractor.extract(image);
            add_keypoints(detector, light, image, field, found, rectified(found, field, shot), sharp, study);
          }
        }
      }
      progress.done(++done);
    }
  }
}

void run(const Arguments& arguments) {
  Study study(arguments);
  study_keypoints(arguments, &study);
  study.report();
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"Whether the covariances of keypoints are those of their errors.", "point_covariance"};
  app.add_option("--out", arguments.output, "folder for the tables, and for all points");
  app.add_option("--data", arguments.data, "recorded data, with handshake_gyro/");
  app.add_option("--seed", arguments.seed, "of the times and views [1]").range(1, 1000);
  app.add_flag("--quick", arguments.quick, "eight views, at one strength");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
