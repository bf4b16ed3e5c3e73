#include "gyro_deblur/camera.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>

#include <gtest/gtest.h>
#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>

namespace gyro_deblur::camera_test {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

CameraCalibration calibration(int width_px, int height_px, double f_px, const std::string& model,
                              std::vector<double> coefficients) {
  CameraCalibration c;
  c.width_px = width_px;
  c.height_px = height_px;
  c.fx_px = f_px;
  c.fy_px = 0.99 * f_px;
  c.cx_px = 0.49 * width_px;
  c.cy_px = 0.52 * height_px;
  c.model = model;
  c.coefficients = std::move(coefficients);
  return c;
}

struct Lens {
  const char* name;
  CameraCalibration calibration;
  double reach_px = 1e9;  // distance from the principal point within which every pixel has a ray

  bool reaches(double x_px, double y_px) const {
    return std::hypot(x_px - calibration.cx_px, y_px - calibration.cy_px) < reach_px;
  }
};

/// Published calibrations of real cameras, and extreme ones.
std::vector<Lens> lenses() {
  return {
      {"none", calibration(640, 480, 500, "none", {})},
      {"plumb_bob_empty", calibration(640, 480, 500, "plumb_bob", {})},
      {"euroc_cam0",
       calibration(752, 480, 458.654, "plumb_bob", {-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05})},
      {"pincushion", calibration(752, 480, 458, "plumb_bob", {0.2, 0.1, 0.001, -0.002, 0.05})},
      {"strong_tangential", calibration(752, 480, 458, "plumb_bob", {-0.25, 0.08, 0.01, -0.015, -0.01})},
      {"kinect_rational", calibration(1280, 720, 608, "rational_polynomial",
                                      {0.5219, -2.6257, 0.00085, -0.00049, 1.5428, 0.4019, -2.4475, 1.4666})},
      {"tum_vi_equidistant",
       calibration(512, 512, 190.978, "equidistant", {0.0034823894, 0.0007150348, -0.0020532361, 0.00020293673}),
       1.5 * 190},
      {"pure_equidistant", calibration(640, 480, 250, "equidistant", {0, 0, 0, 0}), 1.5 * 247},
  };
}

class EveryLens : public testing::TestWithParam<Lens> {};

cv::Matx33d camera_matrix(const CameraCalibration& c) { return {c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1}; }

TEST_P(EveryLens, ProjectsLikeOpenCv) {
  const CameraCalibration& c = GetParam().calibration;
  const Camera camera(c);
  // Directions that the image sees.
  std::vector<cv::Point3d> points;
  for (double y = 0; y < c.height_px; y += 23.3) {
    for (double x = 0; x < c.width_px; x += 31.7) {
      if (!GetParam().reaches(x, y)) continue;
      const Eigen::Vector3d ray = camera.ray({x, y});
      ASSERT_TRUE(ray.allFinite()) << x << ' ' << y;
      points.emplace_back(2.5 * ray.x(), 2.5 * ray.y(), 2.5 * ray.z());
    }
  }
  std::vector<cv::Point2d> expected;
  const cv::Vec3d zero(0, 0, 0);
  if (c.model == "equidistant") {
    cv::fisheye::projectPoints(points, expected, zero, zero, camera_matrix(c), c.coefficients);
  } else {
    cv::projectPoints(points, zero, zero, camera_matrix(c), c.coefficients, expected);
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector2d pixel = camera.project({points[i].x, points[i].y, points[i].z});
    EXPECT_NEAR(pixel.x(), expected[i].x, 1e-8);
    EXPECT_NEAR(pixel.y(), expected[i].y, 1e-8);
  }
}

TEST_P(EveryLens, RaysComeBackToTheirPixels) {
  const CameraCalibration& c = GetParam().calibration;
  const Camera camera(c);
  std::vector<Eigen::Vector2d> pixels{
      {c.cx_px, c.cy_px}, {0, 0}, {c.width_px - 1.0, 0}, {0, c.height_px - 1.0}, {c.width_px - 1.0, c.height_px - 1.0}};
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(0, 1);
  for (int i = 0; i < 2000; ++i) pixels.emplace_back(u(rng) * (c.width_px - 1), u(rng) * (c.height_px - 1));
  pixels.erase(std::remove_if(pixels.begin(), pixels.end(),
                              [](const Eigen::Vector2d& p) { return !GetParam().reaches(p.x(), p.y()); }),
               pixels.end());
  ASSERT_GT(pixels.size(), 1000u);
  const std::vector<Eigen::Vector3d> rays = camera.rays(pixels);
  ASSERT_EQ(rays.size(), pixels.size());
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    ASSERT_TRUE(rays[i].allFinite()) << pixels[i].transpose();
    EXPECT_EQ(rays[i].z(), 1);
    EXPECT_LT((camera.project(rays[i]) - pixels[i]).norm(), 1e-6) << pixels[i].transpose();
    EXPECT_LT((camera.project(7 * rays[i]) - pixels[i]).norm(), 1e-6);
  }
}

