// What is left of features when a hand shakes: frames exposed at random times of a recorded shake, as they arrive,
// with what is too curved for a straight path passed through, as the package deblurs them, and all by the 2-D filter.
// Writes the table of doc/reports/hand_shake.md and its pictures.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "baselines.hpp"
#include "blur/path_2d.hpp"
#include "evaluation.hpp"
#include "footage.hpp"
#include "gyro_deblur/pipeline.hpp"
#include "image_pairs.hpp"
#include "result_table.hpp"
#include "shaken_frames.hpp"
#include "sim/simulator.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string data = GYRO_DEBLUR_DATA_DIR, output;
  std::uint64_t seed = 1;
  double curved_path_threshold_px = BlurFieldOptions().curved_path_threshold_px;
  bool quick = false, quiet = false;
};

/// What becomes of a frame. STRAIGHT: one straight path for each block, one noise-to-signal ratio for
/// all noise, the paper's validation, and what is curved passed through. FOURIER: all blocks by the 2-D filter of their
/// whole path where that leaves a line by more than 2 % of its length.
enum Kind : std::size_t { SHARP, BLURRED, STRAIGHT, PACKAGE, FOURIER };
constexpr std::array<Kind, 5> kKinds{SHARP, BLURRED, STRAIGHT, PACKAGE, FOURIER};
constexpr std::array<const char*, 5> kKindNames{"sharp", "blurred", "straight", "package", "fourier"};

constexpr int kFeatures = 1000, kRepeated = 500;

/// Takes image 1 to image 2, both at the middle of their exposures.
Homography between(const Shot& shot1, const Shot& shot2) {
  const CameraCalibration& c = shot1.simulator.scene().camera.calibration;
  const Homography K(c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1);
  const auto rotation = [](const Shot& shot) {
    return shot.simulator.pose(shot.simulator.reference_time(0)).R_world_cam.toRotationMatrix();
  };
  const Eigen::Matrix3d R_1_2 = rotation(shot1).transpose() * rotation(shot2);
  // Stored by columns, and so the transpose in rows.
  return K * cv::Matx33d(R_1_2.data()) * K.inv();
}

/// What the image would be without blur and noise, every point where it says that it shows it. CV_8UC1; `inside`: where
/// that is known.
cv::Mat reference_of(const Shot& shot, const FrameBlur& field, cv::Mat* inside) {
  cv::Mat sharp, map_x(shot.sharp.size(), CV_32F), map_y(shot.sharp.size(), CV_32F);
  constexpr double kFull16 = 257;
  shot.sharp.convertTo(sharp, CV_32F, 1 / kFull16);
  for (int y = 0; y < map_x.rows; ++y) {
    for (int x = 0; x < map_x.cols; ++x) {
      Eigen::Vector2d offset_px(0, 0);
      for (const BlockGrid::Neighbour& n : field.grid.around({x, y})) {
        offset_px += n.share * field.blocks[n.index].apparent_offset_px();
      }
      map_x.at<float>(y, x) = static_cast<float>(x - offset_px.x());
      map_y.at<float>(y, x) = static_cast<float>(y - offset_px.y());
    }
  }
  cv::Mat reference;
  cv::remap(sharp, reference, map_x, map_y, cv::INTER_LANCZOS4, cv::BORDER_REPLICATE);
  *inside = (map_x >= 0) & (map_x <= sharp.cols - 1) & (map_y >= 0) & (map_y <= sharp.rows - 1);
  return reference;
}

double psnr_db(const cv::Mat& image, const cv::Mat& reference, const cv::Mat& inside) {
  cv::Mat wide;
  image.convertTo(wide, CV_32F);
  const double rms = cv::norm(wide, reference, cv::NORM_L2, inside) / std::sqrt(cv::countNonZero(inside));
  return 20 * std::log10(255 / rms);
}

/// Largest distance [px] between two places that the scene point in a pixel has during the exposure.
double true_extent_px(const Shot& shot, const Eigen::Vector2d& pixel_px) {
  const RowExposure exposure = shot.simulator.exposure(0);
  const TimeNs start_ns = exposure.start(pixel_px.y()), end_ns = exposure.end(pixel_px.y());
  const Eigen::Vector3d ray = shot.simulator.camera().ray(pixel_px);
  const auto rotation = [&](TimeNs t_ns) { return shot.simulator.pose(t_ns).R_world_cam; };
  const Eigen::Quaterniond middle = rotation(exposure.middle(pixel_px.y()));
  std::array<Eigen::Vector2d, kPathInstants> places_px;
  for (int k = 0; k < kPathInstants; ++k) {
    const TimeNs instant_ns = start_ns + (end_ns - start_ns) * k / (kPathInstants - 1);
    places_px[k] = shot.simulator.camera().project(rotation(instant_ns).conjugate() * (middle * ray));
  }
  double most_px = 0;
  for (const Eigen::Vector2d& a : places_px) {
    for (const Eigen::Vector2d& b : places_px) most_px = std::max(most_px, (a - b).norm());
  }
  return most_px;
}

