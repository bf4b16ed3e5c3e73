#include "evaluation.hpp"

#include <cmath>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/options.hpp"
#include "run_program.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::experiments {
namespace {

const cv::Size kSize(400, 300);
const Homography kIdentity = Homography::eye();

Homography translation(double dx, double dy) { return {1, 0, dx, 0, 1, dy, 0, 0, 1}; }
Homography scaling(double factor) { return {factor, 0, 0, 0, factor, 0, 0, 0, 1}; }

cv::KeyPoint keypoint(double x, double y, double size, double response = 1) {
  return {static_cast<float>(x), static_cast<float>(y), static_cast<float>(size), -1, static_cast<float>(response)};
}

/// Discs that do not touch each other, the strongest first.
std::vector<cv::KeyPoint> lattice(double size = 8) {
  std::vector<cv::KeyPoint> keypoints;
  for (int y = 30; y <= 270; y += 30) {
    for (int x = 30; x <= 370; x += 30) keypoints.push_back(keypoint(x, y, size, 1000.0 - keypoints.size()));
  }
  return keypoints;
}

std::vector<cv::KeyPoint> moved(std::vector<cv::KeyPoint> keypoints, const Homography& H, double size_factor = 1) {
  for (cv::KeyPoint& k : keypoints) {
    k.size *= static_cast<float>(size_factor * local_scale(H, k.pt));
    k.pt = project(H, k.pt);
  }
  return keypoints;
}

TEST(DiscOverlap, AgreesWithCountingPixels) {
  for (const double r : {3.0, 7.0}) {
    for (const double s : {3.0, 4.5, 12.0}) {
      for (const double d : {0.0, 0.5, 2.0, 5.0, 8.9, 14.0, 25.0}) {
        constexpr double kStep = 0.02;
        long both = 0, either = 0;
        for (double y = -r - s; y <= r + s; y += kStep) {
          for (double x = -r - s; x <= d + r + s; x += kStep) {
            const bool in1 = x * x + y * y <= r * r, in2 = (x - d) * (x - d) + y * y <= s * s;
            both += in1 && in2;
            either += in1 || in2;
          }
        }
        EXPECT_NEAR(disc_overlap(r, s, d), static_cast<double>(both) / either, 2e-3) << r << " " << s << " " << d;
      }
    }
  }
}

TEST(DiscOverlap, HasItsLimits) {
  EXPECT_EQ(disc_overlap(5, 5, 0), 1);
  EXPECT_EQ(disc_overlap(5, 5, 10), 0);
  EXPECT_EQ(disc_overlap(2, 4, 1), 0.25);  // one inside the other
  EXPECT_NEAR(disc_overlap(2, 4, 2), 0.25, 1e-12);
  EXPECT_NEAR(disc_overlap(2, 4, 2 + 1e-9), 0.25, 1e-6);
}

TEST(LocalScale, IsTheJacobiansDeterminant) {
  const Homography H(0.88, 0.31, -39, -0.18, 0.94, 153, 2e-4, -1.6e-5, 1);
  const cv::Point2d p(120, 75);
  constexpr double kStep = 1e-4;
  const cv::Point2d dx = (project(H, p + cv::Point2d(kStep, 0)) - project(H, p - cv::Point2d(kStep, 0))) / (2 * kStep);
  const cv::Point2d dy = (project(H, p + cv::Point2d(0, kStep)) - project(H, p - cv::Point2d(0, kStep))) / (2 * kStep);
  EXPECT_NEAR(local_scale(H, p), std::sqrt(std::abs(dx.x * dy.y - dx.y * dy.x)), 1e-6);
  EXPECT_NEAR(local_scale(scaling(0.7), p), 0.7, 1e-12);
}

TEST(Homography, IsReadAndRefused) {
  const std::string path = testing::TempDir() + "homography.txt";
  std::ofstream(path) << "1 0 5\n0 2 -3e0\n1e-6 0 1\n";
  EXPECT_EQ(read_homography(path), Homography(1, 0, 5, 0, 2, -3, 1e-6, 0, 1));
  std::ofstream(path) << "1 0 5\n0 2\n";
  EXPECT_THROW(read_homography(path), std::runtime_error);
  std::ofstream(path) << "1 0 5\n1 0 5\n0 0 1\n";
  EXPECT_THROW(read_homography(path), std::runtime_error);
  EXPECT_THROW(read_homography(path + ".absent"), std::runtime_error);
}

TEST(Keypoints, OfOnePlaceAndScaleCountOnce) {
  std::vector<cv::KeyPoint> keypoints = {keypoint(10, 10, 4), keypoint(10, 10, 4), keypoint(10, 10, 5),
                                         keypoint(11, 10, 4)};
  keypoints[1].angle = 90;
  const auto unique = without_duplicates(keypoints);
  ASSERT_EQ(unique.size(), 3u);
  EXPECT_EQ(unique[0].angle, -1);
  EXPECT_EQ(unique[1].size, 5);
}

TEST(Keypoints, AreChosenByResponseWhereBothImagesSee) {
  const std::vector<cv::KeyPoint> keypoints = {keypoint(10, 10, 4, 1), keypoint(390, 10, 4, 9), keypoint(20, 10, 4, 3),
                                               keypoint(30, 10, 4, 2)};
  const auto chosen = strongest_in_common_region(keypoints, translation(15, 0), kSize, 2);
  ASSERT_EQ(chosen.size(), 2u);
  EXPECT_EQ(chosen[0].pt.x, 20);
  EXPECT_EQ(chosen[1].pt.x, 30);
  EXPECT_EQ(strongest_in_common_region(keypoints, translation(15, 0), kSize, 9).size(), 3u);
  EXPECT_TRUE(strongest_in_common_region(keypoints, translation(0, -11), kSize, 9).empty());
}

TEST(Repeatability, OfIdenticalSetsIsOne) {
  const auto keypoints = lattice();
  const Repeatability r = evaluate_repeatability(keypoints, kSize, keypoints, kSize, kIdentity, 50, {});
  EXPECT_EQ(r.keypoints1, 50);
  EXPECT_EQ(r.keypoints2, 50);
  EXPECT_EQ(r.correspondences, 50);
  EXPECT_EQ(r.ratio, 1);
  EXPECT_EQ(r.error_px, 0);
}

TEST(Repeatability, OfSetsMovedByTheHomographyIsOne) {
  const Homography H(0.88, 0.31, -39, -0.18, 0.94, 50, 2e-4, -1.6e-5, 1);
  const auto keypoints = lattice();
  const auto found = find_correspondences(keypoints, moved(keypoints, H), H, {});
  ASSERT_EQ(found.size(), keypoints.size());
  for (const Correspondence& c : found) {
    EXPECT_EQ(c.index1, c.index2);
    EXPECT_NEAR(c.overlap, 1, 1e-4);
    EXPECT_NEAR(c.error_px, 0, 1e-4);
  }
}

// Equal discs share 3/4 of their area where the overlap is 0.6: 2 a - sin(2 a) = 3 pi / 4 with cos(a) = d / (2 r),
// whose solution is d = 0.39529 r.
TEST(Repeatability, FallsAtTheKnownShift) {
  const auto keypoints = lattice(8);  // discs of 12 px
  const double limit_px = 12 * 0.39529;
  for (const double shift : {0.5, 2.0, limit_px - 0.01}) {
    const auto shifted = moved(keypoints, translation(shift * 0.6, shift * 0.8));
    const Repeatability r = evaluate_repeatability(keypoints, kSize, shifted, kSize, kIdentity, 80, {});
    EXPECT_EQ(r.ratio, 1) << shift;
    EXPECT_NEAR(r.error_px, shift, 1e-4);
  }
  const auto shifted = moved(keypoints, translation(limit_px + 0.01, 0));
  const Repeatability r = evaluate_repeatability(keypoints, kSize, shifted, kSize, kIdentity, 80, {});
  EXPECT_EQ(r.correspondences, 0);
  EXPECT_TRUE(std::isnan(r.error_px));
}

TEST(Repeatability, MeasuresTheErrorInImage1) {
  const Homography H = scaling(0.5);
  const auto found = find_correspondences({keypoint(100, 100, 8)}, {keypoint(51, 50, 4)}, H, {});
  ASSERT_EQ(found.size(), 1u);
  EXPECT_NEAR(found[0].error_px, 2, 1e-9);
}

// Concentric discs overlap by the square of the ratio of their radii: 0.6 at sqrt(0.6) = 0.7746.
TEST(Repeatability, FallsAtTheKnownChangeOfScale) {
  const auto keypoints = lattice();
  EXPECT_EQ(find_correspondences(keypoints, moved(keypoints, kIdentity, 0.78), kIdentity, {}).size(), keypoints.size());
  EXPECT_EQ(find_correspondences(keypoints, moved(keypoints, kIdentity, 1.28), kIdentity, {}).size(), keypoints.size());
  EXPECT_EQ(find_correspondences(keypoints, moved(keypoints, kIdentity, 0.77), kIdentity, {}).size(), 0u);
  EXPECT_EQ(find_correspondences(keypoints, moved(keypoints, kIdentity, 1.30), kIdentity, {}).size(), 0u);
}

TEST(Repeatability, WithNormalizedDiscsAllowsTheSameShiftAtEveryScale) {
  OverlapOptions normalized;
  normalized.normalized_radius_px = 30;
  for (const double size : {2.0, 8.0, 40.0}) {
    const std::vector<cv::KeyPoint> one = {keypoint(100, 100, size)};
    EXPECT_EQ(find_correspondences(one, {keypoint(111, 100, size)}, kIdentity, normalized).size(), 1u) << size;
    EXPECT_EQ(find_correspondences(one, {keypoint(113, 100, size)}, kIdentity, normalized).size(), 0u) << size;
    EXPECT_EQ(find_correspondences(one, {keypoint(100, 100, 0.75 * size)}, kIdentity, normalized).size(), 0u) << size;
  }
}

TEST(Correspondences, AreOneToOneAndTheBestComesFirst) {
  // 0 overlaps both of image 2's discs, its best is taken by 1, which fits there exactly.
  const std::vector<cv::KeyPoint> first = {keypoint(100, 100, 20), keypoint(102, 100, 20)};
  const std::vector<cv::KeyPoint> second = {keypoint(102, 100, 20), keypoint(97, 100, 20)};
  const auto found = find_correspondences(first, second, kIdentity, {});
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].index1, 1);
  EXPECT_EQ(found[0].index2, 0);
  EXPECT_EQ(found[1].index1, 0);
  EXPECT_EQ(found[1].index2, 1);
  EXPECT_EQ(find_correspondences(first, {second[0]}, kIdentity, {}).size(), 1u);
}

