// Real motion blur of a rolling-shutter tablet with the blur field that its gyroscope predicts.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "gyro_deblur/blur_field.hpp"
#include "gyro_deblur/image_format.hpp"
#include "run_program.hpp"

namespace gyro_deblur {
namespace {

class ShieldBlurFields : public testing::TestWithParam<const char*> {
 protected:
  static std::string path(const std::string& folder) {
    return std::string(GYRO_DEBLUR_DATA_DIR) + "/shield_blur_fields/" + folder + "/" + GetParam() + ".png";
  }
  static constexpr int kBlockSizePx = 64;
  static constexpr double kOffset = 128;  // grey level of the maps that stands for no displacement

  /// Blurred image, its luminance, and the displacement maps [px].
  cv::Mat blurred_, luminance_, dx_, dy_;

  void SetUp() override {
    if (!std::filesystem::exists(path("blurred"))) GTEST_SKIP() << "no data at " << path("blurred");
    blurred_ = cv::imread(path("blurred"), cv::IMREAD_UNCHANGED);
    luminance_ = luminance8(blurred_, PixelLayout::BGR);
    cv::imread(path("blurx"), cv::IMREAD_UNCHANGED).convertTo(dx_, CV_64F, 1, -kOffset);
    cv::imread(path("blury"), cv::IMREAD_UNCHANGED).convertTo(dy_, CV_64F, 1, -kOffset);
  }

  /// Mean squared derivatives along and across the motion, over all pixels. Blur takes the first and leaves the second.
  struct Energy {
    double along, across;
    double balance() const { return along / across; }
  };
  Energy gradient_energy(const cv::Mat& image) const {
    cv::Mat gx, gy;
    const cv::Mat luminance = luminance8(image, PixelLayout::BGR);
    cv::Sobel(luminance, gx, CV_64F, 1, 0, 3, 1.0 / 8);
    cv::Sobel(luminance, gy, CV_64F, 0, 1, 3, 1.0 / 8);
    cv::Mat norm2 = dx_.mul(dx_) + dy_.mul(dy_);
    cv::Mat along = gx.mul(dx_) + gy.mul(dy_), across = gx.mul(dy_) - gy.mul(dx_);
    return {cv::mean(along.mul(along) / norm2)[0], cv::mean(across.mul(across) / norm2)[0]};
  }

