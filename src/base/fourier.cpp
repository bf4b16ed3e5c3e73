// Chooses the tile size of a Fourier transform and makes the tables that all transforms of a size share.
#include "base/fourier.hpp"

#include <cmath>

namespace gyro_deblur {
namespace {

/// Radices of the stages, those of many operations an element first; empty: there are other factors.
std::vector<int> radices_of(int size, int largest_radix) {
  std::vector<int> radices;
  for (const int radix : {5, 3, 8, 4, 2}) {
    // Two stages of 4 compute less than one of 8 and one of 2.
    while (size % radix == 0 && !(radix == 8 && (largest_radix < 8 || size == 16))) {
      radices.push_back(radix);
      size /= radix;
    }
  }
  return size == 1 ? radices : std::vector<int>();
}

}  // namespace

int fourier_size(int length) {
  int size = (length + kFourierStep - 1) / kFourierStep * kFourierStep;
  while (radices_of(size, 8).empty()) size += kFourierStep;
  return size;
}

FourierPlan::FourierPlan(int size, int largest_radix)
    : size_(size), radices_(radices_of(size, largest_radix)), places_(size) {
  const double pi = std::acos(-1.0);
  int length = size;
  for (const int radix : radices_) {
    const int part = length / radix;
    for (int j = 1; j < part; ++j) {
      for (int q = 1; q < radix; ++q) {
        const double angle_rad = -2 * pi * j * q / length;
        twiddles_.push_back(static_cast<float>(std::cos(angle_rad)));
        twiddles_.push_back(static_cast<float>(std::sin(angle_rad)));
      }
    }
    length = part;
  }
  for (int k = 0; k < size; ++k) {
    int rest = k, place = 0, part = size;
    for (const int radix : radices_) {
      part /= radix;
      place += rest % radix * part;
      rest /= radix;
    }
    places_[k] = place;
  }
}

FourierStages FourierPlan::stages() const {
  const float* twiddles_end = twiddles_.data() + twiddles_.size();
  return {size_, static_cast<int>(radices_.size()), radices_.data(), twiddles_.data(), twiddles_end, places_.data()};
}

}  // namespace gyro_deblur