struct Seen {
  cv::Mat image;
  double psnr_db = 0;
  Features sift, orb;
};

/// What the package says of a frame's blocks.
struct Blocks {
  double curved_share = 0, extent_px = 0;
  double width_px = 0;            ///< across the line of a path, mean over the blocks with a 2-D filter
  int blurred = 0, rejected = 0;  ///< with a true extent of at least min_extent, and REJECTED of these
};

Blocks blocks_of(const Shot& shot, const FrameBlur& field) {
  Blocks blocks;
  std::vector<double> extents_px;
  double curved = 0;
  for (int i = 0; i < field.grid.size(); ++i) {
    const BlockBlur& block = field.blocks[i];
    extents_px.push_back(block.extent_px);
    if (block.curved_path_px) {
      ++curved;
      blocks.width_px += extent_along(*block.curved_path_px, block.angle_rad).y();
    }
    if (true_extent_px(shot, field.grid.center(i)) < BlurFieldOptions().min_extent_px) continue;
    ++blocks.blurred;
    if (block.status == BlockStatus::REJECTED) ++blocks.rejected;
  }
  blocks.curved_share = curved / static_cast<double>(extents_px.size());
  blocks.width_px /= std::max(curved, 1.0);
  blocks.extent_px = quantile(extents_px, 0.5);
  return blocks;
}

/// One frame of one kind.
Seen see(Kind kind, const Shot& shot, double noise, std::uint64_t seed, Pipeline* pipeline, Blocks* blocks) {
  const Light light{"", 1, noise};
  Seen seen;
  if (kind == SHARP) {
    constexpr std::uint64_t kOther = 1'000'000;
    seen.image = lit(shot.sharp, light, seed + kOther);
    cv::Mat reference;
    shot.sharp.convertTo(reference, CV_32F, 1 / 257.0);
    seen.psnr_db = psnr_db(seen.image, reference, cv::Mat(reference.size(), CV_8U, cv::Scalar(255)));
    seen.sift = extract_sift(seen.image, kFeatures);
    seen.orb = extract_orb(seen.image, kFeatures);
    return seen;
  }
  const cv::Mat blurred = lit(shot.blurred, light, seed);
  PipelineRequest request;
  request.keypoints = false;
  request.behind_camera_rate = kind == STRAIGHT;
  const PipelineResult result =
      pipeline->process(blurred, PixelLayout::GRAY, shot.rotation, shot.simulator.exposure(0), request);
  const FrameBlur field = kind == BLURRED ? as_blurred(result.field) : result.field;
  seen.image = kind == BLURRED || result.image.empty() ? blurred : result.image;
  if (kind == PACKAGE) *blocks = blocks_of(shot, result.field);
  cv::Mat inside;
  const cv::Mat reference = reference_of(shot, field, &inside);
  seen.psnr_db = psnr_db(seen.image, reference, inside);
  seen.sift = rectified(extract_sift(seen.image, kFeatures), field, shot);
  seen.orb = rectified(extract_orb(seen.image, kFeatures), field, shot);
  return seen;
}

/// One figure of all frames or pairs, for each kind.
using Figures = std::array<std::vector<double>, kKinds.size()>;

