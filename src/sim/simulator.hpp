// A simulated camera and IMU with known truth.
#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/image_format.hpp"
#include "gyro_deblur/time.hpp"
#include "sim/motion.hpp"
#include "sim/renderer.hpp"
#include "sim/scene.hpp"

namespace gyro_deblur::sim {

/// One reading of the simulated IMU, stamped in the IMU clock (camera clock + time_offset).
struct ImuSample {
  TimeNs t_ns = 0;
  Eigen::Vector3d rate_rad_s = Eigen::Vector3d::Zero();           ///< body rate, IMU axes
  Eigen::Vector3d specific_force_m_s2 = Eigen::Vector3d::Zero();  ///< acceleration minus gravity, IMU axes
};

struct Frame {
  cv::Mat image;        ///< in the scene's encoding
  TimeNs stamp_ns = 0;  ///< camera clock, by the scene's stamp convention
  ShutterTiming timing;
  int sub_exposures = 0;  ///< averaged for each row
};

/// Truth follows from poses and planes alone; where a pixel sees no plane, the scene is infinitely far. Pixels are
/// those of the (distorted) image. Not thread-safe.
class Simulator {
 public:
  /// Throws OptionError (see Scene::validate).
  explicit Simulator(Scene scene);

  const Scene& scene() const { return scene_; }
  const Camera& camera() const { return camera_; }
  PixelLayout layout() const { return layout_; }
  int frames() const { return scene_.frames; }

  /// Frame i with blur, rolling shutter, noise and rounding. Precondition: 0 <= i < frames().
  Frame frame(int i);
  /// Every row at the middle of its exposure: no blur, no noise, but rolling shutter.
  cv::Mat sharp(int i);
  /// All rows at one instant (camera clock): no blur, no noise, no rolling shutter.
  cv::Mat global_shutter(TimeNs t_ns);

  TimeNs stamp(int i) const;
  RowExposure exposure(int i) const;
  /// Middle of the exposure of the middle row of frame i.
  TimeNs reference_time(int i) const;

  /// Readings over the whole scene at the nominal rate; the first is at scene time 0.
  std::vector<ImuSample> imu() const;

  /// Pose at a time of the camera clock.
  Pose pose(TimeNs t_ns) const;

  /// Displacement [px] from start to end of its row's exposure of the scene point which the pixel sees at the middle of
  /// its row's exposure. NaN where the point leaves the front of the camera.
  Eigen::Vector2d truth_displacement(int i, const Eigen::Vector2d& pixel_px) const;

  /// The same from where the row that the point is in starts to be exposed to where the row that it is in ends: the
  /// blur that a rolling shutter records.
  Eigen::Vector2d recorded_displacement(int i, const Eigen::Vector2d& pixel_px) const;
  /// Pixel, at `reference_ns` (camera clock), of the scene point which the pixel sees at the middle of its row's
  /// exposure.
  Eigen::Vector2d truth_rectified(int i, const Eigen::Vector2d& pixel_px, TimeNs reference_ns) const;

  /// Scene point [m, world] which the pixel sees at the middle of its row's exposure; nothing where there is no plane.
  std::optional<Eigen::Vector3d> scene_point(int i, const Eigen::Vector2d& pixel_px) const;
  /// Pixel at which frame i shows a scene point [m, world] at the middle of that pixel's row's exposure, which need not
  /// lie in the image. NaN for a point behind the camera.
  Eigen::Vector2d pixel_of(int i, const Eigen::Vector3d& point_m) const;

  /// Sub-exposures with which no scene point of frame i moves more than half a pixel between two.
  int sub_exposures(int i) const;

 private:
  double seconds(TimeNs t_ns) const { return to_seconds(t_ns - scene_.start_ns); }
  cv::Mat encode(const cv::Mat& grey_levels, bool with_noise, int frame) const;

  Scene scene_;
  Camera camera_;
  PixelLayout layout_;
  Renderer renderer_;
};

}  // namespace gyro_deblur::sim
