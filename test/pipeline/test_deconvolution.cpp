#include "pipeline/deconvolution.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <tuple>
#include <utility>

#include <gtest/gtest.h>

#include "blur/path_1d.hpp"
#include "engine/cpu/cpu_engine.hpp"
#include "engine/engine.hpp"
#include "gyro_deblur/blur_field.hpp"
#include "images.hpp"
#include "inverse/filter_bank.hpp"
#include "paths_2d.hpp"
#include "synthetic_blur.hpp"

namespace gyro_deblur::deconvolution_test {
namespace {

using test::equal;
using test::random_image;

double radians(double degrees) { return degrees * CV_PI / 180; }

// Asymmetric, so that a kernel reversed, or the box, shows.
TEST(Deconvolve, FollowsAnNonuniformPathInItsDirection) {
  constexpr Path1d kPath{-6, -5.5f, -4.5f, -2.5f, 0, 3, 6.5f, 10.5f, 15};
  Path1d reversed;
  for (int k = 0; k < kPathInstants; ++k) reversed[k] = -kPath[k];
  const cv::Mat sharp = test::textured_image(256, 192, 3);
  const cv::Rect inner(48, 48, 160, 96);
  const FilterBank bank{FilterOptions{}};
  const auto restored = [&](const cv::Mat& blurred, double angle_rad, const std::optional<Path1d>& path_px,
                            const std::string& engine) {
    FrameBlur field = uniform_blur_field(sharp.cols, sharp.rows, angle_rad, extent_of(kPath), {});
    for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_px;
    cv::Mat dst;
    deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine(engine), dst);
    return test::psnr_db(dst(inner), sharp(inner));
  };
  for (const double degrees : {0.0, 35.0, 90.0, 120.0, 178.0}) {
    const double angle_rad = radians(degrees);
    const cv::Mat blurred = test::expose(test::blur_along_path(sharp, angle_rad, kPath), 1.0, 5);
    for (const std::string engine : {"float", "cpu"}) {
      const double with_path = restored(blurred, angle_rad, kPath, engine);
      EXPECT_GT(with_path, test::psnr_db(blurred(inner), sharp(inner)) + 5) << engine << ' ' << degrees;
      EXPECT_GT(with_path, restored(blurred, angle_rad, reversed, engine) + 5) << engine << ' ' << degrees;
      EXPECT_GT(with_path, restored(blurred, angle_rad, std::nullopt, engine) + 3) << engine << ' ' << degrees;
    }
  }
}

/// A field of blocks that are all blurred along one path.
FrameBlur field_along(cv::Size size, const Path2d& path_px) {
  std::array<Eigen::Vector2d, kPathInstants> places_px;
  for (int k = 0; k < kPathInstants; ++k) places_px[k] = path_px[k].cast<double>();
  FrameBlur field = uniform_blur_field(size.width, size.height, 0, 10, {});
  field.blocks.assign(field.blocks.size(), classify_path(places_px, {}));
  return field;
}

TEST(Deconvolve, UndoesCurvedPaths) {
  const cv::Mat sharp = test::textured_image(256, 192, 3);
  const cv::Rect inner(48, 48, 160, 96);
  const FilterBank bank{FilterOptions{}};
  const Path2d path_px = test::arc_path(24, 8, 0.6);
  const FrameBlur field = field_along(sharp.size(), path_px);
  ASSERT_EQ(field.count(BlockStatus::DEBLURRED), field.blocks.size());
  const cv::Mat blurred = test::expose(test::blur_in_2d(sharp, path_px), 1, 5);
  for (const char* engine : {"float", "cpu", "opencl", "fourier"}) {
    cv::Mat dst;
    deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine(engine), dst);
    EXPECT_GT(test::psnr_db(dst(inner), sharp(inner)), test::psnr_db(blurred(inner), sharp(inner)) + 6) << engine;
  }
}

