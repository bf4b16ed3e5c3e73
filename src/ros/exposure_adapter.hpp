// Exposure times out of the messages that drivers have.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "gyro_deblur/config.hpp"
#include "ros/message_fields.hpp"

namespace gyro_deblur {

class Processor;

constexpr char kRealsenseMetadata[] = "realsense2_camera/Metadata";

struct ExposureReading {
  TimeNs exposure_ns = 0;
  std::optional<TimeNs> stamp_ns;  ///< of the image it belongs to; absent: it is a setting, and holds until the next
};

/// Reads exposure times by the rule of a configuration (`exposure_source`, `exposure_field`).
/// auto reads gyro_deblur/Exposure, and realsense2_camera/Metadata in the unit of its stream. It leaves out what a
/// colour stream says under auto exposure, see doc/guides/calibration.md. The end of the other rules' names is the
/// unit: us, 10us, 100us, ms or s.
/// - field_UNIT: a number, time or duration anywhere in a message. Its image's stamp is the message's `header.stamp`,
///   else the `stamp` next to the field.
/// - realsense_metadata_UNIT: a number in the JSON of realsense2_camera/Metadata, by default "actual_exposure": in us
///   for infrared streams, in units of 100 us for colour streams, see doc/guides/calibration.md.
/// - dynamic_reconfigure_UNIT: a parameter of dynamic_reconfigure/Config, which a driver's server publishes as
///   parameter_updates.
/// Message packages need not be installed.
class ExposureAdapter {
 public:
  explicit ExposureAdapter(const ExposureSource& source) : source_(source) {}

  /// Precondition: not the message gyro_deblur/Exposure under `auto`, which only pass_on() takes.
  /// @param type, definition  of the connection the message came by
  /// @param bytes, size       the serialised message
  /// @return nothing when the message does not have the exposure time of its image
  /// Throws std::runtime_error that names the type, the field, and what there is instead.
  std::optional<ExposureReading> read(const std::string& type, const std::string& definition, const std::uint8_t* bytes,
                                      std::size_t size);

  /// Reads a message and gives the processor what it says, or why it cannot be read.
  void pass_on(const std::string& type, const std::string& definition, const std::vector<std::uint8_t>& bytes,
               Processor* processor);

 private:
  const MessageLayout& layout_of(const std::string& type, const std::string& definition);
  double seconds(double value) const;
  std::optional<ExposureReading> read_metadata(const std::string& type, const std::string& definition,
                                               const std::uint8_t* bytes, std::size_t size);

  ExposureSource source_;
  std::map<std::string, MessageLayout> layouts_;  // by type
};

}  // namespace gyro_deblur
