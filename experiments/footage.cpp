#include "footage.hpp"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <utility>

#include "base/median.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "image_pairs.hpp"

namespace gyro_deblur::experiments {
namespace {

constexpr double kFull16 = 257;  // of a grey level in 16 bits
constexpr int kGrey = 120;

/// Another motion without its translation, and without its rotation, too.
class HeldMotion : public sim::Motion {
 public:
  HeldMotion(std::shared_ptr<const Motion> motion, bool rotates) : motion_(std::move(motion)), rotates_(rotates) {}
  sim::Span span() const override { return motion_->span(); }
  sim::Pose pose(double t_s) const override {
    const sim::Pose first = motion_->pose(0);
    return rotates_ ? sim::Pose{motion_->pose(t_s).R_world_cam, first.p_world_m} : first;
  }
  Eigen::Vector3d rate(double t_s) const override {
    return rotates_ ? motion_->rate(t_s) : Eigen::Vector3d(Eigen::Vector3d::Zero());
  }
  Eigen::Vector3d acceleration(double) const override { return Eigen::Vector3d::Zero(); }

 private:
  std::shared_ptr<const Motion> motion_;
  bool rotates_;
};

cv::Mat checkered(const cv::Size& size_px, double width_m) {
  constexpr double kSquareM = 0.2;
  constexpr int kDark = 60, kBright = 190;
  const double square_px = kSquareM * size_px.width / width_m;
  cv::Mat texture(size_px, CV_8UC1);
  for (int y = 0; y < texture.rows; ++y) {
    for (int x = 0; x < texture.cols; ++x) {
      const bool odd = (static_cast<int>(x / square_px) + static_cast<int>(y / square_px)) % 2 != 0;
      texture.at<uchar>(y, x) = static_cast<uchar>(odd ? kDark : kBright);
    }
  }
  return texture;
}

/// Each photograph stretched over much the same share of the wall.
cv::Mat papered(const cv::Size& size_px, const sim::Plane& plane, const std::vector<ImagePair>& photographs,
                std::size_t first) {
  constexpr double kWidthM = 3, kHeightM = 2.25;
  return photo_wall(size_px, std::max(1, cvRound(plane.width_m / kWidthM)),
                    std::max(1, cvRound(plane.height_m / kHeightM)), photographs, first);
}

void paint(Walls walls, std::size_t first_photograph, const std::string& data, std::vector<sim::Plane>* planes) {
  std::string source;
  const std::vector<ImagePair> photographs = load_pairs(data, source);
  constexpr std::size_t kFromWallToWall = 3;  // photographs: has no divisor in common with their number
  for (std::size_t i = 0; i < planes->size(); ++i) {
    sim::Plane& plane = (*planes)[i];
    const cv::Size size_px = plane.texture.size();
    // Left are the floor and one wall.
    if (walls == Walls::PLAIN && i != 0 && i != 4) {
      plane.texture = cv::Mat(size_px, CV_8UC1, cv::Scalar(kGrey));
    } else if (walls == Walls::CHECKERED) {
      plane.texture = checkered(size_px, plane.width_m);
    } else {
      plane.texture = papered(size_px, plane, photographs, first_photograph + kFromWallToWall * i);
    }
  }
}

sim::Scene scene_of(const FootageCase& c, const std::string& data, double seconds) {
  sim::Scene scene = test::room_flight_scene(c.flight, data, seconds, c.speed);
  CameraCalibration& calibration = scene.camera.calibration;
  calibration.width_px = 752;
  calibration.height_px = 480;
  calibration.fx_px = calibration.fy_px = 460;
  calibration.cx_px = 375.5;
  calibration.cy_px = 239.5;
  scene.camera.exposures_ns = c.exposures_ns.empty() ? std::vector<TimeNs>{c.exposure_ns} : c.exposures_ns;
  scene.camera.readout_ns = c.readout_ns;
  scene.camera.encoding = "mono16";
  scene.imu.gyro_noise_rad_s = 0.003;
  scene.imu.accel_noise_m_s2 = 0.05;
  scene.imu.accel_bias_m_s2 = {0.1, -0.1, 0.1};
  scene.imu.R_cam_imu = c.flight.R_cam_imu;
  scene.gravity_m_s2 = {0, 0, -9.80665};  // up is z where motion is captured
  if (c.path != CameraPath::FLIGHT) {
    scene.motion = std::make_shared<HeldMotion>(scene.motion, c.path == CameraPath::ROTATING);
  }
  paint(c.walls, c.first_photograph, data, &scene.planes);
  return scene;
}

}  // namespace

cv::Mat lit(const cv::Mat& wide, const Light& light, std::uint64_t seed) {
  // Less contrast about a level somewhat darker than the middle.
  constexpr double kLevel = 90;
  cv::Mat image, noise(wide.size(), CV_32F);
  wide.convertTo(image, CV_32F, light.contrast / kFull16, kLevel * (1 - light.contrast));
  cv::RNG rng(seed);
  rng.fill(noise, cv::RNG::NORMAL, 0, light.noise);
  image += noise;
  image.convertTo(image, CV_8U);
  return image;
}

std::string FootageCase::conditions() const {
  char text[100];
  std::snprintf(text, sizeof(text), "%.0f ms", 1e3 * to_seconds(exposure_ns));
  std::string conditions = text;
  if (readout_ns != 0) {
    std::snprintf(text, sizeof(text), ", readout %.0f ms", 1e3 * to_seconds(readout_ns));
    conditions += text;
  }
  if (speed != 1) {
    std::snprintf(text, sizeof(text), ", x%.1f", speed);
    conditions += text;
  }
  return conditions;
}

Footage::Footage(const FootageCase& footage_case, const std::string& data, double seconds)
    : simulator_(scene_of(footage_case, data, seconds)) {
  for (int i = 0; i < simulator_.frames(); ++i) frames_.push_back(simulator_.frame(i).image);
}

cv::Mat Footage::sharp(int i, const Light& light) {
  constexpr std::uint64_t kOther = 1'000'000;
  return lit(simulator_.sharp(i), light, static_cast<std::uint64_t>(i) + kOther);
}

Eigen::Vector3d Footage::p_imu_cam_m() { return {-0.05, -0.05, 0}; }

std::vector<sim::ImuSample> Footage::imu(std::uint64_t seed) const {
  const Eigen::Vector3d lever_m = -p_imu_cam_m();
  sim::Scene scene = simulator_.scene();
  scene.seed = seed;
  const std::vector<sim::ImuSample> at_camera = sim::Simulator(scene).imu();
  std::vector<sim::ImuSample> samples;
  for (std::size_t i = 1; i + 1 < at_camera.size(); ++i) {
    sim::ImuSample& sample = samples.emplace_back(at_camera[i]);
    const Eigen::Vector3d rotation_rad_s2 = (at_camera[i + 1].rate_rad_s - at_camera[i - 1].rate_rad_s) /
                                            to_seconds(at_camera[i + 1].t_ns - at_camera[i - 1].t_ns);
    sample.specific_force_m_s2 +=
        rotation_rad_s2.cross(lever_m) + sample.rate_rad_s.cross(sample.rate_rad_s.cross(lever_m));
  }
  return samples;
}

RotationTrack Footage::rotation(double bias_rad_s, bool with_accelerometer) const {
  std::vector<GyroSample> samples;
  for (const sim::ImuSample& reading : imu(simulator_.scene().seed)) {
    GyroSample& sample =
        samples.emplace_back(GyroSample{reading.t_ns, reading.rate_rad_s + Eigen::Vector3d::Constant(bias_rad_s)});
    if (with_accelerometer) sample.specific_force_m_s2 = reading.specific_force_m_s2;
  }
  return RotationTrack(samples, GyroOptions{}, simulator_.scene().imu.R_cam_imu);
}

Eigen::Vector2d Footage::displacement_at_depth(int i, const Eigen::Vector2d& pixel_px, double depth_m) const {
  const RowExposure rows = exposure(i);
  const sim::Pose middle = simulator_.pose(rows.middle(pixel_px.y()));
  const Eigen::Vector3d ray = camera().ray(pixel_px);
  const Eigen::Vector3d point_m = middle.p_world_m + middle.R_world_cam * (depth_m / ray.z() * ray);
  const auto place_px = [&](TimeNs t_ns) {
    const sim::Pose pose = simulator_.pose(t_ns);
    return camera().project(pose.R_world_cam.conjugate() * (point_m - pose.p_world_m));
  };
  return place_px(rows.end(pixel_px.y())) - place_px(rows.start(pixel_px.y()));
}

double Footage::median_depth_m(int i, const BlockGrid& grid) const {
  const sim::Pose pose = simulator_.pose(simulator_.reference_time(i));
  std::vector<double> depths_m;
  for (int b = 0; b < grid.size(); ++b) {
    const auto point_m = simulator_.scene_point(i, grid.center(b));
    if (point_m) depths_m.push_back((pose.R_world_cam.conjugate() * (*point_m - pose.p_world_m)).z());
  }
  return median(depths_m);
}

}  // namespace gyro_deblur::experiments
