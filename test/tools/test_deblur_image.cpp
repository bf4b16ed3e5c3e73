// The command-line tool: what it refuses, and what it writes.

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "blur/blur_validation.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "inverse/filter_bank.hpp"
#include "pipeline/deconvolution.hpp"
#include "run_program.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur {
namespace {

class DeblurImage : public testing::Test {
 protected:
  std::filesystem::path folder_;

  void SetUp() override {
    folder_ = std::filesystem::path(testing::TempDir()) /
              (std::string("deblur_image_") + testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(path(name)) << text;
    return path(name);
  }
  std::string write_image(const std::string& name, int type) const {
    cv::Mat image(60, 80, type);
    cv::RNG rng(3);
    rng.fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_8U ? 256 : 65536);
    EXPECT_TRUE(cv::imwrite(path(name), image));
    return path(name);
  }
  static test::ProgramResult run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), DEBLUR_IMAGE);
    return test::run_program(arguments);
  }
  /// Expects failure with one line that holds `text`, and no output image.
  void expect_refusal(const std::vector<std::string>& arguments, const std::string& text) const {
    const test::ProgramResult result = run(arguments);
    EXPECT_EQ(result.exit_code, 1) << result.output;
    EXPECT_NE(result.output.find(text), std::string::npos) << result.output;
    EXPECT_EQ(std::count(result.output.begin(), result.output.end(), '\n'), 1) << result.output;
    EXPECT_FALSE(std::filesystem::exists(path("out.png")));
  }
};

TEST_F(DeblurImage, ExplainsItself) {
  const test::ProgramResult help = run({"--help"});
  EXPECT_EQ(help.exit_code, 0);
  for (const char* option : {"--angle-deg", "--extent-px", "--field", "--noise-to-signal-ratio", "--engine",
                             "--block-size", "--no-validation", "--mask", "--overlay", "--json"}) {
    EXPECT_NE(help.output.find(option), std::string::npos) << option;
  }
}

TEST_F(DeblurImage, RefusesBadUsage) {
  const std::string in = write_image("in.png", CV_8UC1);
  EXPECT_EQ(run({}).exit_code, 2);
  EXPECT_EQ(run({in, path("out.png")}).exit_code, 2) << "no blur given";
  EXPECT_EQ(run({in, path("out.png"), "--angle-deg", "3"}).exit_code, 2) << "no extent";
  EXPECT_EQ(run({in, path("out.png"), "--angle-deg", "x", "--extent-px", "3"}).exit_code, 2);
  EXPECT_EQ(run({in, path("out.png"), "--angle-deg", "1", "--extent-px", "3", "--field", "a", "b"}).exit_code, 2);
}

TEST_F(DeblurImage, RefusesBadInputInOneLine) {
  const std::string in = write_image("in.png", CV_8UC1), out = path("out.png");
  const std::string csv = write("ok.csv", "1,2\n3,4\n");
  expect_refusal({path("none.png"), out, "--angle-deg", "1", "--extent-px", "9"}, "none.png");
  expect_refusal({csv, out, "--angle-deg", "1", "--extent-px", "9"}, "ok.csv");
  expect_refusal({in, out, "--angle-deg", "nan", "--extent-px", "9"}, "angle");
  expect_refusal({in, out, "--angle-deg", "1", "--extent-px", "-1"}, "extent");
  expect_refusal({in, out, "--angle-deg", "1", "--extent-px", "9", "--noise-to-signal-ratio", "0"},
                 "noise_to_signal_ratio");
  expect_refusal({in, out, "--angle-deg", "1", "--extent-px", "9", "--block-size", "7"}, "block_size");
  expect_refusal({in, out, "--angle-deg", "1", "--extent-px", "9", "--engine", "abacus"}, "abacus");
  expect_refusal({in, path("no_folder/out.png"), "--angle-deg", "1", "--extent-px", "9"}, "no_folder");
  expect_refusal({in, path("out.xyz"), "--angle-deg", "1", "--extent-px", "9"}, "out.xyz");
  expect_refusal({in, out, "--field", path("none.csv"), csv}, "none.csv");
  expect_refusal({in, out, "--field", csv, write("text.csv", "1,2\n3,four\n")}, "four");
  expect_refusal({in, out, "--field", csv, write("ragged.csv", "1,2\n3\n")}, "line 2");
  expect_refusal({in, out, "--field", csv, write("empty.csv", "\n")}, "empty.csv");
  expect_refusal({in, out, "--field", csv, write("other.csv", "1,2,3\n")}, "size");
  expect_refusal({write_image("in16.png", CV_16UC1), path("out.jpg"), "--angle-deg", "1", "--extent-px", "9"}, "JPEG");
}

