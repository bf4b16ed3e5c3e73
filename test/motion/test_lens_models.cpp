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

namespace gyro_deblur::lens_models_test {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kHalfPi = 1.57079632679489661923;
constexpr double kFocalPx = 460;
/// From the axis, in focal lengths: farther than any image reaches. Some lenses put rays at the end of their range
/// millions of pixels away, where doubles have no digits left below 1e-6 px.
constexpr double kFarthest = 100;

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
      // An ideal lens; fisheyes of 195 and 140 degrees; parabolas; ranges that end in front of the image plane.
      {"ds", {{0, 0}, {-0.17, 0.59}, {-0.28, 0.55}, {1, 0.5}, {0, 1}, {0.6, 0.2}, {-0.5, 0.2}, {-0.6, 0}, {-0.9, 0.7}}},
      {"eucm", {{0, 1}, {0.59, 1.13}, {0.5, 1}, {1, 0.8}, {0.3, 2}}},
      // An ideal lens; a mirror; fisheyes; one whose plane folds back at a radius of 0.4564, 47.3 degrees from the
      // axis.
      {"mei",
       {{0, 0, 0, 0, 0},
        {1, 0, 0, 0, 0},
        {2.2, 0.14, 0.91, 0.0012, 0.002},
        {1.5, -0.1, 0.02, 0, 0},
        {0.8, -1.6, 0, 0, 0}}},
  };
  return kCoefficients;
}

/// Where the published definition has the ray (x, y, z) of any length; NaN beyond the valid range that is published
/// with it.
using Definition = Eigen::Vector2d (*)(const std::vector<double>& k, const Eigen::Vector3d& point);

/// Usenko, Demmel, Cremers 2018, equations 40 to 45.
Eigen::Vector2d double_sphere(const std::vector<double>& k, const Eigen::Vector3d& point) {
  const double xi = k[0], alpha = k[1], x = point.x(), y = point.y(), z = point.z();
  const double d1 = std::sqrt(x * x + y * y + z * z);
  const double d2 = std::sqrt(x * x + y * y + (xi * d1 + z) * (xi * d1 + z));
  const double w1 = alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha;
  const double w2 = (w1 + xi) / std::sqrt(2 * w1 * xi + xi * xi + 1);
  if (!(z > -w2 * d1)) return {kNan, kNan};
  const double denominator = alpha * d2 + (1 - alpha) * (xi * d1 + z);
  return {x / denominator, y / denominator};
}

/// The same, equations 20 to 23.
Eigen::Vector2d extended_unified(const std::vector<double>& k, const Eigen::Vector3d& point) {
  const double alpha = k[0], beta = k[1], x = point.x(), y = point.y(), z = point.z();
  const double d = std::sqrt(beta * (x * x + y * y) + z * z);
  const double w = alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha;
  if (!(z > -w * d)) return {kNan, kNan};
  return {x / (alpha * d + (1 - alpha) * z), y / (alpha * d + (1 - alpha) * z)};
}

/// Mei, Rives 2007, section II: to the unit sphere, by xi along its axis, to the plane, radial and tangential
/// distortion, of which that paper's k3 and k4 are p1 and p2 here.
Eigen::Vector2d mei(const std::vector<double>& k, const Eigen::Vector3d& point) {
  const Eigen::Vector3d on_sphere = point.normalized() + Eigen::Vector3d(0, 0, k[0]);
  const double u = on_sphere.x() / on_sphere.z(), v = on_sphere.y() / on_sphere.z();
  const double rho2 = u * u + v * v;
  const double radial = 1 + k[1] * rho2 + k[2] * rho2 * rho2;
  return {u * radial + 2 * k[3] * u * v + k[4] * (rho2 + 2 * u * u),
          v * radial + k[3] * (rho2 + 2 * v * v) + 2 * k[4] * u * v};
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
      result.push_back({make_lens(GetParam(), k), text, is_radial(k)});
    }
    return result;
  }

 private:
  /// No tangential distortion.
  static bool is_radial(const std::vector<double>& k) {
    const std::map<std::string, std::size_t> first{{"plumb_bob", 2}, {"rational_polynomial", 2}, {"mei", 3}};
    const auto p1 = first.find(GetParam().name);
    return p1 == first.end() || k.empty() || (k[p1->second] == 0 && k[p1->second + 1] == 0);
  }
};

