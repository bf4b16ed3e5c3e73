// Detects and describes keypoints with OpenCV.
#include "gyro_deblur/keypoints.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include <opencv2/core/version.hpp>

#include "base/join.hpp"

namespace gyro_deblur {
namespace {

// Blurred frames have little contrast, and deblurring returns only part of it. The limit is max_keypoints, chosen by
// response; thresholds only keep the detectors from drowning in noise, and are therefore below OpenCV's defaults.
constexpr double kSiftContrastThreshold = 0.01;  // OpenCV 0.04, as Lowe 2004 (0.03); VLFeat 0
constexpr double kSiftEdgeThreshold = 10;        // Lowe 2004
constexpr double kSiftSigma = 1.6;               // Lowe 2004
constexpr int kSiftOctaveLayers = 3;             // Lowe 2004
constexpr int kFastThreshold = 5;                // grey levels; OpenCV 10 (FAST) and 20 (ORB)
constexpr float kAkazeThreshold = 1e-4f;         // OpenCV 1e-3
constexpr int kBriskThreshold = 10;              // grey levels; OpenCV 30
constexpr double kGfttQuality = 1e-3;            // of the strongest corner; OpenCV 1e-2
constexpr double kGfttMinDistancePx = 3;         // corners closer than their own 3x3 window are one corner
// ORB and GFTT choose the strongest of the whole image themselves, which may all lie in one cell of a grid; then they
// have to return everything.
constexpr int kEverything = 1000000;

// Below this no detector has room for its patch.
constexpr int kMinSidePx = 16;

/// Null for a name that is not known here.
cv::Ptr<cv::Feature2D> make_feature(const std::string& name, int wanted) {
#if GYRO_DEBLUR_SIFT  // whether OpenCV has it
  if (name == "SIFT") {
    return cv::SIFT::create(0, kSiftOctaveLayers, kSiftContrastThreshold, kSiftEdgeThreshold, kSiftSigma);
  }
#endif
  if (name == "ORB") {
    // Harris score, 8 levels 1.2 apart and 31 px patches are OpenCV's defaults, after Rublee et al. 2011.
    return cv::ORB::create(wanted, 1.2f, 8, 31, 0, 2, cv::ORB::HARRIS_SCORE, 31, kFastThreshold);
  }
  if (name == "AKAZE") return cv::AKAZE::create(cv::AKAZE::DESCRIPTOR_MLDB, 0, 3, kAkazeThreshold);
  if (name == "BRISK") return cv::BRISK::create(kBriskThreshold);
  if (name == "GFTT") return cv::GFTTDetector::create(wanted, kGfttQuality, kGfttMinDistancePx);
  if (name == "FAST") return cv::FastFeatureDetector::create(kFastThreshold);
  return nullptr;
}

std::vector<std::string> available(std::vector<std::string> names) {
  const auto absent = [](const std::string& name) { return name != "NONE" && !make_feature(name, 1); };
  names.erase(std::remove_if(names.begin(), names.end(), absent), names.end());
  return names;
}

/// Throws OptionError where OpenCV has none of that name.
cv::Ptr<cv::Feature2D> require_feature(const char* option, const std::string& name, int wanted) {
  if (cv::Ptr<cv::Feature2D> feature = make_feature(name, wanted)) return feature;
  throw OptionError(std::string(option) + " = " + name + ": OpenCV " CV_VERSION " has none; it has the detectors " +
                    join(available_detectors()) + " and the descriptors " + join(available_descriptors()));
}

bool stronger(const cv::KeyPoint& a, const cv::KeyPoint& b) {
  // The rest of the key makes the order total: several threads may deliver equal responses in any order.
  return std::make_tuple(-a.response, a.pt.y, a.pt.x, a.size, a.angle, a.octave) <
         std::make_tuple(-b.response, b.pt.y, b.pt.x, b.size, b.angle, b.octave);
}

/// Keeps at most max_keypoints of keypoints sorted by `stronger`, and their order. Every cell first gets an even share
/// of its own strongest; what cells leave goes to the strongest left anywhere.
std::vector<cv::KeyPoint> select(const std::vector<cv::KeyPoint>& sorted, const cv::Size& size,
                                 const KeypointOptions& options) {
  const std::size_t limit = static_cast<std::size_t>(options.max_keypoints);
  if (sorted.size() <= limit) return sorted;
  const int cells = options.grid * options.grid;
  const int share = options.max_keypoints / cells;
  std::vector<int> taken(cells, 0);
  std::vector<bool> keep(sorted.size(), false);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    const cv::Point2f& at = sorted[i].pt;
    const int col = std::clamp(static_cast<int>(at.x * options.grid / size.width), 0, options.grid - 1);
    const int row = std::clamp(static_cast<int>(at.y * options.grid / size.height), 0, options.grid - 1);
    int& in_cell = taken[row * options.grid + col];
    if (in_cell >= share) continue;
    ++in_cell;
    keep[i] = true;
    ++kept;
  }
  std::vector<cv::KeyPoint> selected;
  selected.reserve(limit);
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    if (keep[i] || kept++ < limit) selected.push_back(sorted[i]);
  }
  return selected;
}