// The planes of a mosaic have half the path, whichever filter undoes it.
TEST(Deconvolve, UndoesPathsInThePlanesOfAMosaic) {
  const cv::Mat sharp = test::textured_image(128, 96, 3);
  const FilterBank bank{FilterOptions{}};
  const Path2d of_plane_px = test::arc_path(12, 4, 0.6);
  Path2d path_px = of_plane_px;
  for (Eigen::Vector2f& place_px : path_px) place_px *= 2;
  const cv::Mat blurred = test::expose(test::blur_in_2d(sharp, of_plane_px), 1, 5);
  cv::Mat mosaic, dst, plane(sharp.size(), CV_8U);
  cv::resize(blurred, mosaic, sharp.size() * 2, 0, 0, cv::INTER_NEAREST);
  deconvolve(mosaic, PixelLayout::BAYER_RGGB, field_along(mosaic.size(), path_px), bank, *make_engine("cpu"), dst);
  for (int y = 0; y < plane.rows; ++y) {
    for (int x = 0; x < plane.cols; ++x) plane.at<uchar>(y, x) = dst.at<uchar>(2 * y + 1, 2 * x);
  }
  EXPECT_GT(test::psnr_db(plane, sharp), test::psnr_db(blurred, sharp) + 3);
}

TEST(Deconvolve, LeavesAllBlocksToA2dEngine) {
  const cv::Mat sharp = test::textured_image(256, 192, 3);
  const cv::Rect inner(48, 48, 160, 96);
  const FilterBank bank{FilterOptions{}};
  constexpr double kAngleRad = 0.6;
  for (const bool nonuniform : {false, true}) {
    const Path1d path_px =
        nonuniform ? Path1d{-6, -5.5f, -4.5f, -2.5f, 0, 3, 6.5f, 10.5f, 15} : Path1d{-8, -6, -4, -2, 0, 2, 4, 6, 8};
    FrameBlur field = uniform_blur_field(sharp.cols, sharp.rows, kAngleRad, extent_of(path_px), {});
    if (nonuniform) {
      for (BlockBlur& block : field.blocks) block.nonuniform_path_px = path_px;
    }
    const FilterGrid grid = make_filter_grid(field, bank, 1, true);
    for (const BlockFilter& block : grid.blocks) {
      EXPECT_EQ(block.kernel, nullptr);
      EXPECT_NE(block.inverse, nullptr);
    }
    const cv::Mat blurred = test::expose(test::blur_along_path(sharp, kAngleRad, path_px), 1, 5);
    cv::Mat in_2d, along_line;
    deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine("fourier"), in_2d);
    deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine("cpu"), along_line);
    EXPECT_GT(test::psnr_db(in_2d(inner), sharp(inner)), test::psnr_db(along_line(inner), sharp(inner)));
  }
}

// At the limit of evenness a box restores the point far from where it was at the middle of the exposure.
TEST(Deconvolve, ShowsAPointWhereItsBlockSays) {
  constexpr int kSide = 320;
  constexpr double kSigmaPx = 2.5;
  const cv::Point2d center(kSide / 2.0, kSide / 2.0);
  cv::Mat blob(kSide, kSide, CV_64F);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const double r2 = std::pow(x - center.x, 2) + std::pow(y - center.y, 2);
      blob.at<double>(y, x) = 20 + 200 * std::exp(-r2 / (2 * kSigmaPx * kSigmaPx));
    }
  }
  const double angle_rad = radians(25);
  const Eigen::Vector2d line(std::cos(angle_rad), std::sin(angle_rad));
  for (const double extent_px : {20.0, 40.0, 60.0}) {
    for (const double share : {0.9, 1.3}) {  // of what still counts as even
      const double gain_px = share * 2 * even_path_px(extent_px);
      std::array<Eigen::Vector2d, kPathInstants> path_px;
      Path1d along_px;
      for (int k = 0; k < kPathInstants; ++k) {
        const double t = k / (kPathInstants - 1.0) - 0.5;
        along_px[k] = static_cast<float>(extent_px * t + 4 * gain_px * t * t);
        path_px[k] = along_px[k] * line;
      }
      const BlockBlur blur = classify_path(path_px, {});
      ASSERT_EQ(blur.nonuniform_path_px.has_value(), share > 1);
      FrameBlur field = uniform_blur_field(kSide, kSide, angle_rad, extent_px, {});
      field.blocks.assign(field.blocks.size(), blur);
      cv::Mat blurred, restored;
      test::blur_along_path(blob, angle_rad, along_px).convertTo(blurred, CV_8U);
      const FilterBank bank{FilterOptions{}};
      deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine("cpu"), restored);
      // The peak of what is left of the blob at its own size, between pixels along the line.
      cv::Mat smooth;
      restored.convertTo(smooth, CV_64F);
      cv::GaussianBlur(smooth, smooth, {}, kSigmaPx);
      cv::Point peak;
      cv::minMaxLoc(smooth, nullptr, nullptr, nullptr, &peak);
      const Eigen::Vector2d shown = blur.apparent_offset_px();
      EXPECT_LT(std::hypot(peak.x - center.x - shown.x(), peak.y - center.y - shown.y()), 1.0)
          << extent_px << ' ' << share << ": found " << peak.x - center.x << ", " << peak.y - center.y << ", expected "
          << shown.transpose();
    }
  }
}