Eigen::Vector2d at(double angle_rad, double azimuth_rad) {
  return std::tan(angle_rad) * Eigen::Vector2d(std::cos(azimuth_rad), std::sin(azimuth_rad));
}

std::string error_of(const LensModelRow& model, const std::vector<double>& coefficients) {
  try {
    make_lens(model, coefficients);
  } catch (const OptionError& error) {
    return error.what();
  }
  return "accepted";
}

TEST_P(EveryLensModel, TakesZerosThatAreMissingOrTooMany) {
  const LensModelRow& model = GetParam();
  for (std::vector<double> k : coefficients().at(model.name)) {
    ASSERT_LE(k.size(), model.coefficient_count);
    k.resize(model.coefficient_count, 0.0);
    const auto lens = make_lens(model, k);
    const std::vector<double> given = k;
    // As far as what is left out is 0.
    while (k.size() > model.fewest_given && k.back() == 0) {
      k.pop_back();
      const auto shorter = make_lens(model, k);
      EXPECT_EQ(shorter->max_angle_rad(), lens->max_angle_rad());
      for (double angle_rad = 0.1; angle_rad < 0.7; angle_rad += 0.1) {
        EXPECT_EQ(shorter->project(at(angle_rad, 1)), lens->project(at(angle_rad, 1))) << k.size();
      }
    }
    k = given;
    for (const std::size_t count : {5u, 8u, 12u, 14u}) {
      if (count <= model.coefficient_count) continue;
      k.resize(count, 0.0);
      EXPECT_EQ(make_lens(model, k)->project(at(0.3, 1)), lens->project(at(0.3, 1)));
      k.back() = 0.25;
      EXPECT_EQ(error_of(model, k), "camera distortion has " + std::to_string(count) + " coefficients, but " +
                                        model.name + " has " + std::to_string(model.coefficient_count) + ": number " +
                                        std::to_string(count) + " is 0.25, where only zeros are allowed");
      k.back() = 0;
    }
  }
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
        if (point.norm() > kFarthest) continue;
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
        // Only a ray within the image plane goes so far; of a double sphere, one that its second sphere sees there.
        EXPECT_TRUE(end_rad == kHalfPi || GetParam().name == "ds");
        continue;
      }
      EXPECT_FALSE(lens.model->unproject(1.05 * farthest, kFocalPx).allFinite());
      EXPECT_FALSE(lens.model->unproject(100 * farthest, kFocalPx).allFinite());
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Table, EveryLensModel, testing::ValuesIn(lens_models()),
                         [](const testing::TestParamInfo<LensModelRow>& row) { return row.param.name; });

double max_angle_rad(const std::string& name, const std::vector<double>& coefficients) {
  return make_lens(lens_model(name), coefficients)->max_angle_rad();
}

