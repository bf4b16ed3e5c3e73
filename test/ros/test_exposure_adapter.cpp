#include "ros/exposure_adapter.hpp"

#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include <dynamic_reconfigure/Config.h>
#include <gtest/gtest.h>
#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <sensor_msgs/Image.h>

#include "driver_messages.hpp"
#include "message_builders.hpp"
#include "ros/messages.hpp"

namespace gyro_deblur::exposure_adapter_test {
namespace {

using namespace test;

constexpr TimeNs kStamp = 100 * kSecond + 5 * kMs;

// wiki.ros.org/image_exposure_msgs.
const std::string kStatistics =
    "ImageExposureStatistics[] exposures\nuint32 underExposed\n"
    "================================================================================\n"
    "MSG: image_exposure_msgs/ImageExposureStatistics\nint32 CONSTANT=3\ntime stamp\nstring time_reference\n"
    "float32 shutterms\nfloat32 gaindb\n";

std::optional<ExposureReading> read(const ExposureSource& source, const std::string& type,
                                    const std::string& definition, const Bytes& bytes) {
  return ExposureAdapter(source).read(type, definition, bytes.data.data(), bytes.data.size());
}

std::string error_of(const ExposureSource& source, const std::string& type, const std::string& definition,
                     const Bytes& bytes) {
  try {
    read(source, type, definition, bytes);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "accepted";
}

using Kind = ExposureSource::Kind;

TEST(ExposureAdapter, ReadsAFieldInTheUnitOfItsName) {
  const Bytes bytes = Bytes()
                          .header(kStamp)
                          .add<std::uint32_t>(2)
                          .add<std::uint32_t>(8000)
                          .add<std::uint32_t>(12000)
                          .add(3.f)
                          .add<std::uint16_t>(1)
                          .add<std::uint16_t>(2);
  const std::string type = "image_exposure_msgs/ExposureSequence";
  const auto second = read({Kind::FIELD, ExposureUnit::MICROSECONDS, "shutter[1]"}, type, kSequence, bytes);
  EXPECT_EQ(second->exposure_ns, 12 * kMs);
  EXPECT_EQ(second->stamp_ns, kStamp);
  EXPECT_EQ(read({Kind::FIELD, ExposureUnit::MILLISECONDS, "gain"}, type, kSequence, bytes)->exposure_ns, 3 * kMs);
  EXPECT_EQ(read({Kind::FIELD, ExposureUnit::SECONDS, "gain"}, type, kSequence, bytes)->exposure_ns, 3 * kSecond);
}

// V4L2's exposure_absolute and the colour stream of RealSense cameras count in 100 us.
TEST(ExposureAdapter, ReadsEveryUnit) {
  constexpr TimeNs kUs = 1000;
  const std::vector<std::pair<ExposureUnit, TimeNs>> units{{ExposureUnit::MICROSECONDS, kUs},
                                                           {ExposureUnit::TEN_MICROSECONDS, 10 * kUs},
                                                           {ExposureUnit::HUNDRED_MICROSECONDS, 100 * kUs},
                                                           {ExposureUnit::MILLISECONDS, kMs},
                                                           {ExposureUnit::SECONDS, kSecond}};
  dynamic_reconfigure::Config setting;
  setting.ints.resize(1);
  setting.ints[0].name = "exposure_absolute";
  setting.ints[0].value = 200;
  Bytes setting_bytes;
  setting_bytes.data.resize(ros::serialization::serializationLength(setting));
  ros::serialization::OStream stream(setting_bytes.data.data(), static_cast<std::uint32_t>(setting_bytes.data.size()));
  ros::serialization::serialize(stream, setting);
  for (const auto& [unit, unit_ns] : units) {
    const auto of_metadata = read({Kind::REALSENSE_METADATA, unit, ""}, "realsense2_camera/Metadata", kMetadata,
                                  metadata(kStamp, R"({"actual_exposure":200})"));
    EXPECT_EQ(of_metadata->exposure_ns, 200 * unit_ns);
    const auto of_setting =
        read({Kind::DYNAMIC_RECONFIGURE, unit, "exposure_absolute"}, "dynamic_reconfigure/Config", "", setting_bytes);
    EXPECT_EQ(of_setting->exposure_ns, 200 * unit_ns);
    const auto of_field = read({Kind::FIELD, unit, "exposure"}, "a/B", "time stamp\nfloat64 exposure\n",
                               Bytes().add<std::uint32_t>(100).add<std::uint32_t>(5'000'000).add(200.0));
    EXPECT_EQ(of_field->exposure_ns, 200 * unit_ns);
    EXPECT_EQ(of_field->stamp_ns, kStamp);
  }
}

TEST(ExposureAdapter, FindsTheStampNextToANestedField) {
  const Bytes bytes = Bytes()
                          .add<std::uint32_t>(2)
                          .add<std::uint32_t>(99)
                          .add<std::uint32_t>(0)
                          .text("clock")
                          .add(4.5f)
                          .add(1.f)
                          .add<std::uint32_t>(100)
                          .add<std::uint32_t>(5'000'000)
                          .text("clock")
                          .add(8.25f)
                          .add(1.f)
                          .add<std::uint32_t>(0);
  const auto reading = read({Kind::FIELD, ExposureUnit::MILLISECONDS, "exposures[1].shutterms"},
                            "image_exposure_msgs/SequenceExposureStatistics", kStatistics, bytes);
  EXPECT_EQ(reading->exposure_ns, 8'250'000);
  EXPECT_EQ(reading->stamp_ns, kStamp);
}

TEST(ExposureAdapter, ReadsDurationsOfTheRealSerialisation) {
  Exposure message;
  message.header.stamp = to_ros_time(kStamp);
  message.exposure_time.fromNSec(17 * kMs);
  Bytes bytes;
  bytes.data.resize(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data.data(), static_cast<std::uint32_t>(bytes.data.size()));
  ros::serialization::serialize(stream, message);
  // A duration has its own unit.
  const auto reading =
      read({Kind::FIELD, ExposureUnit::MICROSECONDS, "exposure_time"}, ros::message_traits::datatype<Exposure>(),
           ros::message_traits::definition<Exposure>(), bytes);
  EXPECT_EQ(reading->exposure_ns, 17 * kMs);
  EXPECT_EQ(reading->stamp_ns, kStamp);
}

TEST(ExposureAdapter, ReadsRealSenseMetadata) {
  const std::string type = "realsense2_camera/Metadata";
  const Bytes bytes =
      metadata(kStamp, R"({"frame_number":12,"actual_exposure":8333,"gain_level":16,"auto_exposure":1})");
  const ExposureSource source{Kind::REALSENSE_METADATA, ExposureUnit::MICROSECONDS, ""};
  const auto reading = read(source, type, kMetadata, bytes);
  EXPECT_EQ(reading->exposure_ns, 8'333'000);
  EXPECT_EQ(reading->stamp_ns, kStamp);
  EXPECT_NE(
      error_of(source, type, kMetadata, metadata(kStamp, R"({"gain_level":16})")).find("no number \"actual_exposure\""),
      std::string::npos);
  EXPECT_NE(error_of(source, type, kMetadata, metadata(kStamp, "no json")).find("no json"), std::string::npos);
  const Bytes other = Bytes().header(kStamp).add<std::uint32_t>(0).add(3.f).add<std::uint16_t>(1).add<std::uint16_t>(2);
  EXPECT_NE(error_of(source, "a/B", kSequence, other).find("a/B has no string json_data; it has header.seq"),
            std::string::npos);
}

TEST(ExposureAdapter, AutoRecognisesMessagesByTheirType) {
  const ExposureSource source;
  ASSERT_EQ(source.kind, Kind::AUTO);
  const std::string type = "realsense2_camera/Metadata";
  const auto of = [&](const std::string& json) { return read(source, type, kMetadata, metadata(kStamp, json)); };
  const auto infrared = of(R"({"actual_exposure":8333,"auto_exposure":1})");
  EXPECT_EQ(infrared->exposure_ns, 8'333'000);
  EXPECT_EQ(infrared->stamp_ns, kStamp);
  EXPECT_EQ(of(R"({"actual_exposure":166,"auto_exposure":0,"saturation":64})")->exposure_ns, 16'600'000);
  EXPECT_FALSE(of(R"({"actual_exposure":166,"auto_exposure":1,"saturation":64})")) << "it is the manual value";

  const std::string error = error_of(source, "a/B", kSequence, Bytes());
  for (const std::string part :
       {"auto recognises gyro_deblur/Exposure and realsense2_camera/Metadata", "a/B", "exposure_source"}) {
    EXPECT_NE(error.find(part), std::string::npos) << error;
  }
}

TEST(ExposureAdapter, ReadsAParameterOfDynamicReconfigure) {
  dynamic_reconfigure::Config config;
  config.doubles.resize(2);
  config.doubles[0].name = "gain";
  config.doubles[0].value = 5;
  config.doubles[1].name = "exposure_ms";
  config.doubles[1].value = 6.5;
  config.ints.resize(1);
  config.ints[0].name = "exposure";
  config.ints[0].value = 9000;
  Bytes bytes;
  bytes.data.resize(ros::serialization::serializationLength(config));
  ros::serialization::OStream stream(bytes.data.data(), static_cast<std::uint32_t>(bytes.data.size()));
  ros::serialization::serialize(stream, config);
  const std::string type = "dynamic_reconfigure/Config";
  const auto of_int = read({Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MICROSECONDS, "exposure"}, type, "", bytes);
  EXPECT_EQ(of_int->exposure_ns, 9 * kMs);
  EXPECT_FALSE(of_int->stamp_ns) << "it holds until the next";
  const ExposureSource ms{Kind::DYNAMIC_RECONFIGURE, ExposureUnit::MILLISECONDS, "exposure_ms"};
  EXPECT_EQ(read(ms, type, "", bytes)->exposure_ns, 6'500'000);
  EXPECT_NE(error_of({Kind::DYNAMIC_RECONFIGURE, ExposureUnit::SECONDS, "shutter"}, type, "", bytes)
                .find("called exposure_field = \"shutter\"; there are gain, exposure_ms, exposure"),
            std::string::npos);
  EXPECT_NE(error_of(ms, "a/B", "", bytes).find("of type a/B, not dynamic_reconfigure/Config"), std::string::npos);
}

TEST(ExposureAdapter, NamesWhatIsNotThere) {
  const Bytes bytes = Bytes().header(kStamp).add<std::uint32_t>(0).add(3.f).add<std::uint16_t>(1).add<std::uint16_t>(2);
  const ExposureSource source{Kind::FIELD, ExposureUnit::MICROSECONDS, "shutter[0]"};
  const std::string type = "image_exposure_msgs/ExposureSequence";
  EXPECT_NE(
      error_of(source, type, kSequence, bytes).find("no number exposure_field = \"shutter[0]\"; it has header.seq"),
      std::string::npos);
  Bytes cut = bytes;
  cut.data.resize(10);
  EXPECT_NE(error_of(source, type, kSequence, cut).find("ends before its definition does"), std::string::npos);
  EXPECT_NE(error_of(source, type, "Other other\n", bytes).find("lacks that of image_exposure_msgs/Other"),
            std::string::npos);
  EXPECT_NE(error_of({Kind::FIELD, ExposureUnit::SECONDS, "header.frame_id"}, type, kSequence, bytes).find("no number"),
            std::string::npos);
}

TEST(ExposureAdapter, AStampThatWasNeverSetIsNone) {
  const Bytes bytes = Bytes().add<std::uint32_t>(0).add<std::uint32_t>(0).add(7000.0);
  const ExposureSource source{Kind::FIELD, ExposureUnit::MICROSECONDS, "exposure"};
  EXPECT_FALSE(read(source, "a/B", "time stamp\nfloat64 exposure\n", bytes)->stamp_ns);
}

TEST(MessageLayout, RefusesDefinitionsThatDoNotEnd) {
  const auto error = [](const std::string& definition) -> std::string {
    try {
      MessageLayout("p/A", definition).find("x", nullptr, 0);
      return "accepted";
    } catch (const std::exception& failure) {
      return failure.what();
    }
  };
  EXPECT_EQ(error("A a\n"), "in the definition of p/A, p/A contains itself");
  EXPECT_EQ(error("B b\nMSG: p/B\nA[] a\n"), "in the definition of p/A, p/A contains itself");
  EXPECT_NE(error("uint8[x] a\n").find("array \"uint8[x] a\" whose length is not a number"), std::string::npos);
  EXPECT_NE(error("uint8[99999999999999999999] a\n").find("is not a number"), std::string::npos);
  std::string doubling = "B0 b\n";
  for (int i = 0; i < 40; ++i) {
    const std::string next = "B" + std::to_string(i + 1);
    doubling += "MSG: p/B" + std::to_string(i) + "\n" + next + " a\n" + next + " b\n";
  }
  EXPECT_NE(error(doubling + "MSG: p/B40\n").find("more than 10000 fields"), std::string::npos);
  EXPECT_EQ(error("Empty[999999999] e\nMSG: p/Empty\n"), "accepted") << "at once";
}

TEST(MessageLayout, SkipsPixels) {
  sensor_msgs::Image image = *image_message(kStamp);
  Bytes bytes;
  bytes.data.resize(ros::serialization::serializationLength(image));
  ros::serialization::OStream stream(bytes.data.data(), static_cast<std::uint32_t>(bytes.data.size()));
  ros::serialization::serialize(stream, image);
  const MessageLayout layout(ros::message_traits::datatype<sensor_msgs::Image>(),
                             ros::message_traits::definition<sensor_msgs::Image>());
  EXPECT_EQ(std::get<double>(*layout.find("width", bytes.data.data(), bytes.data.size())), kWidth);
  EXPECT_EQ(std::get<double>(*layout.find("data[5]", bytes.data.data(), bytes.data.size())), image.data[5]);
  EXPECT_EQ(std::get<std::string>(*layout.find("encoding", bytes.data.data(), bytes.data.size())), "mono8");
  EXPECT_FALSE(layout.find("depth", bytes.data.data(), bytes.data.size()));
}

}  // namespace
}  // namespace gyro_deblur::exposure_adapter_test