TEST(Repeatability, CountsTheSmallerSet) {
  const auto keypoints = lattice();
  const std::vector<cv::KeyPoint> few(keypoints.begin(), keypoints.begin() + 10);
  const Repeatability r = evaluate_repeatability(few, kSize, keypoints, kSize, kIdentity, 50, {});
  EXPECT_EQ(r.correspondences, 10);
  EXPECT_EQ(r.ratio, 1);
  EXPECT_EQ(evaluate_repeatability({}, kSize, keypoints, kSize, kIdentity, 50, {}).ratio, 0);
}

TEST(Options, OutOfRangeAreRefused) {
  OverlapOptions overlap;
  overlap.min_overlap = 0;
  EXPECT_THROW(find_correspondences({}, {}, kIdentity, overlap), OptionError);
  MatchingOptions matching;
  matching.max_ratio = 1.5;
  EXPECT_THROW(evaluate_matching({}, kSize, {}, kIdentity, matching), OptionError);
}

/// Features whose descriptors are distinct unit vectors.
Features distinct_features(const std::vector<cv::KeyPoint>& keypoints) {
  return {keypoints, cv::Mat::eye(static_cast<int>(keypoints.size()), static_cast<int>(keypoints.size()), CV_32F)};
}

TEST(Matching, CountsCorrectMatchesAndFindsTheHomography) {
  const Homography H(0.88, 0.31, -39, -0.18, 0.94, 50, 2e-4, -1.6e-5, 1);
  const Features first = distinct_features(lattice());
  const int n = static_cast<int>(first.keypoints.size());
  Features second = {moved(first.keypoints, H), first.descriptors};
  Matching m = evaluate_matching(first, kSize, second, H, {});
  EXPECT_EQ(m.matches, n);
  EXPECT_EQ(m.correct, n);
  EXPECT_TRUE(m.homography_found);
  EXPECT_LT(m.corner_error_px, 1e-2);

  // Every third one is 20 px off.
  for (int i = 0; i < n; i += 3) second.keypoints[i].pt.x += 20;
  m = evaluate_matching(first, kSize, second, H, {});
  EXPECT_EQ(m.matches, n);
  EXPECT_EQ(m.correct, n - (n + 2) / 3);
  EXPECT_TRUE(m.homography_found);

  // All are off by the same: RANSAC is content, the truth is not.
  m = evaluate_matching(first, kSize, {moved(second.keypoints, translation(9, 0)), first.descriptors}, H, {});
  EXPECT_FALSE(m.homography_found);
  EXPECT_GT(m.corner_error_px, 5);
}

