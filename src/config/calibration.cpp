// Loads calibration files, merges them and checks that they agree.
#include "gyro_deblur/calibration.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include <Eigen/Geometry>

#include "base/format.hpp"
#include "base/join.hpp"
#include "config/calibration_formats.hpp"
#include "config/yaml_reading.hpp"
#include "gyro_deblur/exposure.hpp"
#include "gyro_deblur/rotation_track.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void refuse_conflict(const std::string& quantity, const std::string& a, const std::string& name_a,
                                  const std::string& b, const std::string& name_b, const std::string& difference,
                                  const std::string& allowed) {
  throw OptionError(quantity + " is " + a + " in " + name_a + ", but " + b + " in " + name_b + " (they differ by " +
                    difference + ", allowed is " + allowed + ")");
}

}  // namespace

std::string to_string(const CameraCalibration& camera) {
  std::vector<std::string> coefficients;
  for (const double coefficient : camera.coefficients) coefficients.push_back(format("%.10g", coefficient));
  return format("%dx%d px, fx %.10g, fy %.10g, cx %.10g, cy %.10g, ", camera.width_px, camera.height_px, camera.fx_px,
                camera.fy_px, camera.cx_px, camera.cy_px) +
         camera.model + " [" + join(coefficients) + "]";
}

std::string to_string(const Eigen::Matrix3d& matrix) {
  constexpr double kDigits = 1e9;  // rounding leaves neither 2e-16 nor -0
  const Eigen::Matrix3d rounded = ((matrix * kDigits).array().round() / kDigits + 0.0).matrix();
  std::vector<std::string> numbers;
  for (int i = 0; i < 9; ++i) numbers.push_back(format("%g", rounded(i / 3, i % 3)));
  return "[" + join(numbers) + "]";
}

void require_agreement(const CameraCalibration& a, const std::string& name_a, const CameraCalibration& b,
                       const std::string& name_b) {
  constexpr double kAllowedPx = 0.1;
  const auto conflict = [&](const std::string& difference) {
    refuse_conflict("the camera's calibration", to_string(a), name_a, to_string(b), name_b, difference,
                    "0.1 px at one size");
  };
  if (a.width_px != b.width_px || a.height_px != b.height_px) conflict("the size");
  const Camera camera_a(a), camera_b(b);
  // Where neither lens model reaches, they need not agree.
  constexpr int kSteps = 8;
  double largest_px = 0;
  for (int row = 0; row <= kSteps; ++row) {
    for (int col = 0; col <= kSteps; ++col) {
      const Eigen::Vector2d pixel((a.width_px - 1.0) * col / kSteps, (a.height_px - 1.0) * row / kSteps);
      const Eigen::Vector3d ray_a = camera_a.ray(pixel);
      if (!ray_a.allFinite() && !camera_b.ray(pixel).allFinite()) continue;
      const double distance_px = (camera_b.project(ray_a) - pixel).norm();
      // One model reaches this place and the other does not.
      largest_px =
          std::max(largest_px, std::isfinite(distance_px) ? distance_px : std::numeric_limits<double>::infinity());
    }
  }
  if (!(largest_px <= kAllowedPx)) conflict(format("up to %.3g px in the image", largest_px));
}

void require_agreement(const Eigen::Matrix3d& R_cam_imu_a, const std::string& name_a,
                       const Eigen::Matrix3d& R_cam_imu_b, const std::string& name_b) {
  constexpr double kAllowedDeg = 0.1;
  const double angle_deg =
      Eigen::AngleAxisd(Eigen::Matrix3d(R_cam_imu_a.transpose() * R_cam_imu_b)).angle() * 180 / M_PI;
  if (angle_deg <= kAllowedDeg) return;
  refuse_conflict("R_cam_imu", to_string(R_cam_imu_a), name_a, to_string(R_cam_imu_b), name_b,
                  format("%.3g degrees", angle_deg), "0.1 degrees");
}

void require_agreement(const char* quantity, TimeNs a_ns, const std::string& name_a, TimeNs b_ns,
                       const std::string& name_b) {
  constexpr TimeNs kAllowedNs = 1000;
  if (std::abs(a_ns - b_ns) <= kAllowedNs) return;
  const auto text = [](TimeNs t_ns) { return std::to_string(to_seconds(t_ns)) + " s"; };
  refuse_conflict(quantity, text(a_ns), name_a, text(b_ns), name_b, text(std::abs(a_ns - b_ns)), text(kAllowedNs));
}

SensorCalibration load_calibration(const std::string& path, const std::string& camera) {
  const std::string file = fs::is_directory(path) ? (fs::path(path) / camera / "sensor.yaml").string() : path;
  if (!is_camera_name(camera))
    throw OptionError("calibration_camera = \"" + camera + "\" is not one of cam0, cam1, ...");
  SensorCalibration calibration;
  try {
    calibration = read_calibration_file(file, camera);
  } catch (const YAML::Exception& error) {
    throw OptionError(file + ": " + error.what());
  }
  calibration.origin = file;
  if (calibration.readout_ns && calibration.frame_period_ns) {
    require_plausible_readout((file + ": readout").c_str(), *calibration.readout_ns, *calibration.frame_period_ns);
  }
  return calibration;
}

SensorCalibration merge_calibrations(const std::vector<SensorCalibration>& sources) {
  SensorCalibration merged;
  // Which source said what, for conflicts.
  const auto take = [](auto& target, std::string& from, const auto& value, const std::string& origin,
                       const auto& compare) {
    if (!value) return;
    if (!target) {
      target = value;
      from = origin;
    } else {
      compare(*target, from, *value, origin);
    }
  };
  std::string camera, rotation, position, offset, readout, period;
  for (const SensorCalibration& source : sources) {
    merged.notes.insert(merged.notes.end(), source.notes.begin(), source.notes.end());
    merged.origin += (merged.origin.empty() ? "" : " and ") + source.origin;
    const auto same = [](const auto& a, const auto& name_a, const auto& b, const auto& name_b) {
      require_agreement(a, name_a, b, name_b);
    };
    const auto same_time = [](const char* quantity) {
      return [quantity](TimeNs a, const std::string& name_a, TimeNs b, const std::string& name_b) {
        require_agreement(quantity, a, name_a, b, name_b);
      };
    };
    take(merged.camera, camera, source.camera, source.origin, same);
    take(merged.R_cam_imu, rotation, source.R_cam_imu, source.origin, same);
    // Deblurring takes no notice of where the camera sits, so that a difference does no harm.
    take(merged.p_imu_cam_m, position, source.p_imu_cam_m, source.origin, [](const auto&...) {});
    take(merged.time_offset_ns, offset, source.time_offset_ns, source.origin, same_time("time_offset"));
    take(merged.readout_ns, readout, source.readout_ns, source.origin, same_time("readout_time"));
    take(merged.frame_period_ns, period, source.frame_period_ns, source.origin, same_time("the frame period"));
  }
  if (merged.readout_ns && merged.frame_period_ns) {
    require_plausible_readout((readout + ": readout").c_str(), *merged.readout_ns, *merged.frame_period_ns);
  }
  return merged;
}

}  // namespace gyro_deblur
