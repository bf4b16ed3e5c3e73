// Makes the tables that the SIMD kernels of validation by likelihood read.
#include "blur/spectrum_simd.hpp"

#include <cmath>

#include <opencv2/core.hpp>

namespace gyro_deblur {
namespace {

SpectrumTables make_tables() {
  // Of Hann's window along one axis: the mean of cos^4 is 3/8.
  const double scale = 1 / std::sqrt(kSpectrumWindow * 3.0 / 8);
  SpectrumTables tables;
  for (int j = 0; j < kSpectrumWindow / 2; ++j) {
    const double phase = 2 * CV_PI * (j + 0.5) / kSpectrumWindow;  // from the middle, of one wave
    const double window = scale * (1 + std::cos(phase)) / 2;
    for (int k = 0; k < kSpectrumWaves; ++k) {
      tables.cosine[j][k] = tables.cosine_of_wave[k][j] = static_cast<float>(window * std::cos(k * phase));
      tables.sine[j][k] = tables.sine_of_wave[k][j] = static_cast<float>(window * std::sin(k * phase));
    }
  }
  return tables;
}

}  // namespace

const SpectrumTables& spectrum_tables() {
  static const SpectrumTables kTables = make_tables();
  return kTables;
}

}  // namespace gyro_deblur
