// Makes the tables that the SIMD kernels of validation by likelihood read.
#include "blur/spectrum_simd.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

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

/// Exponent of the power of textures: between the 2 that is usual for photographs (D. J. Field, J. Opt. Soc. Am. A 4
/// (12), 1987) and the 3 of blurred edges.
constexpr double kTextureExponent = -2.5;
constexpr int kLeastSquared = 4;  // of the frequencies used [waves a window]

SpectrumOrder make_order() {
  struct Frequency {
    int x, y;
    double angle_rad, log_size;
  };
  // Sectors begin half a sector above the horizontal: edges along the axes are frequent, and belong to one.
  constexpr double kBegin = -CV_PI / 2 / kSpectrumSectors;
  std::vector<Frequency> frequencies;
  double mean = 0;
  for (int x = 0; x < kSpectrumWaves; ++x) {
    for (int y = x > 0 ? 1 - kSpectrumWaves : 0; y < kSpectrumWaves; ++y) {
      if (x * x + y * y < kLeastSquared) continue;
      const double angle_rad = std::atan2(y, x);
      frequencies.push_back({x, y, angle_rad < kBegin ? angle_rad + CV_PI : angle_rad, std::log(std::hypot(x, y))});
      mean += frequencies.back().log_size;
    }
  }
  mean /= static_cast<double>(frequencies.size());
  std::stable_sort(frequencies.begin(), frequencies.end(),
                   [](const Frequency& a, const Frequency& b) { return a.angle_rad < b.angle_rad; });
  SpectrumOrder order{};
  for (std::size_t i = 0; i < frequencies.size(); ++i) {
    const Frequency& f = frequencies[i];
    const std::size_t sector = i * kSpectrumSectors / frequencies.size();
    const std::size_t first = (sector * frequencies.size() + kSpectrumSectors - 1) / kSpectrumSectors;
    const std::size_t place = (i - first) * kSpectrumSectors + sector;
    CV_Assert(place < kSpectrumPlaces);
    order.at[place] = (f.y < 0 ? kSpectrumSize / 2 : 0) + std::abs(f.y) * kSpectrumWaves + f.x;
    order.across[place] = static_cast<float>(f.x);
    order.down[place] = static_cast<float>(f.y);
    order.texture[place] = static_cast<float>(std::exp(kTextureExponent * f.log_size));
    order.log_frequency[place] = static_cast<float>(f.log_size - mean);
  }
  return order;
}

}  // namespace

const SpectrumTables& spectrum_tables() {
  static const SpectrumTables kTables = make_tables();
  return kTables;
}

const SpectrumOrder& spectrum_order() {
  static const SpectrumOrder kOrder = make_order();
  return kOrder;
}

}  // namespace gyro_deblur
