// Renders textured planes row by row, each row as the mean over its own poses.
#pragma once

#include <functional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "gyro_deblur/camera.hpp"
#include "sim/motion.hpp"
#include "sim/scene.hpp"
#include "sim/texture.hpp"

namespace gyro_deblur::sim {

class Renderer {
 public:
  /// @param channels 1 (grey) or 3 (BGR)
  Renderer(const Camera& camera, const std::vector<Plane>& planes, double background, int channels);

  /// When a row's light was gathered.
  struct RowPoses {
    Pose middle;                ///< decides the sharpness of the textures
    std::vector<Pose> samples;  ///< at least one; averaged with equal weights
  };

  /// Image of the camera's size, CV_32F with `channels`, grey levels 0 to 255. Rows run on all cores.
  /// @param poses  called once for each row, from any thread
  cv::Mat render(const std::function<RowPoses(int row)>& poses);

  /// World points [m] where a ray (camera frame) meets the planes in front of the camera, nearest first.
  std::vector<Eigen::Vector3d> intersections(const Pose& pose, const Eigen::Vector3d& ray_cam) const;

 private:
  struct Surface {
    Texture texture;
    double width_m, height_m;
    Eigen::Quaterniond R_plane_world;
    Eigen::Vector3d center_m;
  };

  int level_of(const Surface& surface, const Pose& pose, int row) const;
  template <int kChannels>
  void render_row(const std::vector<Pose>& samples, int row, const std::vector<const cv::Mat*>& levels,
                  float* out) const;

  int width_px_, height_px_, channels_;
  float background_;
  std::vector<float> ray_x_, ray_y_;  // (x/z, y/z) of every pixel; NaN beyond the lens model
  std::vector<Surface> surfaces_;
};

}  // namespace gyro_deblur::sim
