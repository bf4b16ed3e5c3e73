#include "gyro_deblur/keypoints.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>

#include "option_error_text.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::keypoints_test {
namespace {

const std::vector<std::string> kDetectors = available_detectors();
const std::vector<std::string> kDescriptors = available_descriptors();

/// Whether SIFT is expected: the build has it, unless this runs with the library that is built without.
bool expect_sift() { return GYRO_DEBLUR_SIFT != 0 && std::getenv("GYRO_DEBLUR_WITHOUT_SIFT") == nullptr; }

KeypointOptions options_of(const std::string& detector, const std::string& descriptor, int max_keypoints = 200) {
  KeypointOptions options;
  options.detector = detector;
  options.descriptor = descriptor;
  options.max_keypoints = max_keypoints;
  return options;
}

std::string refusal(const KeypointOptions& options) {
  return test::option_error([&] { options.validate(); });
}

bool is_accepted(const std::string& detector, const std::string& descriptor) {
  if (descriptor == "AKAZE") return detector == "AKAZE";
  return !(descriptor == "ORB" && detector == "SIFT");
}

TEST(FeatureExtractor, RunsEveryPairItAccepts) {
  const cv::Mat image = test::textured_image(320, 240, 5);
  for (const std::string& detector : kDetectors) {
    for (const std::string& descriptor : kDescriptors) {
      SCOPED_TRACE(detector + " + " + descriptor);
      const KeypointOptions options = options_of(detector, descriptor);
      if (!is_accepted(detector, descriptor)) {
        EXPECT_EQ(
            refusal(options).rfind("keypoint_descriptor = \"" + descriptor + "\" cannot describe the keypoints of ", 0),
            0u);
        EXPECT_NE(refusal(options).find("keypoint_detector = \"" + detector + '"'), std::string::npos);
        EXPECT_THROW(FeatureExtractor{options}, OptionError);
        continue;
      }
      EXPECT_EQ(refusal(options), "");
      const Features features = FeatureExtractor(options).extract(image);
      // Descriptors drop what is near the border, much of it when the detector has large patches.
      EXPECT_GE(features.keypoints.size(), detector == descriptor ? 190u : 50u);
      EXPECT_LE(features.keypoints.size(), 200u);
      if (descriptor == "NONE") {
        EXPECT_TRUE(features.descriptors.empty());
      } else {
        EXPECT_EQ(features.descriptors.rows, static_cast<int>(features.keypoints.size()));
        EXPECT_EQ(features.descriptors.depth(), descriptor == "SIFT" ? CV_32F : CV_8U);
      }
      for (std::size_t i = 0; i < features.keypoints.size(); ++i) {
        const cv::KeyPoint& keypoint = features.keypoints[i];
        EXPECT_TRUE(cv::Rect2f(-0.5f, -0.5f, 320, 240).contains(keypoint.pt)) << keypoint.pt;
        if (i > 0) {
          EXPECT_LE(keypoint.response, features.keypoints[i - 1].response);
        }
      }
    }
  }
}

TEST(FeatureExtractor, NamesWhatThereIsInPlaceOfSift) {
  EXPECT_EQ(std::count(kDetectors.begin(), kDetectors.end(), "SIFT"), expect_sift() ? 1 : 0);
  EXPECT_EQ(std::count(kDescriptors.begin(), kDescriptors.end(), "SIFT"), expect_sift() ? 1 : 0);
  EXPECT_EQ(kDetectors.size(), expect_sift() ? 6u : 5u);
  EXPECT_EQ(kDescriptors.size(), expect_sift() ? 5u : 4u);
  for (const char* detector : {"SIFT", "FAST"}) {
    const std::string message = test::option_error([&] { FeatureExtractor extractor(options_of(detector, "SIFT")); });
    if (expect_sift()) {
      EXPECT_EQ(message, "");
    } else {
      EXPECT_NE(message.find(" = SIFT: OpenCV "), std::string::npos) << message;
      EXPECT_NE(message.find("detectors ORB, AKAZE, BRISK, GFTT, FAST and the descriptors ORB, AKAZE, BRISK, NONE"),
                std::string::npos)
          << message;
    }
  }
}

TEST(FeatureExtractor, RefusesUnknownNamesAndListsTheKnown) {
  const auto message_of = [](const KeypointOptions& options) -> std::string {
    try {
      FeatureExtractor extractor(options);
    } catch (const OptionError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(message_of(options_of("SURF", "ORB")).find("AKAZE"), std::string::npos);
  EXPECT_NE(message_of(options_of("SURF", "ORB")).find("SURF"), std::string::npos);
  EXPECT_NE(message_of(options_of("ORB", "FAST")).find("BRISK"), std::string::npos);
  EXPECT_NE(message_of(options_of("ORB", "")).find("descriptor"), std::string::npos);
  EXPECT_NE(message_of(options_of("orb", "ORB")).find("detector"), std::string::npos) << "names are case-sensitive";
  EXPECT_NE(message_of(options_of("FAST", "AKAZE")).find("AKAZE"), std::string::npos);
  EXPECT_THROW(FeatureExtractor(options_of("ORB", "ORB", 0)), OptionError);
}

// However large a detector calls them, keypoints of the finest scale are placed by a few pixels, and those of a scale k
// times as coarse by a patch k times as large.
TEST(FeatureExtractor, RadiusOfACornerIsThatOfItsScale) {
  const cv::Mat image = test::textured_image(320, 240, 5);
  for (const std::string& detector : kDetectors) {
    double least_px = 1e3;
    for (const cv::KeyPoint& keypoint : FeatureExtractor(options_of(detector, "NONE")).extract(image).keypoints) {
      const double radius_px = corner_radius_px(keypoint, detector);
      least_px = std::min(least_px, radius_px);
      if (detector == "ORB") {
        EXPECT_NEAR(radius_px, 3.5 * std::pow(1.2, keypoint.octave), 1e-3);
      }
    }
    EXPECT_GT(least_px, 1.5) << detector;
    EXPECT_LT(least_px, 6) << detector;
  }
}

TEST(FeatureExtractor, KeepsTheStrongest) {
  const cv::Mat image = test::textured_image(320, 240, 5);
  for (const std::string& detector : kDetectors) {
    if (detector == "ORB") continue;  // shares its number among pyramid levels, so fewer are not a part of more
    SCOPED_TRACE(detector);
    const Features many = FeatureExtractor(options_of(detector, "NONE", 100000)).extract(image);
    const Features few = FeatureExtractor(options_of(detector, "NONE", 50)).extract(image);
    ASSERT_EQ(few.keypoints.size(), 50u);
    ASSERT_GT(many.keypoints.size(), 50u);
    for (std::size_t i = 0; i < 50; ++i) EXPECT_EQ(few.keypoints[i].response, many.keypoints[i].response);
  }
}

TEST(FeatureExtractor, KeepsDescriptorsWithTheirKeypoints) {
  // A keypoint found again in the same image must have the descriptor that it gets when described alone.
  const cv::Mat image = test::textured_image(320, 240, 5);
  const Features features = FeatureExtractor(options_of("ORB", "ORB", 100)).extract(image);
  for (std::size_t i = 0; i < features.keypoints.size(); i += 9) {
    std::vector<cv::KeyPoint> alone = {features.keypoints[i]};
    cv::Mat descriptor;
    cv::ORB::create()->compute(image, alone, descriptor);
    ASSERT_EQ(descriptor.rows, 1);
    EXPECT_EQ(cv::norm(descriptor, features.descriptors.row(static_cast<int>(i)), cv::NORM_HAMMING), 0) << i;
  }
}

TEST(FeatureExtractor, IsRepeatable) {
  const cv::Mat image = test::textured_image(640, 480, 6);
  for (const std::string& detector : kDetectors) {
    SCOPED_TRACE(detector);
    const std::string descriptor = detector == "GFTT" || detector == "FAST" ? "BRISK" : detector;
    FeatureExtractor extractor(options_of(detector, descriptor));
    const Features first = extractor.extract(image), second = extractor.extract(image.clone());
    const Features other = FeatureExtractor(options_of(detector, descriptor)).extract(image);
    for (const Features& features : {second, other}) {
      ASSERT_EQ(features.keypoints.size(), first.keypoints.size());
      for (std::size_t i = 0; i < first.keypoints.size(); ++i) {
        EXPECT_EQ(features.keypoints[i].pt, first.keypoints[i].pt);
        EXPECT_EQ(features.keypoints[i].angle, first.keypoints[i].angle);
      }
      EXPECT_EQ(cv::norm(features.descriptors, first.descriptors, cv::NORM_INF), 0);
    }
  }
}

TEST(FeatureExtractor, FindsACornerWhereItIs) {
  cv::Mat image(120, 160, CV_8UC1, cv::Scalar(60));
  cv::rectangle(image, cv::Rect(70, 50, 25, 25), cv::Scalar(200), cv::FILLED);  // corners at 69.5 or 94.5, 49.5 or 74.5
  cv::GaussianBlur(image, image, cv::Size(), 0.8);  // a perfect corner gives FAST two equal maxima, and it drops both
  for (const std::string detector : {"GFTT", "ORB", "BRISK", "FAST"}) {
    const Features features = FeatureExtractor(options_of(detector, "NONE")).extract(image);
    ASSERT_FALSE(features.keypoints.empty()) << detector;
    for (const cv::KeyPoint& keypoint : features.keypoints) {
      EXPECT_NEAR(std::abs(keypoint.pt.x - 82), 12.5, 4) << detector;
      EXPECT_NEAR(std::abs(keypoint.pt.y - 62), 12.5, 4) << detector;
    }
  }
}

/// Strong texture on the left quarter, faint texture elsewhere.
cv::Mat nonuniform_image() {
  const cv::Mat texture = test::textured_image(400, 200, 8);
  cv::Mat image;
  texture.convertTo(image, CV_8U, 0.25, 96);
  texture(cv::Rect(0, 0, 100, 200)).copyTo(image(cv::Rect(0, 0, 100, 200)));
  return image;
}

std::vector<int> per_column(const Features& features, int cols) {
  std::vector<int> counts(cols, 0);
  for (const cv::KeyPoint& keypoint : features.keypoints) ++counts[static_cast<int>(keypoint.pt.x * cols / 400)];
  return counts;
}

TEST(FeatureExtractor, SpreadsKeypointsOverTheGrid) {
  const cv::Mat image = nonuniform_image();
  for (const std::string& detector :
       {std::string("GFTT"), std::string("FAST"), std::string("ORB"), std::string("BRISK")}) {
    KeypointOptions options = options_of(detector, "NONE", 80);
    const std::vector<int> without = per_column(FeatureExtractor(options).extract(image), 4);
    EXPECT_GT(without[0], 50) << detector << ": the strong quarter takes most";
    options.grid = 2;
    const std::vector<int> with = per_column(FeatureExtractor(options).extract(image), 2);
    for (const int count : with) EXPECT_EQ(count, 40) << detector;
  }
}

TEST(FeatureExtractor, GivesUnusedSharesToTheStrongest) {
  cv::Mat image = nonuniform_image();
  image(cv::Rect(200, 0, 200, 200)).setTo(128);  // two of four cells are empty
  KeypointOptions options = options_of("FAST", "NONE", 81);
  options.grid = 4;
  const Features features = FeatureExtractor(options).extract(image);
  EXPECT_EQ(features.keypoints.size(), 81u);
  const std::vector<int> counts = per_column(features, 4);
  EXPECT_GE(counts[1], 20);
  EXPECT_GT(counts[0], 20) << "the strongest left are in the first cell";
}

TEST(FeatureExtractor, DeliversTheLimitOnABlurredImage) {
  const cv::Mat sharp = test::textured_image(640, 480, 9);
  const cv::Mat blurred = test::expose(test::blur_along_line(sharp, 0.5, 15), 1.0, 2);
  for (const std::string& detector : kDetectors) {
    const Features features = FeatureExtractor(options_of(detector, "NONE", 300)).extract(blurred);
    EXPECT_GE(features.keypoints.size(), 290u) << detector;
  }
}

TEST(FeatureExtractor, TakesSmallAndFlatImages) {
  for (const std::string& detector : kDetectors) {
    for (const std::string& descriptor : kDescriptors) {
      if (!is_accepted(detector, descriptor)) continue;
      SCOPED_TRACE(detector + " + " + descriptor);
      FeatureExtractor extractor(options_of(detector, descriptor));
      for (const cv::Size size :
           {cv::Size(1, 1), cv::Size(5, 300), cv::Size(16, 16), cv::Size(17, 40), cv::Size(33, 33), cv::Size(80, 64)}) {
        cv::Mat image(size, CV_8UC1);
        cv::RNG rng(4);
        rng.fill(image, cv::RNG::UNIFORM, 0, 256);
        const Features features = extractor.extract(image);
        if (descriptor != "NONE") {
          EXPECT_EQ(features.descriptors.rows, static_cast<int>(features.keypoints.size())) << size;
        }
        if (size.width < 16) {
          EXPECT_TRUE(features.keypoints.empty());
        }
      }
      EXPECT_TRUE(extractor.extract(cv::Mat(100, 100, CV_8UC1, cv::Scalar(77))).keypoints.empty());
      EXPECT_TRUE(extractor.extract(cv::Mat(0, 0, CV_8UC1)).keypoints.empty());
      EXPECT_THROW(extractor.extract(cv::Mat(100, 100, CV_8UC3, cv::Scalar::all(7))), std::invalid_argument);
    }
  }
}

}  // namespace
}  // namespace gyro_deblur::keypoints_test