FrameBlur field_of(int width, int height, double degrees, double extent) {
  return uniform_blur_field(width, height, radians(degrees), extent, {});
}

/// What adapt_regularization() and deconvolve() make of an image with noise.
struct Weighed {
  FrameBlur field;
  cv::Mat image;
};
Weighed weigh_and_deconvolve(const cv::Mat& blurred, FrameBlur field, std::optional<double> noise,
                             Regularization rule) {
  FilterOptions options;
  options.regularization = rule;
  const FilterBank bank(options);
  field.noise = noise;
  adapt_regularization(blurred, bank, field);
  Weighed weighed{field, {}};
  deconvolve(blurred, PixelLayout::GRAY, field, bank, *make_engine("cpu"), weighed.image);
  return weighed;
}

// In good light both rules are one.
TEST(AdaptRegularization, GainsInLowLightWhereAFixedRatioLoses) {
  const cv::Mat scene = test::textured_image(400, 300, 11);
  const cv::Rect inner(32, 32, 336, 236);
  for (const double contrast : {1.0, 0.25}) {
    for (const double extent_px : {6.0, 15.0, 30.0}) {
      const double noise = contrast < 1 ? 8 : 0.5;
      cv::Mat light;
      scene.convertTo(light, CV_64F, contrast, 128 * (1 - contrast));
      const cv::Mat sharp = light(inner);
      const cv::Mat blurred = test::expose(test::blur_along_line(light, 0.6, extent_px)(inner), noise, 5);
      const FrameBlur field = uniform_blur_field(blurred.cols, blurred.rows, 0.6, extent_px, {});
      const auto gain_db = [&](Regularization rule) {
        return test::psnr_db(weigh_and_deconvolve(blurred, field, noise, rule).image, sharp) -
               test::psnr_db(blurred, sharp);
      };
      if (contrast < 1) {
        EXPECT_LT(gain_db(Regularization::FIXED), 0) << extent_px;
        EXPECT_GT(gain_db(Regularization::ADAPTIVE), 0.5) << extent_px;
      } else {
        EXPECT_NEAR(gain_db(Regularization::ADAPTIVE), gain_db(Regularization::FIXED), 0.1) << extent_px;
      }
    }
  }
}

// Along an axis the filter has the taps of its kernel; between two, interpolation smooths noise in addition.
TEST(AdaptRegularization, SaysWhatFilteringMakesOfNoise) {
  constexpr double kNoise = 3;
  const cv::Mat light = test::textured_image(400, 300, 11);
  for (const double extent_px : {6.0, 15.0, 30.0}) {
    cv::Mat wide;
    light.convertTo(wide, CV_64F, 0.5, 60);
    const cv::Mat clean = test::expose(test::blur_along_line(wide, 0, extent_px), 0, 5),
                  noisy = test::expose(test::blur_along_line(wide, 0, extent_px), kNoise, 5);
    const FrameBlur field = uniform_blur_field(noisy.cols, noisy.rows, 0, extent_px, {});
    const FilterBank bank{FilterOptions{}};
    FrameBlur weighed = field;
    weighed.noise = kNoise;
    adapt_regularization(noisy, bank, weighed);
    cv::Mat of_clean, of_noisy, difference;
    deconvolve(clean, PixelLayout::GRAY, weighed, bank, *make_engine("cpu"), of_clean);
    deconvolve(noisy, PixelLayout::GRAY, weighed, bank, *make_engine("cpu"), of_noisy);
    cv::subtract(of_noisy, of_clean, difference, cv::noArray(), CV_64F);
    for (int i = 0; i < field.grid.size(); ++i) {
      const cv::Rect rect = field.grid.rect(i);
      if (weighed.blocks[i].status != BlockStatus::DEBLURRED || rect.x < 64 || rect.br().x > 336) continue;
      cv::Scalar mean, stddev;
      cv::meanStdDev(difference(rect), mean, stddev);
      // Said is the whole inverse's, of which the taps are a part: a tenth more, plus the scatter of a block's noise.
      const double said_over_seen = std::sqrt(weighed.blocks[i].noise_gain) * kNoise / stddev[0];
      EXPECT_GT(said_over_seen, 0.93) << extent_px << ' ' << i;
      EXPECT_LT(said_over_seen, 1.15) << extent_px << ' ' << i;
    }
  }
}