TEST(Matching, AppliesTheRatioTest) {
  const std::vector<cv::KeyPoint> two = {keypoint(100, 100, 8), keypoint(200, 100, 8)};
  const Features first = {{two[0]}, (cv::Mat_<float>(1, 2) << 0, 0)};
  Features second = {two, (cv::Mat_<float>(2, 2) << 0, 7.9f, 10, 0)};
  EXPECT_EQ(evaluate_matching(first, kSize, second, kIdentity, {}).correct, 1);
  second.descriptors.at<float>(0, 1) = 8.1f;
  EXPECT_EQ(evaluate_matching(first, kSize, second, kIdentity, {}).matches, 0);
  EXPECT_TRUE(std::isinf(evaluate_matching(first, kSize, second, kIdentity, {}).corner_error_px));
  EXPECT_EQ(evaluate_matching({}, kSize, second, kIdentity, {}).matches, 0);
}

TEST(Matching, OfAShiftedImageSucceedsWithSiftAndOrb) {
  const cv::Mat scene = test::textured_image(kSize.width + 40, kSize.height + 40, 3);
  const cv::Mat image1 = scene(cv::Rect({0, 0}, kSize)).clone(), image2 = scene(cv::Rect({20, 12}, kSize)).clone();
  const Homography H = translation(-20, -12);
  const Matching sift = evaluate_matching(extract_sift(image1, 300), kSize, extract_sift(image2, 300), H, {});
  EXPECT_GT(sift.correct, 150);
  EXPECT_TRUE(sift.homography_found);
  const Matching orb = evaluate_matching(extract_orb(image1, 300), kSize, extract_orb(image2, 300), H, {});
  EXPECT_GT(orb.correct, 100);
  EXPECT_TRUE(orb.homography_found);
}

