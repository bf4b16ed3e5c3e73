// Simulates images, their noise, and IMU samples.
#include "sim/simulator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/parallel.hpp"

namespace gyro_deblur::sim {
namespace {

constexpr double kMaxStepPx = 0.5;      // between two sub-exposures
constexpr int kMaxSubExposures = 4096;  // 2000 px of blur; bounds the time when a plane passes through the camera

Scene validated(Scene scene) {
  scene.validate();
  return scene;
}

// Independent seeds for each use of the scene's seed (splitmix64, Steele et al. 2014).
std::uint64_t mix(std::uint64_t a, std::uint64_t b) {
  std::uint64_t z = a + 0x9e3779b97f4a7c15u * (b + 1);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return (z ^ (z >> 31)) | 1u;  // cv::RNG must not start at 0
}

// Channel (BGR) that a Bayer pixel sees.
int bayer_channel(PixelLayout layout, int x, int y) {
  const char* const colors = layout == PixelLayout::BAYER_RGGB   ? "RGGB"
                             : layout == PixelLayout::BAYER_BGGR ? "BGGR"
                             : layout == PixelLayout::BAYER_GBRG ? "GBRG"
                                                                 : "GRBG";
  const char color = colors[(y & 1) * 2 + (x & 1)];
  return color == 'B' ? 0 : color == 'G' ? 1 : 2;
}

// Pixel of what `ray` sees from `from`, seen from `to`; without a point, what it sees is infinitely far.
Eigen::Vector2d transfer(const Camera& camera, const Pose& from, const Eigen::Vector3d& ray,
                         const std::vector<Eigen::Vector3d>& points, const Pose& to) {
  const Eigen::Vector3d direction = points.empty() ? from.R_world_cam * ray : points.front() - to.p_world_m;
  return camera.project(to.R_world_cam.conjugate() * direction);
}

}  // namespace

Simulator::Simulator(Scene scene)
    : scene_(validated(std::move(scene))),
      camera_(scene_.camera.calibration),
      layout_(*layout_of_encoding(scene_.camera.encoding)),
      renderer_(camera_, scene_.planes, scene_.background, layout_ == PixelLayout::GRAY ? 1 : 3) {}

TimeNs Simulator::stamp(int i) const {
  // The stamp for which row 0 starts where it should.
  const RowExposure at_zero(0, scene_.camera.calibration.height_px, scene_.timing(i));
  return scene_.first_row_start(i) - at_zero.start(0);
}

RowExposure Simulator::exposure(int i) const {
  return RowExposure(stamp(i), scene_.camera.calibration.height_px, scene_.timing(i));
}

TimeNs Simulator::reference_time(int i) const { return exposure(i).reference_time(RectifyTo::MIDDLE_ROW); }

Pose Simulator::pose(TimeNs t_ns) const { return scene_.motion->pose(seconds(t_ns)); }

Frame Simulator::frame(int i) {
  Frame frame;
  frame.timing = scene_.timing(i);
  frame.stamp_ns = stamp(i);
  frame.sub_exposures = sub_exposures(i);
  const RowExposure rows = exposure(i);
  const cv::Mat light = renderer_.render([&](int y) {
    Renderer::RowPoses poses;
    poses.middle = pose(rows.middle(y));
    const double start = seconds(rows.start(y)), step = to_seconds(frame.timing.exposure_ns) / frame.sub_exposures;
    poses.samples.reserve(static_cast<std::size_t>(frame.sub_exposures));
    for (int k = 0; k < frame.sub_exposures; ++k)
      poses.samples.push_back(scene_.motion->pose(start + (k + 0.5) * step));
    return poses;
  });
  frame.image = encode(light, true, i);
  return frame;
}

cv::Mat Simulator::sharp(int i) {
  const RowExposure rows = exposure(i);
  return encode(renderer_.render([&](int y) {
    const Pose p = pose(rows.middle(y));
    return Renderer::RowPoses{p, {p}};
  }),
                false, i);
}

cv::Mat Simulator::global_shutter(TimeNs t_ns) {
  const Pose p = pose(t_ns);
  return encode(renderer_.render([&](int) { return Renderer::RowPoses{p, {p}}; }), false, 0);
}

cv::Mat Simulator::encode(const cv::Mat& grey_levels, bool with_noise, int frame) const {
  const bool wide = scene_.camera.encoding == "mono16";
  const bool bayer = is_bayer(layout_);
  const int in_channels = grey_levels.channels(), out_channels = channels_of(layout_);
  const float scale = wide ? 257.0f : 1.0f;
  cv::Mat image(grey_levels.size(), CV_MAKETYPE(wide ? CV_16U : CV_8U, out_channels));
  const int values = image.cols * out_channels;
  const std::uint64_t frame_seed = mix(scene_.seed, static_cast<std::uint64_t>(frame));
  constexpr int kDefaultThreads = 0, kRowsAtATime = 16;
  parallel_for(image.rows, kDefaultThreads, kRowsAtATime, [&](int y) {
    cv::Mat noise = cv::Mat::zeros(1, values, CV_32F);
    if (with_noise && scene_.camera.noise > 0) {
      cv::RNG rng(mix(frame_seed, static_cast<std::uint64_t>(y)));  // a seed a row: the same on any number of threads
      rng.fill(noise, cv::RNG::NORMAL, 0, scene_.camera.noise);
    }
    const float* light = grey_levels.ptr<float>(y);
    for (int k = 0; k < values; ++k) {
      const int x = k / out_channels, c = k % out_channels;
      const int source = bayer ? bayer_channel(layout_, x, y) : layout_ == PixelLayout::RGB ? 2 - c : c;
      const float value = scale * (light[x * in_channels + source] + noise.at<float>(k));
      if (wide) {
        image.ptr<ushort>(y)[k] = cv::saturate_cast<ushort>(value);
      } else {
        image.ptr<uchar>(y)[k] = cv::saturate_cast<uchar>(value);
      }
    }
  });
  return image;
}

std::vector<ImuSample> Simulator::imu() const {
  const ImuModel& model = scene_.imu;
  const Eigen::Matrix3d R_imu_cam = model.R_cam_imu.transpose();
  cv::RNG rng(mix(scene_.seed, ~std::uint64_t{0}));
  const auto white = [&rng](double sigma) {
    Eigen::Vector3d v;
    for (int k = 0; k < 3; ++k) v[k] = sigma > 0 ? rng.gaussian(sigma) : 0;
    return v;
  };
  std::vector<ImuSample> samples;
  const TimeNs end = scene_.end_ns();
  for (int i = 0;; ++i) {
    const TimeNs t = scene_.start_ns + to_ns(i / model.rate_hz);
    if (t > end) break;
    const double s = seconds(t);
    const Eigen::Matrix3d R_imu_world = R_imu_cam * scene_.motion->pose(s).R_world_cam.conjugate().toRotationMatrix();
    ImuSample sample;
    sample.t_ns = t + model.time_offset_ns;
    sample.rate_rad_s = R_imu_cam * scene_.motion->rate(s) + model.gyro_bias_rad_s + white(model.gyro_noise_rad_s);
    if (model.gyro_saturation_rad_s > 0) {
      sample.rate_rad_s =
          sample.rate_rad_s.cwiseMin(model.gyro_saturation_rad_s).cwiseMax(-model.gyro_saturation_rad_s);
    }
    sample.specific_force_m_s2 = R_imu_world * (scene_.motion->acceleration(s) - scene_.gravity_m_s2) +
                                 model.accel_bias_m_s2 + white(model.accel_noise_m_s2);
    samples.push_back(sample);
  }
  return samples;
}

Eigen::Vector2d Simulator::truth_displacement(int i, const Eigen::Vector2d& pixel_px) const {
  const RowExposure rows = exposure(i);
  return truth_rectified(i, pixel_px, rows.end(pixel_px.y())) - truth_rectified(i, pixel_px, rows.start(pixel_px.y()));
}

Eigen::Vector2d Simulator::recorded_displacement(int i, const Eigen::Vector2d& pixel_px) const {
  const RowExposure rows = exposure(i);
  const auto place = [&](TimeNs (RowExposure::*instant_of)(double) const) {
    constexpr int kIterations = 10;  // each leaves a tenth of the error, or less
    Eigen::Vector2d place_px = pixel_px;
    for (int k = 0; k < kIterations && place_px.allFinite(); ++k) {
      place_px = truth_rectified(i, pixel_px, (rows.*instant_of)(place_px.y()));
    }
    return place_px;
  };
  return place(&RowExposure::end) - place(&RowExposure::start);
}

Eigen::Vector2d Simulator::truth_rectified(int i, const Eigen::Vector2d& pixel_px, TimeNs reference_ns) const {
  const Pose middle = pose(exposure(i).middle(pixel_px.y()));
  const Eigen::Vector3d ray = camera_.ray(pixel_px);
  return transfer(camera_, middle, ray, renderer_.intersections(middle, ray), pose(reference_ns));
}

std::optional<Eigen::Vector3d> Simulator::scene_point(int i, const Eigen::Vector2d& pixel_px) const {
  const std::vector<Eigen::Vector3d> points =
      renderer_.intersections(pose(exposure(i).middle(pixel_px.y())), camera_.ray(pixel_px));
  if (points.empty()) return std::nullopt;
  return points.front();
}

Eigen::Vector2d Simulator::pixel_of(int i, const Eigen::Vector3d& point_m) const {
  // The pixel decides the row, the row the time and the time the pixel. That contracts by the image's speed times the
  // readout of one row, which is far below one for any motion that leaves an image.
  constexpr int kMaxIterations = 50;
  constexpr double kConvergedPx = 1e-7;
  const RowExposure rows = exposure(i);
  double y = (scene_.camera.calibration.height_px - 1) / 2.0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  for (int k = 0; k < kMaxIterations; ++k) {
    const Pose p = pose(rows.middle(y));
    pixel = camera_.project(p.R_world_cam.conjugate() * (point_m - p.p_world_m));
    if (!pixel.allFinite() || std::abs(pixel.y() - y) < kConvergedPx) break;
    y = pixel.y();
  }
  return pixel;
}

int Simulator::sub_exposures(int i) const {
  constexpr int kColumns = 9, kRows = 7;  // of a grid over the image, its border included
  constexpr int kSlices = 8;              // of the exposure, in which speed counts as constant
  constexpr double kMargin = 1.1;         // for what grid and slices miss
  const RowExposure rows = exposure(i);
  double longest_px = 0;  // path of one slice
  for (int gy = 0; gy < kRows; ++gy) {
    const double y = (scene_.camera.calibration.height_px - 1.0) * gy / (kRows - 1);
    const double start = seconds(rows.start(y)), slice = to_seconds(rows.timing().exposure_ns) / kSlices;
    std::vector<Pose> poses;
    for (int k = 0; k <= kSlices; ++k) poses.push_back(scene_.motion->pose(start + k * slice));
    const Pose& middle = poses[kSlices / 2];
    for (int gx = 0; gx < kColumns; ++gx) {
      const double x = (scene_.camera.calibration.width_px - 1.0) * gx / (kColumns - 1);
      const Eigen::Vector3d ray = camera_.ray({x, y});
      // Every plane along the ray counts, not only the nearest: edges uncover what is behind.
      std::vector<std::vector<Eigen::Vector3d>> sights = {{}};
      for (const Eigen::Vector3d& point : renderer_.intersections(middle, ray)) sights.push_back({point});
      for (const std::vector<Eigen::Vector3d>& sight : sights) {
        if (sight.empty() && sights.size() > 1) continue;  // background that cannot be seen here
        for (int k = 0; k < kSlices; ++k) {
          const double path_px = (transfer(camera_, middle, ray, sight, poses[static_cast<std::size_t>(k) + 1]) -
                                  transfer(camera_, middle, ray, sight, poses[static_cast<std::size_t>(k)]))
                                     .norm();
          if (path_px > longest_px) longest_px = path_px;  // NaN compares false
        }
      }
    }
  }
  const double count = std::ceil(kMargin * longest_px * kSlices / kMaxStepPx);
  return static_cast<int>(std::clamp(count, 1.0, static_cast<double>(kMaxSubExposures)));
}

}  // namespace gyro_deblur::sim