TEST(LensModels, EndWhereTheirCurvesFoldBack) {
  // r (1 + k1 r^2) increases up to 1 / sqrt(-3 k1), and so does the angle.
  EXPECT_NEAR(std::tan(max_angle_rad("plumb_bob", {-0.4, 0, 0, 0})), 1 / std::sqrt(1.2), 1e-9);
  EXPECT_NEAR(max_angle_rad("equidistant", {-0.3, 0, 0, 0}), 1 / std::sqrt(0.9), 1e-9);
  for (const char* name : {"none", "plumb_bob"}) EXPECT_EQ(max_angle_rad(name, {}), kHalfPi);
  EXPECT_EQ(max_angle_rad("equidistant", {0, 0, 0, 0}), kHalfPi);
  // The plane of this one ends at a radius of 1 / sqrt(-3 k1), which the ray at the end has there.
  const double end_rad = max_angle_rad("mei", {0.8, -1.6, 0, 0, 0});
  EXPECT_NEAR(std::sin(end_rad) / (0.8 + std::cos(end_rad)), 1 / std::sqrt(4.8), 1e-9);
  EXPECT_EQ(max_angle_rad("mei", {1, 0, 0, 0, 0}), kHalfPi);
  EXPECT_EQ(max_angle_rad("eucm", {0.59, 1.13}), kHalfPi);
  // Usenko et al.: z > -w2 d1, here with w1 = 0.25 and w2 = -0.25.
  EXPECT_NEAR(max_angle_rad("ds", {-0.5, 0.2}), std::acos(0.25), 1e-9);
  EXPECT_EQ(max_angle_rad("ds", {-0.17, 0.59}), kHalfPi);
  // A pinhole 0.6 in front of the sphere's centre: the denominator xi d1 + z is 0 at a cosine of 0.6, which w2 misses.
  EXPECT_NEAR(max_angle_rad("ds", {-0.6, 0}), std::acos(0.6), 1e-9);
}

// Newton's first step leads from such a point to itself.
TEST(LensModels, AnIdealLensGivesBackThePointItself) {
  for (const char* name : {"none", "plumb_bob", "rational_polynomial"}) {
    const auto lens = make_lens(lens_model(name), {});
    for (const Eigen::Vector2d& point :
         {Eigen::Vector2d(0.3, -0.7), Eigen::Vector2d(1e-3, 0.2), Eigen::Vector2d(5, 3)}) {
      EXPECT_EQ(lens->unproject(point, kFocalPx), point) << name;
    }
  }
}

// In pixels, over the valid range, for rays of any length and in all directions from the axis.
TEST(LensModels, AgreeWithTheirPublishedDefinitions) {
  constexpr double kTolerancePx = 1e-8;
  const std::map<std::string, Definition> definitions{{"ds", double_sphere}, {"eucm", extended_unified}, {"mei", mei}};
  for (const auto& [name, definition] : definitions) {
    for (const std::vector<double>& k : coefficients().at(name)) {
      CameraCalibration calibration;
      calibration.width_px = 752;
      calibration.height_px = 480;
      calibration.fx_px = kFocalPx;
      calibration.fy_px = 0.99 * kFocalPx;
      calibration.cx_px = 367.2;
      calibration.cy_px = 248.4;
      calibration.model = name;
      calibration.coefficients = k;
      const Camera camera(calibration);
      const double last_rad = std::min(1.55, 0.9999 * max_angle_rad(name, k));
      for (int i = 0; i <= 200; ++i) {
        for (int j = 0; j < 16; ++j) {
          const double angle_rad = last_rad * i / 200, azimuth_rad = 4 * kHalfPi * j / 16, length = 0.1 + j;
          SCOPED_TRACE(testing::Message() << name << " " << k[0] << ": " << angle_rad << ", " << azimuth_rad);
          const Eigen::Vector3d point(length * std::sin(angle_rad) * std::cos(azimuth_rad),
                                      length * std::sin(angle_rad) * std::sin(azimuth_rad),
                                      length * std::cos(angle_rad));
          const Eigen::Vector2d expected = definition(k, point);
          ASSERT_TRUE(expected.allFinite());
          if (expected.norm() > kFarthest) continue;
          const Eigen::Vector2d expected_px(calibration.fx_px * expected.x() + calibration.cx_px,
                                            calibration.fy_px * expected.y() + calibration.cy_px);
          ASSERT_LT((camera.project(point) - expected_px).norm(), kTolerancePx);
        }
      }
      // Nothing of the published range that is in front of the image plane is missing, but what the plane folds over
      // (mei), and what the second sphere does not see, where w2 is not exact (ds).
      if (name == "mei") continue;
      for (double angle_rad = 0.01; angle_rad < 1.57; angle_rad += 0.01) {
        const Eigen::Vector3d point(std::sin(angle_rad), 0, std::cos(angle_rad));
        bool is_valid = definition(k, point).allFinite();
        if (name == "ds") {
          const double w1 = k[1] <= 0.5 ? k[1] / (1 - k[1]) : (1 - k[1]) / k[1], z2 = k[0] + point.z();
          is_valid = is_valid && z2 > -w1 * std::hypot(point.x(), z2);
        }
        EXPECT_EQ(camera.project(point).allFinite(), is_valid) << name << " " << angle_rad;
      }
    }
  }
}