TEST(AdaptRegularization, PassesThroughWhatItWouldSpoilAndDoesNotGrainWhatIsFlat) {
  // Texture on the left, nothing on the right.
  cv::Mat light(256, 512, CV_64F, cv::Scalar(120));
  test::textured_image(256, 256, 3).convertTo(light.colRange(0, 256), CV_64F);
  constexpr double kNoise = 3;
  for (const double extent_px : {3.5, 20.0}) {
    const cv::Mat blurred = test::expose(test::blur_along_line(light, 0, extent_px), kNoise, 6);
    const FrameBlur field = uniform_blur_field(512, 256, 0, extent_px, {});
    const Weighed weighed = weigh_and_deconvolve(blurred, field, kNoise, Regularization::ADAPTIVE);
    const cv::Rect flat(320, 0, 192, 256);
    cv::Scalar mean, before, after;
    cv::meanStdDev(blurred(flat), mean, before);
    cv::meanStdDev(weighed.image(flat), mean, after);
    EXPECT_LT(after[0], 1.05 * before[0]) << extent_px;
    for (int i = 0; i < field.grid.size(); ++i) {
      const cv::Rect rect = field.grid.rect(i);
      if (rect.br().x <= 256) {
        EXPECT_EQ(weighed.field.blocks[i].status, BlockStatus::DEBLURRED) << extent_px << ' ' << i;
      }
      if (rect.x >= 320 && extent_px < 10) {
        EXPECT_EQ(weighed.field.blocks[i].status, BlockStatus::NOISY) << extent_px << ' ' << i;
        EXPECT_TRUE(equal(weighed.image(rect), blurred(rect)));
      }
    }
    cv::meanStdDev(weigh_and_deconvolve(blurred, field, kNoise, Regularization::FIXED).image(flat), mean, after);
    EXPECT_GT(after[0], 2 * before[0]) << "a fixed noise-to-signal ratio grains it, " << extent_px;
  }
}

TEST(AdaptRegularization, DoesNothingByOtherRulesOrWhereNoiseIsNotKnown) {
  const cv::Mat blurred = random_image(256, 192, CV_8UC1, 4);
  const FrameBlur field = uniform_blur_field(256, 192, 1, 12, {});
  const auto is_left = [&](std::optional<double> noise, Regularization rule) {
    const Weighed weighed = weigh_and_deconvolve(blurred, field, noise, rule);
    return std::all_of(weighed.field.blocks.begin(), weighed.field.blocks.end(), [](const BlockBlur& block) {
      return block.status == BlockStatus::DEBLURRED && block.noise_to_texture == 0;
    });
  };
  EXPECT_TRUE(is_left(std::nullopt, Regularization::ADAPTIVE));
  EXPECT_TRUE(is_left(9, Regularization::FIXED));
  EXPECT_TRUE(is_left(9, Regularization::PAPER));
  EXPECT_FALSE(is_left(9, Regularization::ADAPTIVE));
  const FilterBank bank{FilterOptions{}};
  FrameBlur copy = field;
  copy.noise = 1;
  EXPECT_THROW(adapt_regularization(cv::Mat(192, 256, CV_16UC1), bank, copy), std::invalid_argument);
  EXPECT_THROW(adapt_regularization(cv::Mat(191, 256, CV_8UC1), bank, copy), std::invalid_argument);
}

