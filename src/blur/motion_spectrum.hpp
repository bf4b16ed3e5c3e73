// Power spectra along the motion, of windows of one image.
#pragma once

#include <array>
#include <vector>

#include <opencv2/core.hpp>

#include "gyro_deblur/frame_blur.hpp"

namespace gyro_deblur {

/// Power at one frequency along the motion, divided by what texture usually has there (|f|^-2.5).
struct SpectrumPoint {
  float frequency;     ///< along the motion [waves a window], > 0
  float power;         ///< > 0, noise included
  float noise;         ///< the part of it that noise has in the mean, >= 0
  float log_variance;  ///< of the natural logarithm of `power`, were the texture as usual
  float spread;        ///< within the window, of the path along this frequency: standard deviation over mean
  float tilt;          ///< by which the logarithm of usual texture falls along the motion [1/wave]
};

/// Spectrum of one window in which the blur is that of `path`: of the frequencies whose direction is near one.
struct MotionSpectrum {
  int window;  ///< that it is of; several spectra may be of one
  /// Places at kPathInstants along the motion [windows]: at a frequency of f waves a window the phase of an instant is
  /// 2 pi f path[k].
  std::array<float, kPathInstants> path;
  std::vector<SpectrumPoint> points;  ///< in the order of frequencies
};

/// Side of the windows whose spectra are taken [px, of the image as often halved as suits the blur].
constexpr int kMotionWindow = 128;

/// Spectra of windows all over an image.
/// @param luminance  CV_8UC1 of the field's size
/// @param scale      of the field's paths: windows are chosen for blur of this size
/// @param noise      standard deviation of the luminance's noise [grey levels]
/// @return those whose windows have blur of at least 2 px; a straight path's path is scaled, too
std::vector<MotionSpectrum> motion_spectra(const FrameBlur& field, const cv::Mat& luminance, double scale, double noise,
                                           int threads);

}  // namespace gyro_deblur
