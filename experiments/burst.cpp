#include "burst.hpp"
#include "base/require_range.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/gyro_buffer.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <tuple>
#include <utility>

#include <yaml-cpp/yaml.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>

namespace gyro_deblur::experiments {
namespace {

constexpr char kDescription[] = "burst.yaml";
constexpr int kFrames = 3;

// The value of a key, which must be there.
template <typename T>
T read(const YAML::Node& node, const char* key, const std::string& path, const char* expected) {
  try {
    if (node[key]) return node[key].as<T>();
  } catch (const YAML::Exception&) {
    throw OptionError(path + ": " + key + " is not " + expected);
  }
  throw OptionError(path + ": " + key + " is missing; expected " + expected);
}

template <typename T>
std::vector<T> read_list(const YAML::Node& node, const char* key, std::size_t count, const std::string& path,
                         const char* expected) {
  const auto list = read<std::vector<T>>(node, key, path, expected);
  if (list.size() != count) {
    throw OptionError(path + ": " + key + " has " + std::to_string(list.size()) + " entries, expected " + expected);
  }
  return list;
}

// Nearest neighbours by Euclidean distance that pass the ratio test.
std::vector<cv::DMatch> ratio_matches(const cv::Mat& descriptors1, const cv::Mat& descriptors2, double max_ratio) {
  std::vector<cv::DMatch> matches;
  if (descriptors1.empty() || descriptors2.rows < 2) return matches;  // no second nearest, no ratio
  std::vector<std::vector<cv::DMatch>> nearest;
  cv::BFMatcher(cv::NORM_L2).knnMatch(descriptors1, descriptors2, nearest, 2);
  for (const std::vector<cv::DMatch>& two : nearest) {
    if (two[0].distance <= max_ratio * two[1].distance) matches.push_back(two[0]);
  }
  return matches;
}

constexpr std::size_t kMinPoints = 4;  // of a homography

}  // namespace

RowExposure Burst::exposure(BurstIndex frame) const {
  ShutterTiming timing = config.shutter;
  timing.exposure_ns = frames[frame].exposure_ns;
  return RowExposure(frames[frame].stamp_ns, calibration.height_px, timing);
}

Burst load_burst(const std::string& folder) {
  const std::string path = (std::filesystem::path(folder) / kDescription).string();
  YAML::Node node;
  try {
    node = YAML::LoadFile(path);
  } catch (const YAML::Exception& error) {
    throw OptionError(path + " cannot be read: " + error.what());
  }
  if (!node.IsMap()) throw OptionError(path + " is not a map of keys");

  Burst burst;
  const auto size = read_list<int>(node, "size", 2, path, "[width, height]");
  const auto k = read_list<double>(node, "intrinsics", 4, path, "[fx, fy, cx, cy]");
  CameraCalibration& c = burst.calibration;
  std::tie(c.width_px, c.height_px) = std::make_pair(size[0], size[1]);
  std::tie(c.fx_px, c.fy_px, c.cx_px, c.cy_px) = std::make_tuple(k[0], k[1], k[2], k[3]);
  if (node["distortion_model"]) {
    c.model = require_distortion_model(read<std::string>(node, "distortion_model", path, "a name"));
  }
  if (node["distortion_coefficients"]) {
    c.coefficients = read<std::vector<double>>(node, "distortion_coefficients", path, "a list of numbers");
  }
  std::vector<std::string> unknown;
  try {
    c.validate();
    burst.config = parse_config(YAML::Dump(node["config"]), &unknown);
  } catch (const OptionError& error) {
    throw OptionError(path + ": " + error.what());
  }
  if (!unknown.empty()) throw OptionError(path + ": config." + unknown.front() + " is not a known key");
  if (!burst.config.R_cam_imu) throw OptionError(path + ": config.R_cam_imu is missing");

  for (const auto& line : read<std::vector<YAML::Node>>(node, "gyro", path, "a list of [t, wx, wy, wz]")) {
    constexpr std::size_t kColumns = 4;
    if (!line.IsSequence() || line.size() != kColumns) {
      throw OptionError(path + ": gyro[" + std::to_string(burst.gyro.size()) + "] is not [t, wx, wy, wz]");
    }
    burst.gyro.push_back(
        {line[0].as<TimeNs>(), Eigen::Vector3d(line[1].as<double>(), line[2].as<double>(), line[3].as<double>())});
  }

  const auto images = read_list<std::string>(node, "images", kFrames, path, "three file names");
  const auto stamps = read_list<TimeNs>(node, "stamps", kFrames, path, "three times in ns");
  const auto exposures = read_list<double>(node, "exposure_times", kFrames, path, "three times in s");
  for (int i = 0; i < kFrames; ++i) {
    BurstFrame& frame = burst.frames[i];
    const std::string image_path = (std::filesystem::path(folder) / images[i]).string();
    frame.image = cv::imread(image_path, cv::IMREAD_GRAYSCALE);
    if (frame.image.empty()) throw OptionError(image_path + " cannot be read as an image");
    if (frame.image.cols != size[0] || frame.image.rows != size[1]) {
      throw OptionError(image_path + " has " + std::to_string(frame.image.cols) + "x" +
                        std::to_string(frame.image.rows) + " px, but size in " + path + " is " +
                        std::to_string(size[0]) + "x" + std::to_string(size[1]));
    }
    frame.stamp_ns = stamps[i];
    require_range((path + ": exposure_times").c_str(), exposures[i], 1e-6, 1, "s");
    frame.exposure_ns = to_ns(exposures[i]);
    if (i > 0 && stamps[i] <= stamps[i - 1]) throw OptionError(path + ": stamps do not increase");
  }
  return burst;
}

void save_burst(const std::string& folder, const Burst& burst) {
  constexpr int kDigits = 17;  // what a double needs to come back the same
  const char* const names[kFrames] = {"first.png", "middle.png", "last.png"};
  YAML::Emitter out;
  out.SetDoublePrecision(kDigits);
  out << YAML::BeginMap;
  out << YAML::Key << "images" << YAML::Value << YAML::Flow << std::vector<std::string>(names, names + kFrames);
  out << YAML::Key << "stamps" << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const BurstFrame& frame : burst.frames) out << frame.stamp_ns;
  out << YAML::EndSeq << YAML::Key << "exposure_times" << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const BurstFrame& frame : burst.frames) out << to_seconds(frame.exposure_ns);
  out << YAML::EndSeq;
  const CameraCalibration& c = burst.calibration;
  out << YAML::Key << "size" << YAML::Value << YAML::Flow << std::vector<int>{c.width_px, c.height_px};
  out << YAML::Key << "intrinsics" << YAML::Value << YAML::Flow
      << std::vector<double>{c.fx_px, c.fy_px, c.cx_px, c.cy_px};
  out << YAML::Key << "distortion_model" << YAML::Value << c.model;
  out << YAML::Key << "distortion_coefficients" << YAML::Value << YAML::Flow << c.coefficients;

  const Config& config = burst.config;
  if (!config.R_cam_imu) throw std::logic_error("save_burst: the burst has no R_cam_imu");
  const char* const rows[] = {"first", "middle", "last"};
  const char* const phases[] = {"start", "middle", "end"};
  out << YAML::Key << "config" << YAML::Value << YAML::BeginMap;
  out << YAML::Key << "readout_time" << YAML::Value << to_seconds(config.shutter.readout_ns);
  out << YAML::Key << "stamp_row" << YAML::Value << rows[static_cast<int>(config.shutter.stamp_row)];
  out << YAML::Key << "stamp_phase" << YAML::Value << phases[static_cast<int>(config.shutter.stamp_phase)];
  out << YAML::Key << "time_offset" << YAML::Value << to_seconds(config.gyro.time_offset_ns);
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> R = *config.R_cam_imu;
  out << YAML::Key << "R_cam_imu" << YAML::Value << YAML::Flow << std::vector<double>(R.data(), R.data() + R.size());
  const Eigen::Vector3d& bias = config.gyro.bias_rad_s;
  out << YAML::Key << "gyro_bias" << YAML::Value << YAML::Flow << std::vector<double>{bias.x(), bias.y(), bias.z()};
  out << YAML::EndMap;

  out << YAML::Key << "gyro" << YAML::Value << YAML::BeginSeq;
  for (const GyroSample& sample : burst.gyro) {
    out << YAML::Flow << YAML::BeginSeq << sample.t_ns << sample.rate_rad_s.x() << sample.rate_rad_s.y()
        << sample.rate_rad_s.z() << YAML::EndSeq;
  }
  out << YAML::EndSeq << YAML::EndMap;

  const std::string path = (std::filesystem::path(folder) / kDescription).string();
  std::ofstream file(path);
  file << out.c_str() << '\n';
  if (!file) throw std::runtime_error(path + ": cannot be written");
  for (int i = 0; i < kFrames; ++i) {
    const std::string image_path = (std::filesystem::path(folder) / names[i]).string();
    if (!cv::imwrite(image_path, burst.frames[i].image, {cv::IMWRITE_PNG_COMPRESSION, 1})) {
      throw std::runtime_error(image_path + ": cannot be written");
    }
  }
}

