#include "features/epipolar_check.hpp"

#include <cstddef>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Geometry>

namespace gyro_deblur::epipolar_check_test {
namespace {

constexpr double kFocalPx = 450, kMaxPx = 1;

class EpipolarCheckTest : public testing::Test {
 protected:
  /// Points of a scene that the camera sees, and after it has moved by -translation_m.
  /// @param depth_span_m  0: a wall
  void add_scene(int count, const Eigen::Vector3d& translation_m, double depth_span_m) {
    std::uniform_real_distribution<double> part(-0.5, 0.5);
    std::normal_distribution<double> noise_px(0, 0.1);
    for (int i = 0; i < count; ++i) {
      const Eigen::Vector3d ray(1.4 * part(random_), part(random_), 1);
      const double depth_m = 2 + depth_span_m * (part(random_) + 0.5);
      turned_.push_back(ray);
      seen_.push_back(depth_m * ray + translation_m);
      seen_.back() /= seen_.back().z();
      seen_.back() += Eigen::Vector3d(noise_px(random_), noise_px(random_), 0) / kFocalPx;
    }
  }
  std::vector<char> check() { return agree_with_epipolar_geometry(turned_, seen_, kFocalPx, kMaxPx); }
  static std::ptrdiff_t count(const std::vector<char>& agrees, std::size_t from, std::size_t to) {
    std::ptrdiff_t sum = 0;
    for (std::size_t i = from; i < to; ++i) sum += agrees[i] ? 1 : 0;
    return sum;
  }

  std::mt19937 random_{3};
  std::vector<Eigen::Vector3d> turned_, seen_;
};

TEST_F(EpipolarCheckTest, OneInFourIsWrongAndIsFound) {
  for (const Eigen::Vector3d& translation_m : {Eigen::Vector3d(0.05, 0, 0), {0.02, -0.03, 0.01}, {0, 0, 0.1}}) {
    turned_.clear();
    seen_.clear();
    add_scene(90, translation_m, 3);
    // Across their epipolar lines.
    const std::size_t right = turned_.size();
    add_scene(30, translation_m, 3);
    for (std::size_t i = right; i < turned_.size(); ++i) {
      seen_[i].head<2>() += 6 / kFocalPx * translation_m.cross(turned_[i]).head<2>().normalized();
    }
    const std::vector<char> agrees = check();
    EXPECT_GE(count(agrees, 0, right), 88);
    EXPECT_LE(count(agrees, right, turned_.size()), 3);
  }
}

// With the freedom of a fundamental matrix an object before a wall would be a near part of the scene.
TEST_F(EpipolarCheckTest, AnObjectBeforeAWallThatMovesByItselfIsFound) {
  add_scene(100, {0.01, 0, 0}, 0);
  for (int i = 0; i < 7; ++i) {
    turned_.emplace_back(0.01 * i, 0.02 * i, 1);
    seen_.emplace_back(0.01 * i + 2 / kFocalPx, 0.02 * i + 7 / kFocalPx, 1);
  }
  const std::vector<char> agrees = check();
  EXPECT_GE(count(agrees, 0, 100), 99);
  EXPECT_EQ(count(agrees, 100, 107), 0);
}

TEST_F(EpipolarCheckTest, ALargeObjectThatMovesByItselfIsFound) {
  add_scene(100, {0.03, 0, 0.02}, 3);
  for (int i = 0; i < 30; ++i) {
    turned_.emplace_back(0.02 * (i % 6), 0.02 * (i / 6), 1);
    seen_.emplace_back(turned_.back() + Eigen::Vector3d(2, 7, 0) / kFocalPx);
  }
  const std::vector<char> agrees = check();
  EXPECT_GE(count(agrees, 0, 100), 99);
  EXPECT_EQ(count(agrees, 100, 130), 0);
}

// A gyroscope's bias or a readout time that is a little off leaves one.
TEST_F(EpipolarCheckTest, ASmallErrorOfTheRotationCostsNoPointOfTheScene) {
  for (const Eigen::Vector3d& translation_m : {Eigen::Vector3d(0.05, 0, 0), {0.02, -0.03, 0.01}, {0, 0, 0.1}}) {
    for (const Eigen::Vector3d& error_px : {Eigen::Vector3d(0, 0, 1.5), {2, 0, 0}, {-1, 1.5, 1}}) {
      turned_.clear();
      seen_.clear();
      add_scene(100, translation_m, 3);
      const Eigen::Vector3d error_rad = error_px / kFocalPx;
      for (Eigen::Vector3d& ray : turned_) {
        ray = Eigen::AngleAxisd(error_rad.norm(), error_rad.normalized()).toRotationMatrix() * ray;
      }
      for (std::size_t i = 0; i < 10; ++i) {
        seen_[i].head<2>() += 6 / kFocalPx * translation_m.cross(turned_[i]).head<2>().normalized();
      }
      const std::vector<char> agrees = check();
      EXPECT_LE(count(agrees, 0, 10), 1) << translation_m.transpose() << ", " << error_px.transpose();
      EXPECT_GE(count(agrees, 10, 100), 88) << translation_m.transpose() << ", " << error_px.transpose();
    }
  }
}

TEST_F(EpipolarCheckTest, WithoutTheRotationPointsOfTheSceneAgreeStill) {
  add_scene(100, {0.05, 0.02, 0.03}, 3);
  const Eigen::Matrix3d rotation =
      (Eigen::AngleAxisd(0.15, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  for (Eigen::Vector3d& ray : seen_) ray = rotation * ray;
  for (std::size_t i = 0; i < 10; ++i) seen_[i].head<2>() += Eigen::Vector2d(12, -14) / kFocalPx;
  const std::vector<char> agrees = check();
  EXPECT_LE(count(agrees, 0, 10), 3);
  EXPECT_GE(count(agrees, 10, 100), 85);
}

TEST_F(EpipolarCheckTest, WhatStaysAgreesAndSoDoTooFewPoints) {
  add_scene(100, {0, 0, 0}, 3);
  EXPECT_EQ(count(check(), 0, 100), 100);
  turned_.resize(3);
  seen_ = turned_;
  seen_[1].x() += 0.1;
  EXPECT_EQ(count(check(), 0, 3), 3);
}

}  // namespace
}  // namespace gyro_deblur::epipolar_check_test
