// How good the features of two images are, given the homography between them.

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "evaluation.hpp"
#include "gyro_deblur/keypoints.hpp"
#include "tools/output_file.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur::experiments {
namespace {

struct Arguments {
  std::string image1, image2, homography, json;
  std::string detector = "DoG";
  int detections = 500;
  double normalized_radius_px = 30;  // Mikolajczyk et al. 2005
  OverlapOptions overlap;
  MatchingOptions matching;
};

cv::Mat read_gray(const std::string& path) {
  const cv::Mat image = cv::imread(path, cv::IMREAD_GRAYSCALE);
  if (image.empty()) throw std::runtime_error(path + ": not an image that can be read");
  return image;
}

/// DoG: all of OpenCV's SIFT keypoints with a contrast threshold of 0. Else what FeatureExtractor finds.
std::vector<cv::KeyPoint> detect(const Arguments& arguments, const cv::Mat& image) {
  if (arguments.detector == "DoG") return detect_dog(image);
  KeypointOptions options;
  options.detector = arguments.detector;
  options.descriptor = "NONE";
  // More than are compared, because some lie outside the part that both images show.
  options.max_keypoints = 100000;
  return without_duplicates(FeatureExtractor(options).extract(image).keypoints);
}

/// NaN and infinity are no numbers in JSON.
nlohmann::json number(double value) { return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(); }

nlohmann::json to_json(const Repeatability& r) {
  return {{"keypoints1", r.keypoints1},
          {"keypoints2", r.keypoints2},
          {"correspondences", r.correspondences},
          {"repeatability", r.ratio},
          {"error_px", number(r.error_px)}};
}

nlohmann::json to_json(const Matching& m) {
  return {{"matches", m.matches},
          {"correct", m.correct},
          {"homography_found", m.homography_found},
          {"corner_error_px", number(m.corner_error_px)}};
}

void print(const char* name, const Repeatability& r) {
  std::printf("%-22s %5d of %5d   repeatability %5.1f %%   error %.2f px\n", name, r.correspondences,
              std::min(r.keypoints1, r.keypoints2), 100 * r.ratio, r.error_px);
}

void print(const char* name, const Matching& m) {
  std::printf("%-22s %5d of %5d   correct              homography %s (%.1f px at the corners)\n", name, m.correct,
              m.matches, m.homography_found ? "found" : "wrong", m.corner_error_px);
}

void run(const Arguments& arguments) {
  const cv::Mat image1 = read_gray(arguments.image1), image2 = read_gray(arguments.image2);
  const Homography H = read_homography(arguments.homography);
  const auto keypoints1 = detect(arguments, image1), keypoints2 = detect(arguments, image2);
  const auto repeatability = [&](const OverlapOptions& options) {
    return evaluate_repeatability(keypoints1, image1.size(), keypoints2, image2.size(), H, arguments.detections,
                                  options);
  };
  OverlapOptions normalized = arguments.overlap;
  normalized.normalized_radius_px = arguments.normalized_radius_px;
  const Repeatability plain = repeatability(arguments.overlap), scaled = repeatability(normalized);
  const int n = arguments.matching.max_keypoints;
  const Matching sift =
      evaluate_matching(extract_sift(image1, n), image1.size(), extract_sift(image2, n), H, arguments.matching);
  const Matching orb =
      evaluate_matching(extract_orb(image1, n), image1.size(), extract_orb(image2, n), H, arguments.matching);

  print((arguments.detector + ", as detected").c_str(), plain);
  print((arguments.detector + ", normalised").c_str(), scaled);
  print("SIFT matches", sift);
  print("ORB matches", orb);
  write_json(arguments.json, {{"detector", arguments.detector},
                              {"detections", arguments.detections},
                              {"as_detected", to_json(plain)},
                              {"normalized", to_json(scaled)},
                              {"sift", to_json(sift)},
                              {"orb", to_json(orb)}});
}

int main_of(int argc, char** argv) {
  Arguments arguments;
  CommandLine app("Repeatability, localisation error and matches of two images with a known homography",
                  "evaluate_features");
  app.add_option("IMAGE1", arguments.image1).required();
  app.add_option("IMAGE2", arguments.image2).required();
  app.add_option("HOMOGRAPHY", arguments.homography, "text file, three rows of three numbers: image 1 to image 2")
      .required();
  app.add_option("--detector", arguments.detector,
                 "DoG (SIFT's, no contrast threshold), SIFT, ORB, AKAZE, BRISK, GFTT, FAST")
      .show_default();
  app.add_option("--detections", arguments.detections, "how many of the strongest are compared")
      .range(1, 100000)
      .show_default();
  app.add_option("--min-overlap", arguments.overlap.min_overlap, "intersection over union; the paper: 0.6")
      .show_default();
  app.add_option("--radius-factor", arguments.overlap.radius_factor, "radius of a disc over the keypoint's size")
      .show_default();
  app.add_option("--normalized-radius-px", arguments.normalized_radius_px, "of the normalised discs").show_default();
  app.add_option("--matching-features", arguments.matching.max_keypoints, "strongest, of each image").show_default();
  app.add_option("--max-ratio", arguments.matching.max_ratio, "of the ratio test").show_default();
  app.add_option("--max-error-px", arguments.matching.max_error_px, "of a correct match").show_default();
  app.add_option("--json", arguments.json, "also write the results as JSON");
  return run_tool(app, argc, argv, [&arguments] { run(arguments); });
}

}  // namespace
}  // namespace gyro_deblur::experiments

int main(int argc, char** argv) { return gyro_deblur::experiments::main_of(argc, argv); }