TEST(Deconvolve, RestoresAnExactlyBlurredImage) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  const cv::Mat sharp = test::textured_image(400, 300, 11);
  const cv::Rect inner(32, 32, 336, 236);  // so that the blurred image has a real surrounding
  for (const auto& [degrees, extent] : {std::pair{0.0, 12.0}, {37.0, 15.5}, {90.0, 20.0}, {145.0, 27.0}}) {
    const cv::Mat blurred = test::expose(test::blur_along_line(sharp, radians(degrees), extent)(inner), 1.0, 5);
    cv::Mat deblurred;
    deconvolve(blurred, PixelLayout::GRAY, field_of(inner.width, inner.height, degrees, extent), bank, *engine,
               deblurred);
    const double gain = test::psnr_db(deblurred, sharp(inner)) - test::psnr_db(blurred, sharp(inner));
    EXPECT_GE(gain, 2.0) << degrees << " deg, " << extent << " px";
    // The wrong angle must not do: the test has power.
    deconvolve(blurred, PixelLayout::GRAY, field_of(inner.width, inner.height, degrees + 90, extent), bank, *engine,
               deblurred);
    EXPECT_LT(test::psnr_db(deblurred, sharp(inner)), test::psnr_db(blurred, sharp(inner)));
  }
}

TEST(Deconvolve, DoesNotShiftTheImage) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  cv::Mat sharp(101, 101, CV_8UC1, cv::Scalar(20));
  cv::rectangle(sharp, cv::Rect(46, 46, 9, 9), cv::Scalar(220), cv::FILLED);  // centred on (50, 50)
  for (const double extent : {9.0, 10.0, 10.5, 14.0}) {
    const cv::Mat blurred = test::expose(test::blur_along_line(sharp, radians(30), extent), 0.0, 1);
    cv::Mat deblurred;
    deconvolve(blurred, PixelLayout::GRAY, field_of(101, 101, 30, extent), bank, *engine, deblurred);
    const cv::Moments m = cv::moments(cv::Mat(deblurred > 120), true);
    EXPECT_NEAR(m.m10 / m.m00, 50, 0.05) << extent;
    EXPECT_NEAR(m.m01 / m.m00, 50, 0.05) << extent;
  }
}

TEST(Deconvolve, LeavesNoSeamsWhereBlocksMeet) {
  // Neighbouring blocks with the same blur must give what one large block gives.
  const FilterBank bank({});
  const auto engine = make_engine("float");
  const cv::Mat image = random_image(150, 130, CV_8UC1, 2);
  BlurFieldOptions small, large;
  small.block_size_px = 16;
  large.block_size_px = 512;
  cv::Mat blocks, whole;
  deconvolve(image, PixelLayout::GRAY, uniform_blur_field(150, 130, 0.7, 13, small), bank, *engine, blocks);
  deconvolve(image, PixelLayout::GRAY, uniform_blur_field(150, 130, 0.7, 13, large), bank, *engine, whole);
  EXPECT_TRUE(equal(blocks, whole));
}

TEST(Deconvolve, CopiesWhatIsNotToBeDeblurred) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  const cv::Mat image = random_image(200, 100, CV_16UC3, 2);
  FrameBlur field = field_of(200, 100, 20, 15);
  cv::Mat dst;
  const BlockStatus others[] = {BlockStatus::SHARP, BlockStatus::REJECTED, BlockStatus::TOO_LARGE,
                                BlockStatus::NO_GYRO};
  for (std::size_t i = 0; i < field.blocks.size(); ++i) field.blocks[i].status = others[i % 4];
  deconvolve(image, PixelLayout::BGR, field, bank, *engine, dst);
  EXPECT_TRUE(equal(image, dst));

  field.blocks[2].status = BlockStatus::DEBLURRED;
  deconvolve(image, PixelLayout::BGR, field, bank, *engine, dst);
  for (int i = 0; i < field.grid.size(); ++i) {
    const cv::Rect rect = field.grid.rect(i);
    EXPECT_EQ(equal(image(rect), dst(rect)), i != 2) << i;
  }
}

TEST(Deconvolve, CopiesAlphaAndFiltersColoursAsGrey) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  const cv::Mat image = random_image(90, 70, CV_8UC4, 2);
  const FrameBlur field = field_of(90, 70, 120, 9);
  cv::Mat dst;
  deconvolve(image, PixelLayout::RGBA, field, bank, *engine, dst);
  ASSERT_EQ(dst.type(), CV_8UC4);
  for (int c = 0; c < 4; ++c) {
    cv::Mat in, out, expected;
    cv::extractChannel(image, in, c);
    cv::extractChannel(dst, out, c);
    if (c == 3) {
      EXPECT_TRUE(equal(in, out));
    } else {
      deconvolve(in, PixelLayout::GRAY, field, bank, *engine, expected);
      EXPECT_TRUE(equal(expected, out)) << c;
    }
  }
}