TEST(DetectDog, ReportsTheScaleOfABlob) {
  // A Gaussian blob of standard deviation s is an extremum of the scale space at sigma = s (Lindeberg, IJCV 1998).
  for (const double s : {4.0, 9.0}) {
    cv::Mat blob(160, 160, CV_64F);
    for (int y = 0; y < blob.rows; ++y) {
      for (int x = 0; x < blob.cols; ++x) {
        blob.at<double>(y, x) = 40 + 180 * std::exp(-(std::pow(x - 80, 2) + std::pow(y - 80, 2)) / (2 * s * s));
      }
    }
    cv::Mat image;
    blob.convertTo(image, CV_8U);
    const auto keypoints = detect_dog(image);
    ASSERT_FALSE(keypoints.empty());
    EXPECT_NEAR(keypoints[0].pt.x, 80, 0.5);
    EXPECT_NEAR(keypoints[0].pt.y, 80, 0.5);
    EXPECT_NEAR(keypoints[0].size / 2, s, 0.2 * s);
  }
}

#ifdef EVALUATE_FEATURES
TEST(EvaluateFeatures, ReportsAndRefuses) {
  const std::string folder = testing::TempDir();
  const std::string image = folder + "evaluate_features.png", homography = folder + "evaluate_features.txt",
                    json = folder + "evaluate_features.json";
  ASSERT_TRUE(cv::imwrite(image, test::textured_image(kSize.width, kSize.height, 3)));
  std::ofstream(homography) << "1 0 0 0 1 0 0 0 1";
  const auto run = [&](const std::vector<std::string>& arguments) {
    std::vector<std::string> command = {EVALUATE_FEATURES};
    command.insert(command.end(), arguments.begin(), arguments.end());
    return test::run_program(command);
  };
  const auto good = run({image, image, homography, "--detections", "200", "--json", json});
  ASSERT_EQ(good.exit_code, 0) << good.output;
  nlohmann::json results;
  std::ifstream(json) >> results;
  EXPECT_EQ(results.at("as_detected").at("correspondences"), 200);
  EXPECT_EQ(results.at("normalized").at("repeatability"), 1);
  EXPECT_EQ(results.at("as_detected").at("error_px"), 0);
  EXPECT_TRUE(results.at("sift").at("homography_found"));
  EXPECT_EQ(results.at("orb").at("correct"), results.at("orb").at("matches"));

  const auto absent = run({image, folder + "absent.png", homography});
  EXPECT_EQ(absent.exit_code, 1);
  EXPECT_NE(absent.output.find("absent.png"), std::string::npos);
  const auto out_of_range = run({image, image, homography, "--min-overlap", "1.5"});
  EXPECT_EQ(out_of_range.exit_code, 1);
  EXPECT_NE(out_of_range.output.find("min_overlap = 1.5"), std::string::npos);
  EXPECT_EQ(run({image, image}).exit_code, 2);
}
#endif

}  // namespace
}  // namespace gyro_deblur::experiments
