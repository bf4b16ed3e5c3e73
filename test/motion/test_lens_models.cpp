#include "motion/lens_models.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

#include "gyro_deblur/camera.hpp"

namespace gyro_deblur {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kHalfPi = 1.57079632679489661923;
constexpr double kFocalPx = 460;

/// What to try each model with, by its name. A model that is not here fails its tests.
const std::map<std::string, std::vector<std::vector<double>>>& coefficients() {
  static const std::map<std::string, std::vector<std::vector<double>>> kCoefficients{
      {"none", {{}}},
      // The second one, of r (1 + k1 r^2), folds back at r = 0.9129; the third is EuRoC's first camera.
      {"plumb_bob",
       {{}, {-0.4, 0, 0, 0}, {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}, {0.2, 0.1, 0.001, -0.002, 0.05}}},
      {"rational_polynomial",
       {{0.5219, -2.6257, 0.00085, -0.00049, 1.5428, 0.4019, -2.4475, 1.4666},
        {0.6, -0.2, 0, 0, 0.01, 0.85, -0.12, -0.01}}},
      // The second one, of a (1 + k1 a^2), folds back at 1.054 rad.
      {"equidistant", {{0, 0, 0, 0}, {-0.3, 0, 0, 0}, {0.0034823894, 0.0007150348, -0.0020532361, 0.00020293673}}},
  };
  return kCoefficients;
}

class EveryLensModel : public testing::TestWithParam<LensModelRow> {
 protected:
  void SetUp() override { ASSERT_TRUE(coefficients().count(GetParam().name)) << "add coefficients to this test"; }

