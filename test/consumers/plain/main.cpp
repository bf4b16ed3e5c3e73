#include <iostream>

#include <gyro_deblur/calibration.hpp>
#include <gyro_deblur/config.hpp>
#include <gyro_deblur/feature_tracker.hpp>
#include <gyro_deblur/overlay.hpp>

#include "../synthetic_pan.hpp"

#include "../no_foreign_names.hpp"

int main() {
  const SyntheticPan pan = deblur_synthetic_pan();
  std::cout << "error blurred " << pan.error_of(pan.blurred) << ", deblurred " << pan.error_of(pan.result.image)
            << " grey levels\n";
  return pan.is_deblurred() ? 0 : 1;
}