Eigen::Vector2d interpolate_to_middle(const Eigen::Vector2d& first_px, const Eigen::Vector2d& last_px,
                                      const Burst& burst) {
  const RowExposure middle = burst.exposure(MIDDLE);
  const TimeNs first_ns = burst.exposure(FIRST).middle(first_px.y());
  // Seconds since the point was seen in the first frame.
  const double duration_s = to_seconds(burst.exposure(LAST).middle(last_px.y()) - first_ns);
  const Eigen::Vector2d velocity_px_s = (last_px - first_px) / duration_s;
  // The middle frame exposes row y at row0 + slope * y, and the point is in row y0 + v t: solve for t.
  const double row0_s = to_seconds(middle.middle(0) - first_ns);
  const double slope_s_px = to_seconds(burst.config.shutter.readout_ns) / burst.calibration.height_px;
  const double t_s = (row0_s + slope_s_px * first_px.y()) / (1 - slope_s_px * velocity_px_s.y());
  return first_px + t_s * velocity_px_s;
}

void ProtocolOptions::validate() const {
  require_range("max_keypoints", max_keypoints, 10, 100000);
  require_range("max_ratio", max_ratio, 1e-6, 1);
  require_range("burst_ransac", burst_ransac_px, 1e-6, 100, "px");
  require_range("pair_ransac", pair_ransac_px, 1e-6, 100, "px");
}

