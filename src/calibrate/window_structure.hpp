// Translation of the camera in a window, and the points' depths.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "calibrate/timing_model.hpp"

namespace gyro_deblur {

/// Lengths are in units of the mean depth of the window's points: images alone do not give the scale.
struct WindowStructure {
  Eigen::VectorXd positions;       ///< of the camera in the frames after the first: 3 each, axes of the first
  Eigen::VectorXd inverse_depths;  ///< of the anchors, around 1
};

/// What residuals are weighed against.
struct StructurePriors {
  double noise_px = 1;     ///< > 0: standard deviation of a coordinate of a sighting
  double speed_per_s = 1;  ///< > 0: of the camera, each axis, in depths a second
};

/// Normal equations of the timing after everything else was eliminated.
struct ReducedEquations {
  Eigen::MatrixXd H;
  Eigen::VectorXd gradient;
};

/// One window, with rays that the gyroscope's rotation has moved.
class WindowFit {
 public:
  /// Keeps references to camera and points.
  /// @param frames_s  see TimingModel::frame_times_s
  WindowFit(const Camera& camera, const WindowPoints& points, std::vector<Eigen::Vector3d> rotated_rays,
            std::vector<Passage> passages, Eigen::VectorXd frames_s);

  const std::vector<Eigen::Vector3d>& rotated_rays() const { return rotated_rays_; }

  /// A camera that only rotates.
  WindowStructure at_rest() const;

  /// Found less predicted [px], one for each sighting; NaN where the prediction is behind the camera.
  std::vector<Eigen::Vector2d> residuals(const WindowStructure& structure) const;

  /// Cauchy's loss of the residuals and the priors, as squares of pixels.
  double cost(const WindowStructure& structure, const StructurePriors& priors) const;

  /// Moves the structure to the least cost (Levenberg-Marquardt) and returns that.
  double improve(WindowStructure* structure, const StructurePriors& priors) const;

  /// @param derivatives  of the rotated rays by each value of the timing, one 3 x values matrix a sighting
  ReducedEquations reduce(const WindowStructure& structure, const StructurePriors& priors,
                          const std::vector<Eigen::Matrix3Xd>& derivatives) const;

  /// Sum of squares of the speeds [1/s^2], each axis, and of how many the images determine.
  /// @return of how many depths they do
  double add_speeds(const WindowStructure& structure, const StructurePriors& priors, double* squares,
                    double* count) const;

 private:
  struct Equations;
  Eigen::Vector3d ray(std::size_t sighting, const WindowStructure& structure) const;
  Eigen::Vector3d displacement(std::size_t sighting, const WindowStructure& structure) const;
  Equations linearise(const WindowStructure& structure, const StructurePriors& priors,
                      const std::vector<Eigen::Matrix3Xd>* derivatives) const;

  const Camera& camera_;
  const WindowPoints& points_;
  std::vector<Eigen::Vector3d> rotated_rays_;
  std::vector<Passage> passages_;
  Eigen::VectorXd frames_s_;
};

}  // namespace gyro_deblur
