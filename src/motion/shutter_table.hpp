// The parameters of a camera's timing: a row for each member, with key, allowed values and text.
#pragma once

#include "base/parameter_table.hpp"
#include "gyro_deblur/exposure.hpp"

namespace gyro_deblur {

inline Names<StampRow> names_of(StampRow) {
  return {{"first", StampRow::FIRST}, {"middle", StampRow::MIDDLE}, {"last", StampRow::LAST}};
}

inline Names<StampPhase> names_of(StampPhase) {
  return {{"start", StampPhase::START}, {"middle", StampPhase::MIDDLE}, {"end", StampPhase::END}};
}

template <typename V>
void visit(Table<ShutterTiming>, V&& visitor) {
  using O = ShutterTiming;
  visitor.group("camera timing");
  visitor({"exposure_time", above(0, 1, "s"),
           "Exposure time of each row, used for images without an exposure message. '': it is estimated from the blur "
           "of the images."},
          &O::exposure_ns);
  visitor({"readout_time", within(-1, 1, "s"),
           "Number of rows times the time of one row. 0: global shutter. Negative: the bottom row comes first. '': not "
           "known, see self_calibration."},
          &O::readout_ns);
  visitor({"stamp_row", "Image row that the stamp refers to."}, &O::stamp_row);
  visitor({"stamp_phase", "Instant of that row's exposure that the stamp refers to."}, &O::stamp_phase);
}

}  // namespace gyro_deblur