// The other way round, so that a ray on a wrong branch of the model, which projects well too, is noticed.
TEST_P(EveryLens, PixelsComeBackToTheirRays) {
  const CameraCalibration& c = GetParam().calibration;
  const Camera camera(c);
  for (double y = -0.5; y <= 0.5; y += 0.1) {
    for (double x = -0.6; x <= 0.6; x += 0.1) {
      const Eigen::Vector3d direction(x, y, 1);
      const Eigen::Vector2d pixel = camera.project(direction);
      ASSERT_TRUE(pixel.allFinite());
      EXPECT_LT((camera.ray(pixel) - direction).norm(), 1e-8) << x << ' ' << y;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Lenses, EveryLens, testing::ValuesIn(lenses()),
                         [](const testing::TestParamInfo<Lens>& lens) { return lens.param.name; });

TEST(Camera, ProjectsInFrontOnly) {
  for (const Lens& lens : lenses()) {
    const Camera camera(lens.calibration);
    EXPECT_FALSE(camera.project({0.1, 0.1, 0}).allFinite()) << lens.name;
    EXPECT_FALSE(camera.project({0.1, 0.1, -1}).allFinite()) << lens.name;
    EXPECT_FALSE(camera.project({kNan, 0, 1}).allFinite()) << lens.name;
    EXPECT_FALSE(camera.ray({kNan, 0}).allFinite()) << lens.name;
    EXPECT_FALSE(camera.ray({std::numeric_limits<double>::infinity(), 0}).allFinite()) << lens.name;
    const Eigen::Vector2d center = camera.project({0, 0, 3});
    EXPECT_NEAR(center.x(), lens.calibration.cx_px, 1e-12) << lens.name;
    EXPECT_NEAR(center.y(), lens.calibration.cy_px, 1e-12) << lens.name;
  }
}

// r (1 + k1 r^2) with k1 = -0.4 has its largest value 0.6086 at r = 0.9129; beyond, it folds back.
TEST(Camera, PixelsAndDirectionsBeyondAFoldAreNotANumber) {
  for (const double p : {0.0, 1e-3}) {
    CameraCalibration c = calibration(752, 480, 400, "plumb_bob", {-0.4, 0, p, -p});
    c.cx_px = c.cy_px = 0;
    const Camera camera(c);
    EXPECT_TRUE(camera.project({0.91, 0, 1}).allFinite());
    EXPECT_FALSE(camera.project({0.915, 0, 1}).allFinite());
    EXPECT_TRUE(camera.ray({0.60 * 400, 0}).allFinite());
    EXPECT_FALSE(camera.ray({0.62 * 400, 0}).allFinite());
    EXPECT_FALSE(camera.ray({4000, 3000}).allFinite());
    EXPECT_NEAR(camera.ray(camera.project({0.9, 0, 1})).x(), 0.9, 1e-9);
  }
  // The angle a (1 - a^2 / 10) has its largest value at sqrt(10 / 3) > pi / 2: no fold in front of the camera.
  EXPECT_TRUE(Camera(calibration(640, 480, 200, "equidistant", {-0.1, 0, 0, 0})).project({30, 0, 1}).allFinite());
  const Camera fold(calibration(640, 480, 200, "equidistant", {-0.3, 0, 0, 0}));  // at 1.054 rad
  EXPECT_TRUE(fold.project({std::tan(1.05), 0, 1}).allFinite());
  EXPECT_FALSE(fold.project({std::tan(1.06), 0, 1}).allFinite());
}

TEST(Camera, EquidistantPixelsBehindTheImagePlaneAreNotANumber) {
  const Camera camera(calibration(640, 480, 100, "equidistant", {0, 0, 0, 0}));
  const CameraCalibration& c = camera.calibration();
  EXPECT_TRUE(camera.ray({c.cx_px + 100 * 1.57, c.cy_px}).allFinite());
  EXPECT_FALSE(camera.ray({c.cx_px + 100 * 1.58, c.cy_px}).allFinite());
}

TEST(Camera, RectifiedImagesHaveAFrameOfTheirOwn) {
  CameraCalibration c = calibration(640, 480, 500, "none", {});
  c.R_image_cam = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()).toRotationMatrix();
  const Camera camera(c);
  // A direction at angle a of the camera's frame is at angle a + 0.1 of the image's.
  const Eigen::Vector2d pixel = camera.project({std::tan(0.2), 0, 1});
  EXPECT_NEAR(pixel.x(), c.cx_px + c.fx_px * std::tan(0.3), 1e-9);
  EXPECT_NEAR(camera.ray(pixel).x(), std::tan(0.2), 1e-12);
  EXPECT_EQ(camera.ray(pixel).z(), 1);
}

TEST(DistortionModelNames, AreThoseOfCameraInfo) {
  EXPECT_EQ(require_distortion_model("plumb_bob"), "plumb_bob");
  EXPECT_EQ(require_distortion_model("rational_polynomial"), "rational_polynomial");
  EXPECT_EQ(require_distortion_model("equidistant"), "equidistant");
  EXPECT_EQ(require_distortion_model(""), "none");
  EXPECT_EQ(require_distortion_model("none"), "none");
  try {
    require_distortion_model("fov");
    FAIL();
  } catch (const OptionError& error) {
    const std::string text = error.what();
    EXPECT_NE(text.find("\"fov\""), std::string::npos) << text;
    EXPECT_NE(text.find("plumb_bob rational_polynomial equidistant"), std::string::npos) << text;
  }
}

std::string calibration_error(const CameraCalibration& c) {
  try {
    const Camera camera(c);
  } catch (const OptionError& error) {
    return error.what();
  }
  return {};
}

TEST(CameraCalibration, RefusesWhatCannotBe) {
  const CameraCalibration good = calibration(640, 480, 500, "plumb_bob", {0, 0, 0, 0});
  EXPECT_EQ(calibration_error(good), "");
  EXPECT_NE(calibration_error({}), "");
  const auto with = [&](auto change) {
    CameraCalibration c = good;
    change(c);
    return calibration_error(c);
  };
  EXPECT_NE(with([](auto& c) { c.width_px = 0; }).find("width = 0"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.height_px = -1; }).find("height = -1"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.fx_px = 0; }).find("fx = 0"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.fy_px = -500; }).find("fy = -500"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.fx_px = kNan; }).find("fx = nan"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.fy_px = std::numeric_limits<double>::infinity(); }).find("fy = inf"),
            std::string::npos);
  EXPECT_NE(with([](auto& c) { c.cx_px = kNan; }).find("cx"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.cy_px = kNan; }).find("cy"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.coefficients[2] = kNan; }).find("coefficient 3 = nan"), std::string::npos);
  EXPECT_NE(with([](auto& c) { c.R_image_cam *= -1; }).find("camera R has determinant -1"), std::string::npos);
  const auto with_model = [&](const char* model, std::vector<double> coefficients) {
    return with([&](auto& c) {
      c.model = model;
      c.coefficients = std::move(coefficients);
    });
  };
  // Zeros may be missing at the end, and there may be too many.
  for (const char* model : {"plumb_bob", "rational_polynomial", "equidistant", "none"}) {
    for (const std::size_t count : {1u, 3u, 5u, 8u, 12u, 14u}) {
      EXPECT_EQ(with_model(model, std::vector<double>(count, 0)), "") << model << count;
    }
  }
  EXPECT_EQ(with_model("plumb_bob", {0, 0, 0, 0, 0, 0.5}),
            "camera distortion has 6 coefficients, but plumb_bob has 5: number 6 is 0.5, where only zeros are allowed");
  EXPECT_NE(with_model("none", {0.1}), "");
  EXPECT_NE(with_model("fov", {0}).find("\"fov\" is not one of plumb_bob"), std::string::npos);
  EXPECT_NE(with_model("", {}).find("\"\" is not one of plumb_bob"), std::string::npos);
}

TEST(CameraCalibration, EqualityLooksAtEverything) {
  const CameraCalibration a = lenses()[2].calibration;
  EXPECT_EQ(a, a);
  const auto changed = [&](auto change) {
    CameraCalibration b = a;
    change(b);
    return b;
  };
  EXPECT_NE(a, changed([](auto& c) { c.width_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.height_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.fx_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.fy_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.cx_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.cy_px++; }));
  EXPECT_NE(a, changed([](auto& c) { c.coefficients[3] = 0; }));
  EXPECT_NE(a, changed([](auto& c) { c.model = "equidistant"; }));
  EXPECT_NE(a, changed([](auto& c) { c.R_image_cam(0, 1) = 0.01; }));
}

}  // namespace
}  // namespace gyro_deblur::camera_test