  /// Runs deblur_image and returns what it wrote.
  cv::Mat deblur(const std::string& dx, const std::string& dy, double offset, const std::string& name,
                 const std::vector<std::string>& more = {}) const {
    const std::string out = testing::TempDir() + "shield_" + GetParam() + "_" + name + ".png";
    std::vector<std::string> command = {DEBLUR_IMAGE,     path("blurred"),       out, "--field", dx, dy,
                                        "--field-offset", std::to_string(offset)};
    command.insert(command.end(), more.begin(), more.end());
    const test::ProgramResult result = test::run_program(command);
    EXPECT_EQ(result.exit_code, 0) << result.output;
    std::printf("%s", result.output.c_str());
    return cv::imread(out, cv::IMREAD_UNCHANGED);
  }
};

TEST_P(ShieldBlurFields, ComeOutSharper) {
  // All blocks: of the path there are only the ends here, which the image may contradict.
  const cv::Mat deblurred = deblur(path("blurx"), path("blury"), kOffset, "deblurred", {"--no-validation"});
  ASSERT_EQ(deblurred.size(), blurred_.size());
  ASSERT_EQ(deblurred.type(), blurred_.type());
  const Energy before = gradient_energy(blurred_), after = gradient_energy(deblurred);

  // A field that is wrong by 90 degrees sharpens across the motion, not along it.
  cv::Mat wrong_dx, wrong_dy;
  cv::Mat(kOffset - dy_).convertTo(wrong_dx, CV_8U);
  cv::Mat(kOffset + dx_).convertTo(wrong_dy, CV_8U);
  const std::string x = testing::TempDir() + "wrong_" + GetParam() + "_x.png";
  const std::string y = testing::TempDir() + "wrong_" + GetParam() + "_y.png";
  ASSERT_TRUE(cv::imwrite(x, wrong_dx) && cv::imwrite(y, wrong_dy));
  const Energy wrong = gradient_energy(deblur(x, y, kOffset, "wrong", {"--no-validation"}));

  std::printf("gradient energy along / across the motion: %.2f / %.2f before, %.2f / %.2f after\n", before.along,
              before.across, after.along, after.across);
  std::printf("balance: %.3f before, %.3f after, %.3f with a field wrong by 90 degrees\n", before.balance(),
              after.balance(), wrong.balance());
  EXPECT_GE(after.along, 1.5 * before.along);
  EXPECT_GE(after.balance(), 1.2 * before.balance());
  EXPECT_LT(wrong.balance(), before.balance());
}

TEST_P(ShieldBlurFields, AreAccepted) {
  const cv::Mat deblurred = deblur(path("blurx"), path("blury"), kOffset, "accepted");
  const FrameBlur field = blur_field_from_displacement(blurred_.cols, blurred_.rows, dx_, dy_, {});
  int changed = 0;
  for (int i = 0; i < field.grid.size(); ++i) {
    const cv::Rect rect = field.grid.rect(i);
    if (cv::norm(blurred_(rect), deblurred(rect), cv::NORM_INF) > 0) ++changed;
  }
  // The lights of "entrance" have left hooks, which are no lines: the image contradicts the field. Half of "flower" is
  // out of focus, or without texture.
  const std::string image = GetParam();
  if (image == "entrance") {
    EXPECT_LE(changed, field.grid.size() / 4) << "of " << field.grid.size() << " blocks";
  } else {
    EXPECT_GE(changed, (image == "flower" ? 1 : 1.5) * field.grid.size() / 2) << "of " << field.grid.size();
  }
}

TEST_P(ShieldBlurFields, CsvGivesTheSameAsMaps) {
  // A cell for each block, taken from the maps as the block centres see them.
  const FrameBlur field = blur_field_from_displacement(blurred_.cols, blurred_.rows, dx_, dy_, {});
  const std::string x = testing::TempDir() + GetParam() + "_dx.csv", y = testing::TempDir() + GetParam() + "_dy.csv";
  std::ofstream x_file(x), y_file(y);
  for (int row = 0; row < field.grid.rows(); ++row) {
    for (int col = 0; col < field.grid.cols(); ++col) {
      const BlockBlur& block = field.blocks[row * field.grid.cols() + col];
      x_file << (col > 0 ? "," : "") << block.extent_px * std::cos(block.angle_rad);
      y_file << (col > 0 ? "," : "") << block.extent_px * std::sin(block.angle_rad);
    }
    x_file << "\n";
    y_file << "\n";
  }
  x_file.close();
  y_file.close();
  const cv::Mat from_csv = deblur(x, y, 0, "csv"), from_maps = deblur(path("blurx"), path("blury"), kOffset, "maps");
  // The text has six digits: kernels round the extent to quarter pixels, so a block may fall to the next one.
  cv::Mat difference;
  cv::absdiff(from_csv, from_maps, difference);
  EXPECT_LT(cv::mean(difference.reshape(1))[0], 0.1);
}

constexpr const char* kImages[] = {"bridge", "entrance", "flower", "graffiti", "office", "tower"};

// Walls, asphalt and sky, of cameras that have smoothed and compressed what noise they had.
TEST(ShieldFlatBlocks, AreNotGrained) {
  const std::string folder = std::string(GYRO_DEBLUR_DATA_DIR) + "/shield_blur_fields/";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no data at " << folder;
  std::vector<std::pair<double, double>> deviations;  // of a block, before and after
  for (const std::string image : kImages) {
    const std::string out = testing::TempDir() + "shield_flat_" + image + ".png";
    const test::ProgramResult result = test::run_program({DEBLUR_IMAGE, folder + "blurred/" + image + ".png", out,
                                                          "--field", folder + "blurx/" + image + ".png",
                                                          folder + "blury/" + image + ".png", "--field-offset", "128"});
    ASSERT_EQ(result.exit_code, 0) << result.output;
    const cv::Mat before = cv::imread(folder + "blurred/" + image + ".png", cv::IMREAD_GRAYSCALE);
    const cv::Mat after = cv::imread(out, cv::IMREAD_GRAYSCALE);
    ASSERT_EQ(after.size(), before.size());
    const BlockGrid grid(before.cols, before.rows, 64);
    for (int i = 0; i < grid.size(); ++i) {
      cv::Scalar mean, of_before, of_after;
      cv::meanStdDev(before(grid.rect(i)), mean, of_before);
      cv::meanStdDev(after(grid.rect(i)), mean, of_after);
      deviations.emplace_back(of_before[0], of_after[0]);
    }
  }
  std::sort(deviations.begin(), deviations.end());
  const std::size_t flattest = deviations.size() / 10;
  double ratio = 0;
  for (std::size_t i = 0; i < flattest; ++i) ratio += deviations[i].second / deviations[i].first / flattest;
  std::printf("standard deviation after over that before, mean of the flattest tenth of blocks: %.2f\n", ratio);
  EXPECT_LT(ratio, 1.2);
}

INSTANTIATE_TEST_SUITE_P(Images, ShieldBlurFields, testing::ValuesIn(kImages),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace gyro_deblur