double mean_of(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

/// By how many standard errors the first is above the second, pair by pair; infinite where they never differ otherwise
/// than by the mean.
double standard_errors_above(const std::vector<double>& first, const std::vector<double>& second) {
  std::vector<double> differences, squares;
  for (std::size_t i = 0; i < first.size(); ++i) differences.push_back(first[i] - second[i]);
  const double mean = mean_of(differences);
  for (const double d : differences) squares.push_back((d - mean) * (d - mean));
  const auto n = static_cast<double>(first.size());
  const double error = std::sqrt(mean_of(squares) / (n - 1));
  if (error > 0) return mean / error;
  return mean < 0 ? -std::numeric_limits<double>::infinity() : std::numeric_limits<double>::infinity();
}

std::string cell(const Figures& figures, int digits) {
  std::string text;
  for (const std::vector<double>& of_kind : figures)
    text += (text.empty() ? "" : " / ") + text_of(mean_of(of_kind), digits);
  return text;
}

/// The middle of images, with their names.
cv::Mat side_by_side(const std::vector<std::pair<const char*, cv::Mat>>& images) {
  constexpr int kWidth = 400, kHeight = 400, kGap = 4;
  cv::Mat row;
  for (const auto& [name, image] : images) {
    const cv::Rect middle((image.cols - kWidth) / 2, (image.rows - kHeight) / 2, kWidth, kHeight);
    cv::Mat crop = image(middle).clone();
    for (const auto& [grey, thickness] : {std::pair(0, 4), std::pair(255, 1)}) {
      cv::putText(crop, name, {10, kHeight - 12}, cv::FONT_HERSHEY_SIMPLEX, 0.8, cv::Scalar(grey), thickness,
                  cv::LINE_AA);
    }
    if (row.empty()) {
      row = crop;
    } else {
      cv::hconcat(std::vector<cv::Mat>{row, cv::Mat(kHeight, kGap, CV_8UC1, cv::Scalar(255)), crop}, row);
    }
  }
  return row;
}

/// What one camera, scale, exposure and noise measure.
struct Measured {
  Figures psnr_db, sift, orb, sift_sharp, orb_sharp, repeatability;
  std::vector<double> extents_px, curved_shares, widths_px;
  int blurred = 0, rejected = 0;
};

Measured measure(const std::vector<Shot>& shots, double noise,
                 std::array<std::unique_ptr<Pipeline>, kKinds.size()>& pipelines, const std::string& picture) {
  Measured m;
  std::array<std::vector<Seen>, kKinds.size()> seen;
  for (const Kind kind : kKinds) {
    for (std::size_t i = 0; i < shots.size(); ++i) {
      Blocks blocks;
      seen[kind].push_back(see(kind, shots[i], noise, 1 + i, pipelines[kind].get(), &blocks));
      m.psnr_db[kind].push_back(seen[kind].back().psnr_db);
      if (kind != PACKAGE) continue;
      m.extents_px.push_back(blocks.extent_px);
      m.curved_shares.push_back(blocks.curved_share);
      m.widths_px.push_back(blocks.width_px);
      m.blurred += blocks.blurred;
      m.rejected += blocks.rejected;
    }
  }
  if (!picture.empty()) {
    const auto most = std::max_element(m.widths_px.begin(), m.widths_px.end()) - m.widths_px.begin();
    std::vector<std::pair<const char*, cv::Mat>> images;
    for (const Kind kind : {BLURRED, STRAIGHT, PACKAGE, SHARP})
      images.emplace_back(kKindNames[kind], seen[kind][most].image);
    cv::imwrite(picture, side_by_side(images));
  }
  MatchingOptions options;
  options.max_keypoints = kFeatures;
  options.max_error_px = 3;
  const cv::Size size = shots.front().sharp.size();
  for (std::size_t i = 0; i < shots.size(); ++i) {
    for (std::size_t j = i + 1; j < shots.size() && j / kViewsOfEach == i / kViewsOfEach; ++j) {
      const Homography H = between(shots[i], shots[j]);
      const auto correct = [&](const Features& first, const Features& second) {
        return static_cast<double>(evaluate_matching(first, size, second, H, options).correct);
      };
      for (const Kind kind : kKinds) {
        const Seen &first = seen[kind][i], &second = seen[kind][j], &sharp = seen[SHARP][j];
        m.sift[kind].push_back(correct(first.sift, second.sift));
        m.orb[kind].push_back(correct(first.orb, second.orb));
        m.sift_sharp[kind].push_back(kind == SHARP ? m.sift[kind].back() : correct(first.sift, sharp.sift));
        m.orb_sharp[kind].push_back(kind == SHARP ? m.orb[kind].back() : correct(first.orb, sharp.orb));
        m.repeatability[kind].push_back(evaluate_repeatability(first.sift.keypoints, size, second.sift.keypoints, size,
                                                               H, kRepeated, OverlapOptions{})
                                            .ratio);
      }
    }
  }
  return m;
}

std::array<std::unique_ptr<Pipeline>, kKinds.size()> pipelines_for(const Shot& shot, double curved_path_threshold_px) {
  std::array<std::unique_ptr<Pipeline>, kKinds.size()> pipelines;
  for (const Kind kind : kKinds) {
    PipelineOptions options;
    options.optical_flow = false;  // frames are not consecutive
    if (kind == PACKAGE) options.blur_field.curved_path_threshold_px = curved_path_threshold_px;
    if (kind == STRAIGHT) {
      options.filter.regularization = Regularization::FIXED;
      options.validation.rule = ValidationRule::GRADIENT;
    }
    if (kind == FOURIER) {
      options.engine = "fourier";
      options.blur_field.curved_path_threshold_px = 0;
    }
    pipelines[kind] = std::make_unique<Pipeline>(options);
    pipelines[kind]->set_calibration(shot.simulator.scene().camera.calibration);
  }
  return pipelines;
}

/// A camera, how fast it shakes (1: as recorded), and in how much noise.
struct Shake {
  ShakenCamera camera;
  double scale;
  TimeNs exposure_ns;
  std::vector<double> noises;
};

std::vector<Shake> shakes_of(bool quick) {
  constexpr TimeNs kLongestNs = 30'000'000;
  if (quick) return {{kVga, 1, kLongestNs, {2, 6}}};
  std::vector<Shake> shakes{{kVga, 2, kLongestNs, {2}}};
  for (const ShakenCamera& camera : {kVga, kFullHd}) {
    for (const double scale : {1.0, 0.6, 0.3}) {
      for (const TimeNs exposure_ns : {TimeNs(10'000'000), TimeNs(20'000'000), kLongestNs}) {
        shakes.push_back({camera, scale, exposure_ns, {2, 6}});
      }
    }
  }
  return shakes;
}

/// Where the picture of a shake goes; empty: it has none.
std::string picture_of(const Shake& shake, double noise, const std::string& folder) {
  if (folder.empty() || noise != 2 || shake.exposure_ns != 30'000'000) return {};
  return folder + "/" + shake.camera.name + "_x" + text_of(shake.scale, 1) + ".png";
}

std::vector<std::string> row_of(const Shake& shake, double noise, const Measured& m) {
  const auto ratio = [](const Figures& f) {
    return text_of(mean_of(f[PACKAGE]) / std::max(mean_of(f[STRAIGHT]), 1.0), 2);
  };
  double least = std::numeric_limits<double>::infinity();
  for (const Figures* f : {&m.sift, &m.orb, &m.sift_sharp, &m.orb_sharp}) {
    least = std::min(least, standard_errors_above((*f)[PACKAGE], (*f)[BLURRED]));
  }
  return {shake.camera.name,
          text_of(shake.scale, 1),
          text_of(1e3 * to_seconds(shake.exposure_ns), 0),
          text_of(noise, 0),
          text_of(quantile(m.extents_px, 0.5), 0),
          text_of(100 * mean_of(m.curved_shares), 0),
          text_of(m.blurred > 0 ? 100.0 * m.rejected / m.blurred : 0, 1),
          cell(m.psnr_db, 1),
          cell(m.sift, 0),
          cell(m.orb, 0),
          cell(m.sift_sharp, 0),
          cell(m.orb_sharp, 0),
          cell(m.repeatability, 2),
          ratio(m.sift_sharp) + ", " + ratio(m.orb_sharp),
          text_of(least, 1)};
}

void run(const Arguments& arguments) {
  const std::vector<sim::TraceSample> trace = load_hand_shake(arguments.data);
  std::string source;
  const std::vector<ImagePair> photographs = load_pairs(arguments.data, source);
  std::vector<View> views = random_views(arguments.seed, trace.back().t_s);
  if (arguments.quick) views.resize(kViewsOfEach);
  if (!arguments.output.empty()) std::filesystem::create_directories(arguments.output);

  const std::vector<Shake> shakes = shakes_of(arguments.quick);
  ResultTable table({"camera", "shake", "exposure [ms]", "noise", "extent [px]", "curved [%]", "REJECTED [%]",
                     "PSNR [dB]", "SIFT", "ORB", "SIFT, with sharp", "ORB, with sharp", "repeatability",
                     "package over straight: SIFT, ORB with sharp", "least over blurred [standard errors]"});
  Progress progress(shakes.size(), "shakes", arguments.quiet);
  std::size_t done = 0;
  for (const Shake& shake : shakes) {
    std::vector<Shot> shots;
    for (const View& view : views) {
      shots.push_back(take_shot(shake.camera, trace, shake.scale, shake.exposure_ns, view, photographs));
    }
    auto pipelines = pipelines_for(shots.front(), arguments.curved_path_threshold_px);
    for (const double noise : shake.noises) {
      table.add(row_of(shake, noise, measure(shots, noise, pipelines, picture_of(shake, noise, arguments.output))));
    }
    progress.done(++done);
  }
  std::printf("Photographs: %s. Cells: sharp / blurred / straight / package / fourier.\n%s", source.c_str(),
              table.markdown().c_str());
  if (!arguments.output.empty()) table.write(arguments.output, "hand_shake");
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app{"Matches between frames that a recorded hand shake has blurred, before and after deblurring.",
                  "hand_shake"};
  app.add_option("--out", arguments.output, "folder for the table and pictures");
  app.add_option("--data", arguments.data, "recorded data, with handshake_gyro/");
  app.add_option("--curved-path-threshold", arguments.curved_path_threshold_px, "of the package [px]")
      .range(0.0, 100.0);
  app.add_option("--seed", arguments.seed, "of the times and views [1]");
  app.add_flag("--quick", arguments.quick, "four frames of one cell");
  app.add_flag("--quiet", arguments.quiet, "no progress");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