/// Sorts keypoints and the rows of their descriptors by `stronger`: ORB describes level by level and reorders.
void sort_by_strength(Features& features) {
  const auto& keypoints = features.keypoints;
  if (std::is_sorted(keypoints.begin(), keypoints.end(), stronger)) return;
  std::vector<int> order(keypoints.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int a, int b) { return stronger(keypoints[a], keypoints[b]); });
  Features sorted;
  sorted.keypoints.reserve(order.size());
  sorted.descriptors.create(features.descriptors.size(), features.descriptors.type());
  for (std::size_t i = 0; i < order.size(); ++i) {
    sorted.keypoints.push_back(keypoints[order[i]]);
    features.descriptors.row(order[i]).copyTo(sorted.descriptors.row(static_cast<int>(i)));
  }
  features = sorted;
}

/// The keypoints of another detector with the octave that SIFT reads: which image of its pyramid to describe in. By
/// SIFT's own rule, size = 2 sigma 2^octave; what others store there may name an octave the pyramid does not have, and
/// OpenCV does not check.
std::vector<cv::KeyPoint> with_sift_octaves(const cv::Size& size, std::vector<cv::KeyPoint> keypoints) {
  // The last octave that OpenCV builds: a quarter of the side left, as in its own detector.
  const int last = std::max(cvRound(std::log2(std::min(size.width, size.height)) - 2), 0);
  for (cv::KeyPoint& keypoint : keypoints) {
    keypoint.octave = std::clamp(static_cast<int>(std::log2(keypoint.size / (2 * kSiftSigma))), 0, last);
  }
  return keypoints;
}

}  // namespace

std::vector<std::string> available_detectors() { return available({"SIFT", "ORB", "AKAZE", "BRISK", "GFTT", "FAST"}); }

std::vector<std::string> available_descriptors() { return available({"SIFT", "ORB", "AKAZE", "BRISK", "NONE"}); }

double corner_radius_px(const cv::KeyPoint& keypoint, const std::string& detector) {
  // Of FAST's circle and Harris's window of 7 px, at the scale at which ORB (31 px) and BRISK (12 px) look.
  constexpr double kCornerPx = 3.5, kOrbSizePx = 31, kBriskSizePx = 12;
  // 3x3 windows of differences that reach a pixel farther.
  constexpr double kGfttPx = 2.5;
  if (detector == "ORB") return kCornerPx * keypoint.size / kOrbSizePx;
  if (detector == "BRISK") return kCornerPx * keypoint.size / kBriskSizePx;
  if (detector == "FAST") return kCornerPx;
  if (detector == "GFTT") return kGfttPx;
  // Twice the scale of a blob, half of its size: a blob ends at 1.4 times its scale, and its neighbourhood counts.
  return keypoint.size;
}

FeatureExtractor::FeatureExtractor(const KeypointOptions& options) : options_(options) {
  options_.validate();
  const bool has_grid = options_.grid > 1;
  detector_ = require_feature("keypoint_detector", options_.detector, has_grid ? kEverything : options_.max_keypoints);
  if (options_.descriptor == options_.detector) {
    descriptor_ = detector_;
  } else if (options_.descriptor != "NONE") {
    descriptor_ = require_feature("keypoint_descriptor", options_.descriptor, options_.max_keypoints);
  }
}

Features FeatureExtractor::extract(const cv::Mat& luminance, const PixelMask& mask) {
  if (luminance.type() != CV_8UC1) throw std::invalid_argument("keypoints are detected on CV_8UC1 luminance");
  Features features;
  if (luminance.cols < kMinSidePx || luminance.rows < kMinSidePx) return features;

  std::vector<cv::KeyPoint> found;
  detector_->detect(luminance, found, mask.pixels());
  // GFTT of OpenCV before 4.5.5 gives no response but falls in strength: let the rank stand for it.
  const bool no_response = std::all_of(found.begin(), found.end(), [](const auto& k) { return k.response == 0; });
  if (no_response) {
    for (std::size_t i = 0; i < found.size(); ++i) found[i].response = static_cast<float>(found.size() - i);
  }
  std::sort(found.begin(), found.end(), stronger);
  features.keypoints = select(found, luminance.size(), options_);
  if (!descriptor_ || features.keypoints.empty()) return features;
  if (options_.descriptor == "SIFT" && options_.detector != "SIFT") {
    std::vector<cv::KeyPoint> given = with_sift_octaves(luminance.size(), features.keypoints);
    descriptor_->compute(luminance, given, features.descriptors);
    if (given.size() != features.keypoints.size()) throw std::logic_error("SIFT dropped keypoints it was given");
  } else {
    // Drops keypoints whose patch leaves the image, in step with the rows of the descriptors.
    descriptor_->compute(luminance, features.keypoints, features.descriptors);
  }
  sort_by_strength(features);
  return features;
}

}  // namespace gyro_deblur
