// Errors of the gyroscope, found as a rotation that the residual velocities of many images share.
#pragma once

#include <deque>
#include <optional>

#include <Eigen/Core>

#include "gyro_deblur/camera.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/frame_blur.hpp"
#include "gyro_deblur/rotation_track.hpp"
#include "gyro_deblur/time.hpp"

namespace gyro_deblur {

/// Robust least squares over the blocks, of many over 96 or more that lie regularly. Axes of the camera.
/// @param residuals  of the blocks of `grid`, certain or not
/// @param motion     known motion that was subtracted; its mean over the exposure of the middle row is `known_rad_s`
/// Nothing where fewer than half of these blocks have a residual velocity, or `motion` does not cover that exposure.
std::optional<ResidualRotation> fit_residual_rotation(const ResidualField& residuals, const BlockGrid& grid,
                                                      const Camera& camera, const CameraMotion& motion,
                                                      const RowExposure& exposure);

/// An error of the gyroscope that images have shown.
struct GyroError {
  enum class Kind {
    BIAS,         ///< the same rate whatever the camera does
    EXTRINSIC,    ///< proportional to the rate, across it
    TIME_OFFSET,  ///< proportional to the rate's change
  };
  Kind kind = Kind::BIAS;
  /// BIAS [rad/s]: to be subtracted from the gyroscope's rates. EXTRINSIC [rad]: rotation vector by which the known
  /// rates have to be rotated. In the axes of the rates that were added.
  Eigen::Vector3d vector = Eigen::Vector3d::Zero();
  double time_offset_s = 0;  ///< TIME_OFFSET: to be added to `time_offset`
  double seconds = 0;        ///< for which it has been seen
};

/// Watches the residual rotations of one camera over the last seconds for what lasts. Not thread-safe.
class GyroErrorWatch {
 public:
  /// @param t_ns  increasing; begins anew where it is not, and after a break
  void add(TimeNs t_ns, const ResidualRotation& rotation);
  void clear() { entries_.clear(); }

  /// Nothing unless at least five seconds agree: it has to stand out from how it scatters between their fifths, explain
  /// most of the residual rotation, which has to explain most of the residual velocities, and that better than a
  /// translation does.
  std::optional<GyroError> find() const;

 private:
  struct Entry {
    TimeNs t_ns;
    ResidualRotation rotation;
  };
  std::deque<Entry> entries_;  // of the last seconds
};

}  // namespace gyro_deblur