TEST(Deconvolve, FiltersBayerPlanesWithHalfTheExtent) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  constexpr Path1d kPath{-6, -5.5f, -4.5f, -2.5f, 0, 3, 6.5f, 10.5f, 15};
  Path1d half_path = kPath;
  for (float& place_px : half_path) place_px /= 2;
  const auto blur_field = [](const cv::Size& size, double extent_px, const std::optional<Path1d>& path_px) {
    BlurFieldOptions options;
    options.block_size_px = 1024;
    FrameBlur field = uniform_blur_field(size.width, size.height, 0.5, extent_px, options);
    field.blocks[0].nonuniform_path_px = path_px;
    return field;
  };
  struct Case {
    cv::Size size;
    bool nonuniform;
  };
  for (const Case& of :
       {Case{{128, 128}, false}, Case{{131, 97}, false}, Case{{129, 65}, false}, Case{{131, 97}, true}}) {
    const cv::Size size = of.size;
    const bool nonuniform = of.nonuniform;
    for (const int type : {CV_8UC1, CV_16UC1}) {
      const cv::Mat mosaic = random_image(size.width, size.height, type, 6);
      const FrameBlur field = blur_field(size, 21, nonuniform ? std::optional(kPath) : std::nullopt);
      cv::Mat dst;
      deconvolve(mosaic, PixelLayout::BAYER_GRBG, field, bank, *engine, dst);
      for (int py = 0; py < 2; ++py) {
        for (int px = 0; px < 2; ++px) {
          const auto plane_of = [&](const cv::Mat& from) {
            cv::Mat plane((size.height - py + 1) / 2, (size.width - px + 1) / 2, type);
            for (int y = 0; y < plane.rows; ++y) {
              for (int x = 0; x < plane.cols; ++x) {
                from(cv::Rect(2 * x + px, 2 * y + py, 1, 1)).copyTo(plane(cv::Rect(x, y, 1, 1)));
              }
            }
            return plane;
          };
          const cv::Mat plane = plane_of(mosaic);
          cv::Mat expected;
          deconvolve(plane, PixelLayout::GRAY,
                     blur_field(plane.size(), 10.5, nonuniform ? std::optional(half_path) : std::nullopt), bank,
                     *engine, expected);
          EXPECT_TRUE(equal(expected, plane_of(dst))) << px << py << nonuniform;
        }
      }
    }
  }
}

TEST(Deconvolve, HandlesBayerBlocksAndTinyMosaics) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  cv::Mat dst;
  // Several blocks give what one gives.
  const cv::Mat mosaic = random_image(131, 97, CV_8UC1, 6);
  BlurFieldOptions small, large;
  small.block_size_px = 10;
  large.block_size_px = 1024;
  cv::Mat blocks, whole;
  deconvolve(mosaic, PixelLayout::BAYER_RGGB, uniform_blur_field(131, 97, 2.0, 11, small), bank, *engine, blocks);
  deconvolve(mosaic, PixelLayout::BAYER_RGGB, uniform_blur_field(131, 97, 2.0, 11, large), bank, *engine, whole);
  EXPECT_TRUE(equal(blocks, whole));
  // A blur of 1.5 px is none on the planes.
  BlurFieldOptions low;
  low.min_extent_px = 1;
  deconvolve(mosaic, PixelLayout::BAYER_RGGB, uniform_blur_field(131, 97, 2.0, 1.5, low), bank, *engine, dst);
  EXPECT_TRUE(equal(mosaic, dst));
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(2, 1), cv::Size(1, 3), cv::Size(11, 1)}) {
    const cv::Mat tiny = random_image(size.width, size.height, CV_8UC1, 6);
    deconvolve(tiny, PixelLayout::BAYER_RGGB, uniform_blur_field(size.width, size.height, 2.0, 30, small), bank,
               *engine, dst);
    EXPECT_EQ(dst.size(), size);
  }
}

