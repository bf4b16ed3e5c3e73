// Lenses whose rays are first put on a sphere or an ellipsoid: fisheyes and mirrors.
#pragma once

#include <memory>
#include <vector>

#include "motion/lens_models.hpp"

namespace gyro_deblur {

/// Double sphere: xi in [-1, 1], alpha in [0, 1] (Usenko, Demmel, Cremers: The Double Sphere Camera Model, 3DV 2018).
std::unique_ptr<const LensModel> make_double_sphere(const std::vector<double>& coefficients);

/// Extended unified camera model: alpha in [0, 1], beta > 0 (Khomutenko, Garcia, Martinet, RA-L 2016; its valid range
/// as in Usenko et al.).
std::unique_ptr<const LensModel> make_extended_unified(const std::vector<double>& coefficients);

/// Unified model with distortion: xi >= 0, k1 k2 p1 p2 (Mei, Rives: Single View Point Omnidirectional Camera
/// Calibration from Planar Grids, ICRA 2007).
std::unique_ptr<const LensModel> make_mei(const std::vector<double>& coefficients);

}  // namespace gyro_deblur