  /// Lenses of the model, and the coefficients of each in words.
  struct Lens {
    std::unique_ptr<const LensModel> model;
    std::string text;
    bool only_radial;
  };
  std::vector<Lens> lenses() const {
    std::vector<Lens> result;
    for (const std::vector<double>& k : coefficients().at(GetParam().name)) {
      std::string text = GetParam().name;
      for (const double coefficient : k) text += " " + std::to_string(coefficient);
      const bool only_radial = GetParam().name == "equidistant" || k.empty() || (k[2] == 0 && k[3] == 0);
      result.push_back({GetParam().make(k), text, only_radial});
    }
    return result;
  }
};

Eigen::Vector2d at(double angle_rad, double azimuth_rad) {
  return std::tan(angle_rad) * Eigen::Vector2d(std::cos(azimuth_rad), std::sin(azimuth_rad));
}

TEST_P(EveryLensModel, TakesTheCoefficientsOfTheTest) {
  const std::vector<std::size_t>& counts = GetParam().coefficient_counts;
  std::set<std::size_t> tried;
  for (const std::vector<double>& k : coefficients().at(GetParam().name)) tried.insert(k.size());
  EXPECT_EQ(tried, std::set<std::size_t>(counts.begin(), counts.end()));
}

// Rays to the image and back, and points of the image to rays and back, in all directions from the axis and up to the
// end of the valid range, or to 84 degrees (a tenth of the focal length from the image plane) where it has none.
// Tangential distortion makes the range end earlier on one side; such lenses go to 0.9 of their range.
TEST_P(EveryLensModel, ComesBackOverItsValidRange) {
  constexpr double kTolerance = 1e-6 / kFocalPx;
  for (const Lens& lens : lenses()) {
    SCOPED_TRACE(lens.text);
    const double end_rad = lens.model->max_angle_rad();
    ASSERT_GT(end_rad, 0.5) << "a lens of 57 degrees or more";
    ASSERT_LE(end_rad, kHalfPi);
    const double last_rad = std::min(1.47, (lens.only_radial ? 0.9999 : 0.9) * end_rad);
    EXPECT_EQ(lens.model->project({0, 0}), Eigen::Vector2d(0, 0));
    EXPECT_LT(lens.model->unproject({0, 0}, kFocalPx).norm(), kTolerance);
    constexpr int kAngles = 200, kAzimuths = 16;
    for (int i = 1; i <= kAngles; ++i) {
      for (int j = 0; j < kAzimuths; ++j) {
        const double angle_rad = last_rad * i / kAngles, azimuth_rad = 4 * kHalfPi * j / kAzimuths;
        SCOPED_TRACE(testing::Message() << angle_rad << " rad at azimuth " << azimuth_rad << " rad");
        const Eigen::Vector2d ray = at(angle_rad, azimuth_rad);
        const Eigen::Vector2d point = lens.model->project(ray);
        ASSERT_TRUE(point.allFinite());
        const Eigen::Vector2d back = lens.model->unproject(point, kFocalPx);
        ASSERT_TRUE(back.allFinite());
        // As angles: near the end of the range a step of the ray hardly moves the point.
        const double apart_rad =
            std::atan2(back.homogeneous().cross(ray.homogeneous()).norm(), back.homogeneous().dot(ray.homogeneous()));
        ASSERT_LT(apart_rad, 1e-6);
        ASSERT_LT((lens.model->project(back) - point).norm(), kTolerance);
      }
    }
  }
}

TEST_P(EveryLensModel, IsNotANumberBeyondItsValidRange) {
  for (const Lens& lens : lenses()) {
    SCOPED_TRACE(lens.text);
    for (const Eigen::Vector2d& nowhere : {Eigen::Vector2d(kNan, 0), Eigen::Vector2d(0, kNan)}) {
      EXPECT_FALSE(lens.model->project(nowhere).allFinite());
      EXPECT_FALSE(lens.model->unproject(nowhere, kFocalPx).allFinite());
    }
    EXPECT_FALSE(lens.model->unproject({std::numeric_limits<double>::infinity(), 0}, kFocalPx).allFinite());
    const double end_rad = lens.model->max_angle_rad();
    for (double azimuth_rad = 0; azimuth_rad < 4 * kHalfPi; azimuth_rad += 0.5) {
      SCOPED_TRACE(azimuth_rad);
      if (end_rad < kHalfPi) {
        EXPECT_FALSE(lens.model->project(at(end_rad + 1e-9, azimuth_rad)).allFinite());
        EXPECT_FALSE(lens.model->project(at(0.5 * (end_rad + kHalfPi), azimuth_rad)).allFinite());
      }
      // The point farthest from the axis; nothing comes out beyond it. Some lenses reach any point.
      const Eigen::Vector2d farthest = lens.model->project(at(end_rad - 1e-9, azimuth_rad));
      ASSERT_TRUE(farthest.allFinite());
      constexpr double kAnywhere = 1e6;
      if (farthest.norm() > kAnywhere) {
        EXPECT_EQ(end_rad, kHalfPi) << "only a ray within the image plane goes so far";
        continue;
      }
      EXPECT_FALSE(lens.model->unproject(1.05 * farthest, kFocalPx).allFinite());
      EXPECT_FALSE(lens.model->unproject(100 * farthest, kFocalPx).allFinite());
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Table, EveryLensModel, testing::ValuesIn(lens_models()),
                         [](const testing::TestParamInfo<LensModelRow>& row) { return row.param.name; });

TEST(LensModels, EndWhereTheirCurvesFoldBack) {
  // r (1 + k1 r^2) increases up to 1 / sqrt(-3 k1), and so does the angle.
  EXPECT_NEAR(std::tan(lens_model("plumb_bob").make({-0.4, 0, 0, 0})->max_angle_rad()), 1 / std::sqrt(1.2), 1e-9);
  EXPECT_NEAR(lens_model("equidistant").make({-0.3, 0, 0, 0})->max_angle_rad(), 1 / std::sqrt(0.9), 1e-9);
  for (const char* name : {"none", "plumb_bob"}) EXPECT_EQ(lens_model(name).make({})->max_angle_rad(), kHalfPi);
  EXPECT_EQ(lens_model("equidistant").make({0, 0, 0, 0})->max_angle_rad(), kHalfPi);
}

TEST(LensModels, HaveOneNameEach) {
  std::set<std::string> names, kalibr, euroc, camodocal;
  const auto add = [](std::set<std::string>& known, const std::string& name) {
    return name.empty() || known.insert(name).second;
  };
  for (const LensModelRow& row : lens_models()) {
    EXPECT_FALSE(row.name.empty());
    EXPECT_TRUE(add(names, row.name) && add(kalibr, row.kalibr.name) && add(euroc, row.euroc.name) &&
                add(camodocal, row.camodocal.name))
        << row.name;
    EXPECT_EQ(&lens_model(row.name), &row);
    EXPECT_EQ(require_distortion_model(row.name), row.name);
    // Every format lists a number of coefficients that the model takes.
    const auto takes = [&](std::size_t count) {
      for (const std::size_t allowed : row.coefficient_counts) {
        if (count == allowed) return true;
      }
      return false;
    };
    for (const ListedLens& lens : {row.kalibr, row.euroc}) EXPECT_TRUE(lens.name.empty() || takes(lens.coefficients));
    EXPECT_TRUE(row.camodocal.name.empty() || takes(row.camodocal.coefficients.size())) << row.name;
    EXPECT_TRUE(std::is_sorted(row.coefficient_counts.begin(), row.coefficient_counts.end())) << row.name;
    EXPECT_NO_THROW(lens_model(row.camera_info_name)) << row.name;
  }
}

TEST(LensModels, AnUnknownNameListsWhatThereIs) {
  std::string known;
  for (const std::string& name : lens_model_names()) known += " " + name;
  EXPECT_EQ(known, " plumb_bob rational_polynomial equidistant none");
  for (const char* name : {"fov", "Plumb_bob", "radtan"}) {
    try {
      lens_model(name);
      FAIL();
    } catch (const OptionError& error) {
      EXPECT_EQ(error.what(), "distortion_model = \"" + std::string(name) + "\" is not one of" + known);
    }
  }
}

}  // namespace
}  // namespace gyro_deblur