TEST_F(DeblurImage, LeavesMaskedPixelsAsTheyAre) {
  const std::string in = write_image("in.png", CV_8UC3), out = path("out.png");
  cv::Mat used(60, 80, CV_8UC1, cv::Scalar(1));
  used.colRange(0, 20).setTo(0);
  ASSERT_TRUE(cv::imwrite(path("mask.png"), used));
  const std::vector<std::string> arguments{in,
                                           out,
                                           "--angle-deg",
                                           "0",
                                           "--extent-px",
                                           "4",
                                           "--block-size",
                                           "10",
                                           "--no-validation",
                                           "--fixed-regularization"};
  std::vector<std::string> masked = arguments;
  masked.insert(masked.end(), {"--mask", path("mask.png"), "--json", path("out.json")});
  const test::ProgramResult result = run(masked);
  ASSERT_EQ(result.exit_code, 0) << result.output;
  const cv::Mat before = cv::imread(in), after = cv::imread(out);
  EXPECT_EQ(cv::norm(before, after, cv::NORM_INF, used == 0), 0);
  EXPECT_GT(cv::norm(before.colRange(50, 80), after.colRange(50, 80), cv::NORM_INF), 0);
  const nlohmann::json report = nlohmann::json::parse(std::ifstream(path("out.json")));
  EXPECT_EQ(report["blocks"]["MASKED"], 2 * 6);
  EXPECT_EQ(report["blocks"]["STATIC_EDGE"], 2 * 6) << "8 px of taps to either side, and the seams";

  std::filesystem::remove(out);
  ASSERT_TRUE(cv::imwrite(path("small.png"), used.colRange(0, 40)));
  ASSERT_TRUE(cv::imwrite(path("black.png"), 0 * used));
  const auto with_mask = [&](const std::string& mask) {
    std::vector<std::string> bad = arguments;
    bad.insert(bad.end(), {"--mask", path(mask)});
    return bad;
  };
  expect_refusal(with_mask("none.png"), "none.png is no file; give a PNG or PGM of the image's size");
  expect_refusal(with_mask("black.png"), "black.png has no pixel above 0");
  expect_refusal(with_mask("small.png"), "small.png has 40x60 px, the image has 80x60 px");
}

TEST_F(DeblurImage, KeepsTheTypeOfTheImage) {
  for (const int type : {CV_8UC1, CV_8UC3, CV_8UC4, CV_16UC1, CV_16UC3, CV_16UC4}) {
    const std::string in = write_image("in.png", type);
    const test::ProgramResult result = run(
        {in, path("out.png"), "--angle-deg", "-20", "--extent-px", "9", "--no-validation", "--fixed-regularization"});
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const cv::Mat image = cv::imread(in, cv::IMREAD_UNCHANGED), out = cv::imread(path("out.png"), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(out.type(), type);
    const PixelLayout layouts[] = {PixelLayout::GRAY, PixelLayout::GRAY, PixelLayout::BGR, PixelLayout::BGRA};
    cv::Mat expected;
    deconvolve(image, layouts[image.channels() - 1], uniform_blur_field(80, 60, -20 * CV_PI / 180, 9, {}),
               FilterBank({}), *make_engine("auto"), expected);
    EXPECT_EQ(cv::norm(out, expected, cv::NORM_INF), 0);
  }
}

TEST_F(DeblurImage, ReportsWhatItDid) {
  // A sharp image, so every block contradicts a blur of 30 px.
  const std::string in = path("in.png");
  ASSERT_TRUE(cv::imwrite(in, test::textured_image(256, 192, 3)));
  const test::ProgramResult result = run({in, path("out.png"), "--angle-deg", "0", "--extent-px", "30", "--json",
                                          path("report.json"), "--overlay", path("overlay.png")});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  nlohmann::json report;
  std::ifstream(path("report.json")) >> report;
  EXPECT_EQ(report["width"], 256);
  EXPECT_EQ(report["height"], 192);
  EXPECT_EQ(report["blocks"]["REJECTED"], 12);
  EXPECT_EQ(report["blocks"]["DEBLURRED"], 0);
  EXPECT_EQ(report["median_extent_px"], 30);
  EXPECT_EQ(cv::imread(path("overlay.png"), cv::IMREAD_UNCHANGED).size(), cv::Size(256, 192));
  EXPECT_EQ(
      cv::norm(cv::imread(in, cv::IMREAD_UNCHANGED), cv::imread(path("out.png"), cv::IMREAD_UNCHANGED), cv::NORM_INF),
      0);
}

TEST_F(DeblurImage, TakesUnknownCellsAndAnySeparator) {
  const std::string in = write_image("in.png", CV_8UC1);
  const test::ProgramResult result =
      run({in, path("out.png"), "--block-size", "20", "--no-validation", "--json", path("report.json"), "--field",
           write("x.csv", "9; 9 ;nan;9\r\n9 9\t9,9\n"), write("y.csv", "0,0,0,0\n0,0,0,0\n")});
  ASSERT_EQ(result.exit_code, 0) << result.output;
  nlohmann::json report;
  std::ifstream(path("report.json")) >> report;
  const int unknown = report["blocks"]["NO_GYRO"], deblurred = report["blocks"]["DEBLURRED"];
  EXPECT_GE(unknown, 1);
  EXPECT_GE(deblurred, 6);
  EXPECT_EQ(unknown + deblurred, 12);
}

}  // namespace
}  // namespace gyro_deblur