// 16 bit and a short blur is slow on the cpu engine, also where the extent is halved on the planes of a mosaic.
TEST(Deconvolve, CountsBlocksLeftToTheFloatEngine) {
  const FilterBank bank({});
  const auto engine = make_engine("cpu", 1);
  cv::Mat dst;
  const auto slow = [&](int type, PixelLayout layout, double extent_px) {
    FrameBlur field = field_of(200, 100, 20, extent_px);  // 4 x 2 blocks of 64 px
    field.blocks[3].status = BlockStatus::REJECTED;
    return deconvolve(random_image(200, 100, type, 2), layout, field, bank, *engine, dst);
  };
  for (const auto& [type, layout, longest_slow_px] : {std::tuple{CV_16UC1, PixelLayout::GRAY, 35.0},
                                                      {CV_16UC3, PixelLayout::BGR, 35.0},
                                                      {CV_16UC4, PixelLayout::RGBA, 35.0},
                                                      {CV_16UC1, PixelLayout::BAYER_RGGB, 70.0}}) {
    const FallbackCounts short_blur = slow(type, layout, longest_slow_px);
    ASSERT_EQ(short_blur.size(), 1u) << type;
    EXPECT_EQ(short_blur.begin()->first.rfind("16 bit", 0), 0u) << short_blur.begin()->first;
    EXPECT_EQ(short_blur.begin()->second, 7u) << "each block once, whatever it has of channels or planes";
    EXPECT_EQ(slow(type, layout, longest_slow_px + 3), FallbackCounts{}) << type;
  }
  EXPECT_EQ(slow(CV_8UC1, PixelLayout::GRAY, 20), FallbackCounts{});
  FrameBlur sharp = field_of(200, 100, 20, 20);
  for (BlockBlur& block : sharp.blocks) block.status = BlockStatus::SHARP;
  EXPECT_EQ(deconvolve(random_image(200, 100, CV_16UC1, 2), PixelLayout::GRAY, sharp, bank, *engine, dst),
            FallbackCounts{})
      << "nothing of the image before";
}

TEST(KeepLarger, TakesTheLargerNumberOfEachReason) {
  FallbackCounts all{{"a", 3}, {"b", 2}};
  keep_larger({{"b", 5}, {"a", 1}, {"c", 4}}, all);
  EXPECT_EQ(all, (FallbackCounts{{"a", 3}, {"b", 5}, {"c", 4}}));
}

TEST(Deconvolve, RefusesWhatDoesNotFit) {
  const FilterBank bank({});
  const auto engine = make_engine("float");
  cv::Mat dst;
  EXPECT_THROW(
      deconvolve(random_image(20, 20, CV_8UC1, 1), PixelLayout::GRAY, field_of(21, 20, 0, 10), bank, *engine, dst),
      std::invalid_argument);
  EXPECT_THROW(
      deconvolve(random_image(20, 20, CV_8UC1, 1), PixelLayout::BGR, field_of(20, 20, 0, 10), bank, *engine, dst),
      std::invalid_argument);
}

// What is made ahead is all that frames need, at any angle and in the planes of a mosaic, and no more than that is
// kept.
TEST(PrepareDeconvolution, LeavesNothingToMakeForAFrame) {
  const FilterBank bank{FilterOptions{}};
  CpuEngine engine(2);
  BlurFieldOptions options;
  const auto designs_for = [&](double max_extent_px) {
    options.max_extent_px = max_extent_px;
    prepare_deconvolution(options, bank, engine, 2);
    return engine.prepared_designs();
  };
  const std::size_t designs = designs_for(90), kernels = bank.size();
  EXPECT_GT(designs, 0u);
  const cv::Size size(640, 480);
  const cv::Mat image = random_image(size.width, size.height, CV_8UC1, 3);
  cv::Mat dst;
  for (int step = 0; step < 40; ++step) {
    FrameBlur field = field_of(size.width, size.height, 0, 20);
    for (int i = 0; i < field.grid.size(); ++i) {
      field.blocks[i].angle_rad = static_cast<float>(CV_PI * (7 * i + step) / (7.0 * field.grid.size() + 40));
      field.blocks[i].extent_px = static_cast<float>(3 + (90 - 3) * std::fmod(0.37 * i + 0.0247 * step, 1.0));
    }
    const bool mosaic = step % 2 == 1;
    deconvolve(image, mosaic ? PixelLayout::BAYER_RGGB : PixelLayout::GRAY, field, bank, engine, dst, 2);
  }
  EXPECT_EQ(bank.size(), kernels);
  EXPECT_EQ(engine.prepared_designs(), designs);
  EXPECT_GT(designs_for(150), designs);
  EXPECT_EQ(designs_for(90), designs) << "what longer blur needs is forgotten";
  EXPECT_EQ(designs_for(30), 0u) << "exact taps need no design";
}

}  // namespace
}  // namespace gyro_deblur::deconvolution_test
