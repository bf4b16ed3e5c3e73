// How wrong the displacement of blocks is that the gyroscope tells, and with what the images tell besides.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <opencv2/imgproc.hpp>

#include "features/residual_flow.hpp"
#include "gyro_deblur/options.hpp"
#include "room_flight.hpp"
#include "sim/simulator.hpp"

namespace gyro_deblur {
namespace {

double percentile(std::vector<double> v, double part) {
  if (v.empty()) return NAN;
  const auto at = v.begin() + static_cast<std::ptrdiff_t>(part * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), at, v.end());
  return *at;
}

struct Case {
  test::RecordedFlight flight;
  double exposure_s, readout_s, speed, contrast, noise;
};

void run(const Case& c, double seconds, const ResidualFlowOptions& options) {
  sim::Scene scene = test::room_flight_scene(c.flight, GYRO_DEBLUR_DATA_DIR, seconds, c.speed);
  scene.camera.calibration.width_px = 752;
  scene.camera.calibration.height_px = 480;
  scene.camera.calibration.fx_px = scene.camera.calibration.fy_px = 460;
  scene.camera.calibration.cx_px = 375.5;
  scene.camera.calibration.cy_px = 239.5;
  scene.camera.exposures_ns = {to_ns(c.exposure_s)};
  scene.camera.readout_ns = to_ns(c.readout_s);
  scene.camera.noise = c.noise;
  for (sim::Plane& plane : scene.planes) {
    plane.texture.convertTo(plane.texture, -1, c.contrast, 128 * (1 - c.contrast) * 0.7);
  }
  sim::Simulator simulator(scene);
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& s : simulator.imu()) samples.push_back({s.t_ns, s.rate_rad_s});
  GyroOptions gyro;
  const RotationTrack rotation(samples, gyro, scene.imu.R_cam_imu);
  ResidualFlow flow(options);
  const BlockGrid grid(752, 480, 64);
  std::vector<double> of_gyro, of_flow, of_carried, of_gated, normalised, corners;
  double ms = 0;
  ResidualField before;
  for (int i = 0; i < simulator.frames(); ++i) {
    const sim::Frame frame = simulator.frame(i);
    const RowExposure exposure = simulator.exposure(i);
    const auto begin = std::chrono::steady_clock::now();
    const ResidualField velocities = flow.follow(frame.image, simulator.camera(), rotation, exposure, grid);
    ms += std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
    if (i < 2) {
      before = velocities;
      continue;
    }
    corners.push_back(static_cast<double>(flow.samples().size()));
    for (int b = 0; b < grid.size(); ++b) {
      const Eigen::Vector2d center = grid.center(b), truth = simulator.truth_displacement(i, center);
      const double y = center.y();
      const Eigen::Vector3d ray = simulator.camera().ray(center);
      const auto place = [&](TimeNs t) {
        return simulator.camera().project(rotation.homography(exposure.middle(y), t) * ray);
      };
      const Eigen::Vector2d by_gyro = place(exposure.end(y)) - place(exposure.start(y));
      if (!truth.allFinite() || !by_gyro.allFinite()) continue;
      of_gyro.push_back((by_gyro - truth).norm());
      Eigen::Vector2d add = Eigen::Vector2d::Zero(), carried = add, gated = add;
      if (!velocities.empty() && velocities[b]) {
        carried = add = velocities[b]->velocity_px_s * c.exposure_s;
        if (false) carried += 0.5 * (velocities[b]->velocity_px_s - before[b]->velocity_px_s) * c.exposure_s;
        if (velocities[b]->velocity_px_s.norm() > 3.5 * velocities[b]->stddev_px_s && add.norm() > .2) gated = add;
        normalised.push_back((by_gyro + add - truth).norm() / (1.18 * velocities[b]->stddev_px_s * c.exposure_s));
      }
      of_flow.push_back((by_gyro + add - truth).norm());
      of_carried.push_back((by_gyro + carried - truth).norm());
      of_gated.push_back((by_gyro + gated - truth).norm());
    }
    before = velocities;
  }
  const auto row = [&](const std::vector<double>& v) {
    std::printf(" %5.2f %5.2f %5.2f |", percentile(v, 0.5), percentile(v, 0.75), percentile(v, 0.9));
  };
  std::printf("%-13s %2.0f ms, %2.0f ms, x%.1f, %.2f/%.0f |", c.flight.name, 1e3 * c.exposure_s, 1e3 * c.readout_s,
              c.speed, c.contrast, c.noise);
  row(of_gyro), row(of_flow), row(of_carried), row(of_gated);
  std::printf(" norm. %.2f %.2f | corners %.0f | %.1f ms\n", percentile(normalised, 0.5), percentile(normalised, 0.9),
              percentile(corners, 0.5), ms / simulator.frames());
  std::fflush(stdout);
}

int main_of(int argc, char** argv) {
  double seconds = 4;
  bool all = false;
  ResidualFlowOptions options;
  CLI::App app{"", "motion_from_images"};
  app.add_option("--seconds", seconds);
  app.add_flag("--all", all);
  app.add_option("--corners", options.max_corners);
  app.add_option("--distance", options.min_distance_px);
  app.add_option("--width", options.largest_width_px);
  app.add_option("--iterations", options.iterations);
  app.add_option("--round-trip", options.max_round_trip_px);
  app.add_option("--window", options.window_px);
  app.add_option("--plane", options.iterations_of_plane);
  app.add_option("--slope", options.slope_prior);
  app.add_option("--levels", options.levels);
  app.add_option("--neighbours", options.neighbours);
  CLI11_PARSE(app, argc, argv);
  for (const auto& flight : test::recorded_flights()) {
    run({flight, 0.030, 0, 1, 1, 2}, seconds, options);
    if (all) {
      run({flight, 0.015, 0, 1, 1, 2}, seconds, options);
      run({flight, 0.030, 0.020, 1, 1, 2}, seconds, options);
      run({flight, 0.030, 0, 1, 0.35, 4}, seconds, options);
      run({flight, 0.030, 0, 1.7, 1, 2}, seconds, options);
    }
  }
  return 0;
}

}  // namespace
}  // namespace gyro_deblur

int main(int argc, char** argv) { return gyro_deblur::main_of(argc, argv); }