TEST(LensModels, RefuseShapesThatAreNone) {
  EXPECT_EQ(error_of(lens_model("ds"), {}),
            "camera distortion has 0 coefficients, but ds has 2, of which xi and alpha have to be given");
  EXPECT_EQ(error_of(lens_model("eucm"), {0.5}),
            "camera distortion has 1 coefficients, but eucm has 2, of which alpha and beta have to be given");
  EXPECT_EQ(error_of(lens_model("mei"), {}),
            "camera distortion has 0 coefficients, but mei has 5, of which xi have to be given");
  EXPECT_EQ(error_of(lens_model("equidistant"), {}),
            "camera distortion has 0 coefficients, but equidistant has 4, of which the first has to be given");
  EXPECT_NE(error_of(lens_model("ds"), {-1.1, 0.5}).find("(xi of ds) = -1.1 is outside"), std::string::npos);
  EXPECT_NE(error_of(lens_model("ds"), {0, 1.1}).find("(alpha of ds) = 1.1 is outside"), std::string::npos);
  EXPECT_NE(error_of(lens_model("eucm"), {0.5, 0}).find("(beta of eucm) = 0 is outside"), std::string::npos);
  EXPECT_NE(error_of(lens_model("mei"), {-0.1, 0, 0, 0, 0}).find("(xi of mei) = -0.1 is outside"), std::string::npos);
  EXPECT_NE(error_of(lens_model("mei"), {1, kNan}).find("coefficient 2 = nan is outside"), std::string::npos);
}

TEST(LensModels, HaveOneNameEach) {
  std::set<std::string> names, kalibr, euroc, camodocal, basalt;
  const auto add = [](std::set<std::string>& known, const std::string& name) {
    return name.empty() || known.insert(name).second;
  };
  for (const LensModelRow& row : lens_models()) {
    EXPECT_FALSE(row.name.empty());
    const std::string in_kalibr = row.kalibr.camera_model + " " + row.kalibr.distortion_model;
    EXPECT_TRUE(add(names, row.name) && add(kalibr, in_kalibr == " " ? "" : in_kalibr) && add(euroc, row.euroc.name) &&
                add(camodocal, row.camodocal.name) && add(basalt, row.basalt.name))
        << row.name;
    EXPECT_EQ(&lens_model(row.name), &row);
    EXPECT_EQ(require_distortion_model(row.name), row.name);
    // No format has a coefficient that the model lacks.
    EXPECT_LE(row.kalibr.in_intrinsics + row.kalibr.in_distortion, row.coefficient_count) << row.name;
    EXPECT_LE(row.euroc.in_distortion, row.coefficient_count) << row.name;
    for (const KeyedLens& lens : {row.camodocal, row.basalt}) {
      EXPECT_LE(lens.coefficients.size(), row.coefficient_count) << row.name;
      for (const std::string& key : lens.intrinsics) EXPECT_EQ(key.empty(), lens.name.empty()) << row.name;
    }
    EXPECT_LE(row.fewest_given, row.coefficient_count) << row.name;
    EXPECT_LE(row.shape.size(), row.fewest_given) << row.name;
  }
}

TEST(LensModels, AnUnknownNameListsWhatThereIs) {
  std::string known;
  for (const std::string& name : lens_model_names()) known += " " + name;
  EXPECT_EQ(known, " plumb_bob rational_polynomial equidistant ds eucm mei none");
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
}  // namespace gyro_deblur::lens_models_test