BurstPoints interpolated_points(const Burst& burst, const ProtocolOptions& options) {
  options.validate();
  const Features first = extract_sift(burst.frames[FIRST].image, options.max_keypoints);
  const Features last = extract_sift(burst.frames[LAST].image, options.max_keypoints);
  const auto matches = ratio_matches(first.descriptors, last.descriptors, options.max_ratio);
  std::vector<cv::Point2f> points1, points2;
  for (const cv::DMatch& match : matches) {
    points1.push_back(first.keypoints[match.queryIdx].pt);
    points2.push_back(last.keypoints[match.trainIdx].pt);
  }
  BurstPoints result;
  if (matches.size() < kMinPoints) return result;
  std::vector<uchar> inlier;
  if (cv::findHomography(points1, points2, cv::RANSAC, options.burst_ransac_px, inlier).empty()) return result;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (inlier[i] == 0) continue;
    const Eigen::Vector2d middle =
        interpolate_to_middle({points1[i].x, points1[i].y}, {points2[i].x, points2[i].y}, burst);
    result.middle_px.emplace_back(static_cast<float>(middle.x()), static_cast<float>(middle.y()));
    result.descriptors.push_back(first.descriptors.row(matches[i].queryIdx));
  }
  return result;
}

PairHomography estimate_pair_homography(const BurstPoints& points1, const BurstPoints& points2,
                                        const ProtocolOptions& options) {
  options.validate();
  std::vector<cv::Point2f> from, to;
  for (const cv::DMatch& match : ratio_matches(points1.descriptors, points2.descriptors, options.max_ratio)) {
    from.push_back(points1.middle_px[match.queryIdx]);
    to.push_back(points2.middle_px[match.trainIdx]);
  }
  PairHomography result;
  result.matches = static_cast<int>(from.size());
  std::vector<uchar> inlier;
  const cv::Mat H =
      from.size() < kMinPoints ? cv::Mat() : cv::findHomography(from, to, cv::RANSAC, options.pair_ransac_px, inlier);
  if (H.empty()) {
    throw std::runtime_error("no homography between the bursts: " + std::to_string(points1.middle_px.size()) + " and " +
                             std::to_string(points2.middle_px.size()) + " points, " + std::to_string(from.size()) +
                             " matches");
  }
  result.H_2_1 = Homography(H.ptr<double>());
  double sum = 0;
  for (std::size_t i = 0; i < from.size(); ++i) {
    if (inlier[i] == 0) continue;
    ++result.inliers;
    const cv::Point2d error = project(result.H_2_1, from[i]) - cv::Point2d(to[i]);
    sum += error.dot(error);
  }
  result.residual_px = std::sqrt(sum / result.inliers);
  return result;
}

}  // namespace gyro_deblur::experiments
