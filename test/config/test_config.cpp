#include "gyro_deblur/config.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>
#include <string>

#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include "other_value.hpp"
#include "parameter_documents.hpp"

namespace gyro_deblur::config_test {
namespace {

constexpr TimeNs kMs = 1'000'000;

Config parse(const std::string& yaml, std::vector<std::string>* unknown = nullptr) {
  return parse_config(yaml, unknown);
}

/// The text of the OptionError for a configuration; empty when it is accepted.
std::string error_of(const std::string& yaml) {
  try {
    parse(yaml);
  } catch (const OptionError& error) {
    return error.what();
  }
  return {};
}

/// Every field of a configuration, so that two can be compared and their difference read.
std::string dump(const Config& config) {
  std::string text;
  for_each_parameter(config, [&text](const Row& row, const auto& value) {
    text += std::string(row.key) + ": " + test::to_yaml(value) + "\n";
  });
  return text;
}

/// Every key with a value that is allowed and not the default.
std::vector<std::pair<std::string, std::string>> other_values() {
  std::vector<std::pair<std::string, std::string>> values;
  for_each_parameter(Config(), [&values](const Row& row, const auto& value) {
    if (row.change == Change::NEVER) return;
    values.emplace_back(row.key, test::to_yaml(test::other_value(row, value)));
  });
  return values;
}

TEST(ParseConfig, NothingGivesTheDefaults) {
  EXPECT_EQ(dump(parse("")), dump(Config{}));
  EXPECT_EQ(dump(parse("{}")), dump(Config{}));
}

TEST(ParseConfig, EveryKeyReachesItsOwnField) {
  std::set<std::string> dumps{dump(Config{})};
  for (const auto& [key, value] : other_values()) {
    if (key == "calibration_file") continue;  // see test_calibration.cpp
    const std::string context = key == "exposure_source" ? "exposure_field: shutter\n" : "";
    std::vector<std::string> unknown;
    EXPECT_TRUE(dumps.insert(dump(parse(context + key + ": " + value, &unknown))).second) << key << " changed nothing";
    EXPECT_TRUE(unknown.empty()) << key;
  }
}

TEST(ParseConfig, ReadsValuesInTheirUnits) {
  const std::string yaml = R"(
exposure_time: 0.02
readout_time: -0.0244944
stamp_row: last
stamp_phase: end
time_offset: -0.017552
rectified_input: true
R_cam_imu: [0, -1, 0, -1, 0, 0, 0, 0, -1]
gyro_bias: [-0.002, 0.021, 0.078]
max_gyro_gap: 0.02
gyro_range: 34.9066
input_timeout: 0
frame_queue_size: 3
rectify_to: stamp
engine: float
threads: 2
significant_bits: 12
block_size: 32
min_extent: 4
max_extent: 100.5
curved_path_threshold: 2.5
optical_flow: false
noise_to_signal_ratio: 1e-3
regularization: paper
validation: gradient
keypoint_detector: ORB
keypoint_descriptor: BRISK
max_keypoints: 500
keypoint_grid: 6
)";
  const Config c = parse(yaml);
  EXPECT_EQ(c.shutter.exposure_ns, 20 * kMs);
  EXPECT_EQ(c.shutter.readout_ns, -24'494'400);
  EXPECT_EQ(c.shutter.stamp_row, StampRow::LAST);
  EXPECT_EQ(c.shutter.stamp_phase, StampPhase::END);
  EXPECT_EQ(c.gyro.time_offset_ns, -17'552'000);
  EXPECT_TRUE(c.rectified_input);
  ASSERT_TRUE(c.R_cam_imu);
  EXPECT_EQ((*c.R_cam_imu)(0, 1), -1);
  EXPECT_EQ((*c.R_cam_imu)(2, 2), -1);
  EXPECT_EQ(c.gyro.bias_rad_s, Eigen::Vector3d(-0.002, 0.021, 0.078));
  EXPECT_EQ(c.gyro.max_gap_ns, 20 * kMs);
  EXPECT_DOUBLE_EQ(c.gyro.range_rad_s, 34.9066);
  EXPECT_EQ(c.input_timeout_ns, 0);
  EXPECT_EQ(c.frame_queue_size, 3);
  EXPECT_EQ(c.pipeline.rectify_to, RectifyTo::STAMP);
  EXPECT_EQ(c.pipeline.engine, "float");
  EXPECT_EQ(c.pipeline.threads, 2);
  EXPECT_EQ(c.pipeline.significant_bits, 12);
  EXPECT_EQ(c.pipeline.blur_field.block_size_px, 32);
  EXPECT_EQ(c.pipeline.blur_field.min_extent_px, 4);
  EXPECT_EQ(c.pipeline.blur_field.max_extent_px, 100.5);
  EXPECT_EQ(c.pipeline.blur_field.curved_path_threshold_px, 2.5);
  EXPECT_FALSE(c.pipeline.optical_flow);
  EXPECT_EQ(parse("flow_without_gyro: always").pipeline.flow_without_gyro, "always");
  EXPECT_EQ(error_of("{flow_without_gyro: always, optical_flow: false}"),
            "flow_without_gyro = \"always\" needs optical_flow = true, which is false: set optical_flow to true, or "
            "flow_without_gyro to absent or never");
  EXPECT_EQ(error_of("optical_flow: false"), "") << "nothing is asked for that needs it";
  EXPECT_EQ(c.pipeline.filter.noise_to_signal_ratio, 1e-3);
  EXPECT_EQ(c.pipeline.filter.regularization, Regularization::PAPER);
  EXPECT_EQ(c.pipeline.validation.rule, ValidationRule::GRADIENT);
  EXPECT_EQ(c.pipeline.keypoints.detector, "ORB");
  EXPECT_EQ(c.pipeline.keypoints.descriptor, "BRISK");
  EXPECT_EQ(c.pipeline.keypoints.max_keypoints, 500);
  EXPECT_EQ(c.pipeline.keypoints.grid, 6);
}

TEST(ParseConfig, TheExtrinsicMayBeNestedOrAbsent) {
  const Config nested = parse("R_cam_imu: [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]");
  EXPECT_EQ(*nested.R_cam_imu, *parse("R_cam_imu: [0, -1, 0, -1, 0, 0, 0, 0, -1]").R_cam_imu);
  EXPECT_EQ((*parse("R_cam_imu: [0, 0, 1, 1, 0, 0, 0, 1, 0]").R_cam_imu)(0, 2), 1);  // row by row
  EXPECT_FALSE(parse("R_cam_imu: []").R_cam_imu);
  EXPECT_FALSE(parse("R_cam_imu: ''").R_cam_imu);
}

std::string given(const std::string& yaml) {
  const GivenNumbers numbers = parse(yaml).given;
  return std::string(numbers.time_offset ? "o" : "-") + (numbers.readout_time ? "r" : "-") +
         (numbers.gyro_bias ? "b" : "-");
}

TEST(ParseConfig, DistinguishesZeroFromNothing) {
  EXPECT_EQ(given(""), "---");
  EXPECT_EQ(given("{noise_to_signal_ratio: 0.1}"), "---");
  EXPECT_EQ(given("{time_offset: 0, readout_time: 0.0, gyro_bias: [0, 0, 0]}"), "orb");
  EXPECT_EQ(given("{time_offset: '', readout_time: , gyro_bias: []}"), "---");
  EXPECT_EQ(given("{time_offset: '', readout_time: 0.02, gyro_bias: ''}"), "-r-");
  EXPECT_EQ(given("time_offset: -0.01"), "o--");
  const Config empty = parse("{time_offset: '', readout_time: '', gyro_bias: ''}");
  EXPECT_EQ(dump(empty), dump(Config{})) << "what is not known is 0";
  EXPECT_NE(error_of("time_offset: x"), "");
  EXPECT_NE(error_of("exposure_max_age: ''"), "") << "others cannot be empty";
  const GivenNumbers in_code = Config().given;
  EXPECT_TRUE(in_code.time_offset && in_code.readout_time && in_code.gyro_bias);
}

TEST(ParseConfig, EnumerationsTakeEveryName) {
  EXPECT_EQ(parse("stamp_row: first").shutter.stamp_row, StampRow::FIRST);
  EXPECT_EQ(parse("stamp_row: middle").shutter.stamp_row, StampRow::MIDDLE);
  EXPECT_EQ(parse("stamp_phase: start").shutter.stamp_phase, StampPhase::START);
  EXPECT_EQ(parse("stamp_phase: middle").shutter.stamp_phase, StampPhase::MIDDLE);
  EXPECT_EQ(parse("validation: likelihood").pipeline.validation.rule, ValidationRule::LIKELIHOOD);
  EXPECT_EQ(parse("validation: none").pipeline.validation.rule, ValidationRule::NONE);
  EXPECT_EQ(parse("regularization: adaptive").pipeline.filter.regularization, Regularization::ADAPTIVE);
  EXPECT_EQ(parse("regularization: fixed").pipeline.filter.regularization, Regularization::FIXED);
  EXPECT_EQ(parse("rectify_to: middle_row").pipeline.rectify_to, RectifyTo::MIDDLE_ROW);
  EXPECT_EQ(parse("rectify_to: first_row").pipeline.rectify_to, RectifyTo::FIRST_ROW);
  EXPECT_EQ(parse("rectify_to: last_row").pipeline.rectify_to, RectifyTo::LAST_ROW);
}

TEST(ParseConfig, ReportsKeysItDoesNotKnow) {
  std::vector<std::string> unknown{"before"};
  parse("{gama: 0.1, noise_to_signal_ratio: 0.1, exposure: 3}", &unknown);
  EXPECT_EQ(unknown, (std::vector<std::string>{"before", "gama", "exposure"}));
  EXPECT_NO_THROW(parse("gama: 0.1"));
  EXPECT_EQ(unknown_key_message("gama"), "gama is not known, ignored");
}

TEST(ParseConfig, NamesTheValuesOfConstants) {
  const std::vector<std::pair<std::string, std::string>> constants{
      {"tau", "6 grey levels / px"}, {"tau_contrast", "200 grey levels"}, {"validation_false_accept_rate", "0.1"},
      {"filter_length_factor", "4"}, {"gyro_buffer_duration", "5 s"},     {"time_jump_threshold", "0.5 s"},
      {"track_border", "32 px"},     {"track_max_epipolar", "1 px"},      {"track_window", "21 px"},
  };
  for (const auto& [key, value] : constants) {
    std::vector<std::string> unknown;
    EXPECT_EQ(dump(parse(key + ": 7", &unknown)), dump(Config{})) << key << " changed something";
    EXPECT_EQ(unknown, std::vector<std::string>{key});
    EXPECT_EQ(unknown_key_message(key).rfind(key + " is a constant, ignored: it is " + value + ". ", 0), 0u)
        << unknown_key_message(key);
  }
}

// rosparam's YAML 1.1 makes a string of 2e-2 and of y, and a launch file's <param> makes one of a list.
TEST(ParseConfig, TakesStringsThatAreEntirelyValues) {
  EXPECT_EQ(parse("exposure_time: \"2e-2\"").shutter.exposure_ns, 20 * kMs);
  EXPECT_EQ(parse("noise_to_signal_ratio: \"0.01\"").pipeline.filter.noise_to_signal_ratio, 0.01);
  for (const char* integer : {"1e2", "\"1e2\"", "100.0", "\"100\""}) {
    EXPECT_EQ(parse(std::string("frame_queue_size: ") + integer).frame_queue_size, 100) << integer;
  }
  for (const char* off : {"false", "\"false\"", "\"no\"", "\"n\"", "\"off\"", "\"False\""}) {
    EXPECT_FALSE(parse(std::string("optical_flow: ") + off).pipeline.optical_flow) << off;
  }
  EXPECT_TRUE(parse("drop_poor: \"y\"").drop_poor);
  EXPECT_EQ(parse("max_extent: 100").pipeline.blur_field.max_extent_px, 100) << "an integer for a double";
  const Eigen::Vector3d bias(-0.002, 0.021, 0.078);
  EXPECT_EQ(parse("gyro_bias: [\"-2e-3\", \"0.021\", 0.078]").gyro.bias_rad_s, bias);
  EXPECT_EQ(parse("gyro_bias: \"[-2e-3, 0.021, 0.078]\"").gyro.bias_rad_s, bias);
  EXPECT_EQ((*parse("R_cam_imu: \"[0, -1, 0, -1, 0, 0, 0, 0, -1]\"").R_cam_imu)(0, 1), -1);
  EXPECT_FALSE(parse("R_cam_imu: \"[]\"").R_cam_imu);
}

// 0 is what configurations had before.
TEST(ParseConfig, AnEmptyExposureTimeIsNotKnown) {
  for (const char* empty : {"", "''", "\"\"", "~", "[]", "0", "0.0"}) {
    EXPECT_EQ(parse(std::string("exposure_time: ") + empty).shutter.exposure_ns, 0) << empty;
  }
  EXPECT_EQ(error_of("input_timeout: ''").rfind("input_timeout = \"\" is not a finite number of seconds", 0), 0u);
}

TEST(ParseConfig, RefusesWrongTypesByKeyAndValue) {
  const auto expect = [](const std::string& yaml, const std::string& start) {
    EXPECT_EQ(error_of(yaml).rfind(start, 0), 0u) << yaml << "\n" << error_of(yaml);
  };
  expect("noise_to_signal_ratio: low", "noise_to_signal_ratio = low is not a finite number");
  expect("noise_to_signal_ratio: .nan", "noise_to_signal_ratio = .nan is not a finite number");
  expect("noise_to_signal_ratio: .inf", "noise_to_signal_ratio = .inf is not a finite number");
  expect("noise_to_signal_ratio: \"0.01 px\"", "noise_to_signal_ratio = \"0.01 px\" is not a finite number");
  expect("noise_to_signal_ratio: \"\"", "noise_to_signal_ratio = \"\" is not a finite number");
  expect("block_size: \"64.5\"", "block_size = \"64.5\" is not an integer");
  expect("drop_poor: \"1\"", "drop_poor = \"1\" is not true or false");
  expect("gyro_bias: \"[0, 0]\"", "gyro_bias = [0, 0] is not a list of 3 finite numbers");
  expect("gyro_bias: \"[0, 0\"", "gyro_bias = \"[0, 0\" is not a list of 3 finite numbers");
  expect("noise_to_signal_ratio: [0.01]", "noise_to_signal_ratio = [0.01] is not a finite number");
  expect("noise_to_signal_ratio:", "noise_to_signal_ratio = ~ is not a finite number");
  expect("exposure_time: 20ms", "exposure_time = 20ms is not a finite number of seconds");
  expect("exposure_time: .nan", "exposure_time = .nan is not a finite number of seconds");
  expect("exposure_time: 1e300", "exposure_time = 1e+300 is outside");
  expect("block_size: 64.5", "block_size = 64.5 is not an integer");
  expect("block_size: 99999999999", "block_size = 99999999999 is not an integer");
  expect("drop_poor: 1", "drop_poor = 1 is not true or false");
  expect("validation: off", "validation = off is not one of likelihood gradient none");
  expect("validation: false", "validation = false is not one of likelihood gradient none");
  expect("keypoint_detector: [SIFT]", "keypoint_detector = [SIFT] is not a string");
  expect("keypoint_detector: SURF", "keypoint_detector = \"SURF\" is not one of SIFT ORB");
  expect("stamp_row: top", "stamp_row = top is not one of first middle last");
  expect("calibration_file: {path: a}", "calibration_file = {path: a} is not a path or a list of paths");
  expect("on_calibration_conflict: warn", "on_calibration_conflict = warn is not one of error configured");
  expect("exposure_time: 20", "exposure_time = 20 is outside [1e-09, 1] s: is it in milliseconds?");
  expect("exposure_time: 20000", "exposure_time = 20000 is outside [1e-09, 1] s: is it in microseconds?");
  expect("readout_time: 25", "readout_time = 25 is outside [-1, 1] s: is it in milliseconds?");
  expect("exposure_source: field",
         "exposure_source = field is not one of auto message field_us field_10us field_100us field_ms field_s");
  expect("exposure_source: field_us", "exposure_field = \"\" is not the name of a field");
  expect("exposure_max_age: 61", "exposure_max_age = 61 is outside [0, 60] s");
  expect("stamp_phase: 0", "stamp_phase = 0 is not one of start middle end");
  expect("rectify_to: [stamp]", "rectify_to = [stamp] is not one of middle_row first_row last_row stamp");
  expect("gyro_bias: 0", "gyro_bias = 0 is not a list of 3 finite numbers");
  expect("gyro_bias: [0, 0]", "gyro_bias = [0, 0] is not a list of 3 finite numbers");
  expect("gyro_bias: [0, 0, .nan]", "gyro_bias = .nan is not a list of 3 finite numbers");
  expect("R_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0]", "R_cam_imu = [1, 0, 0, 0, 1, 0, 0, 0] is not a rotation as 9 numbers");
  expect("R_cam_imu: [[1, 0, 0], [0, 1, 0], [0, 0]]", "R_cam_imu = [[1, 0, 0], [0, 1, 0], [0, 0]] is not a rotation");
  expect("R_cam_imu: [1, 0, 0]", "R_cam_imu = [1, 0, 0] is not a rotation");
  expect("R_cam_imu: identity", "R_cam_imu = identity is not a rotation");
  expect("R_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, x]", "R_cam_imu = x is not a rotation");
  expect("R_cam_imu: [1, 0, 0, 0, 1, 0, 0, 0, -1]", "R_cam_imu has determinant -1: it mirrors");
  expect("[1, 2]", "the configuration is not a map of keys: [1, 2]");
  expect("noise_to_signal_ratio", "the configuration is not a map of keys: noise_to_signal_ratio");
  expect("{noise_to_signal_ratio: 0.1, noise_to_signal_ratio: 0.2}",
         "noise_to_signal_ratio = 0.2 is given a second time");
  expect("noise_to_signal_ratio: [1, 2", "the configuration is not YAML: ");
}

TEST(SetParameter, SetsOneKeyAndChecksItAlone) {
  Config config;
  set_parameter("min_extent", "20", &config);
  set_parameter("max_extent", "\"3e0\"", &config);  // less than min_extent
  EXPECT_EQ(config.pipeline.blur_field.min_extent_px, 20);
  EXPECT_EQ(config.pipeline.blur_field.max_extent_px, 3);
  set_parameter("block_size", "32.0", &config);
  EXPECT_EQ(config.pipeline.blur_field.block_size_px, 32);
  set_parameter("drop_poor", "\"y\"", &config);
  EXPECT_TRUE(config.drop_poor);
  set_parameter("validation", "\"gradient\"", &config);
  EXPECT_EQ(config.pipeline.validation.rule, ValidationRule::GRADIENT);
  const std::string before = dump(config);
  set_parameter("gama", "7", &config);
  EXPECT_EQ(dump(config), before);
  const std::pair<const char*, const char*> refused[] = {
      {"block_size", "64.5"},  {"block_size", "1e10"},           {"block_size", "\"y\""}, {"block_size", "true"},
      {"drop_poor", "3"},      {"drop_poor", "\"5e0\""},         {"max_extent", "501"},   {"validation", "nonsense"},
      {"max_extent", "\"y\""}, {"keypoint_detector", "nonsense"}};
  for (const auto& [key, value] : refused) {
    Config changed = config;
    EXPECT_THROW(set_parameter(key, value, &changed), OptionError) << key << ' ' << value;
  }
  EXPECT_EQ(dump(config), before);
}

TEST(ParseConfig, RefusesValuesOutOfRange) {
  struct Limits {
    const char* key;
    std::vector<const char*> inside, outside;
  };
  const std::vector<Limits> limits{
      {"exposure_time", {"0", "1e-9", "1"}, {"-0.001", "1.001"}},
      {"readout_time", {"-1", "1"}, {"-1.001", "1.001"}},
      {"time_offset", {"-4e9", "4e9"}, {"-4000000001", "4000000001"}},
      {"max_gyro_gap", {"0.001", "1"}, {"0.0009", "1.001"}},
      {"gyro_range", {"0", "400"}, {"-0.001", "2000"}},
      {"input_timeout", {"0", "10"}, {"-0.001", "10.001"}},
      {"frame_queue_size", {"1", "1000"}, {"0", "1001"}},
      {"threads", {"0", "256"}, {"-1", "257"}},
      {"keypoint_grid", {"1", "64"}, {"0", "65"}},
      {"gyro_bias", {"[1, -1, 0]"}, {"[1.001, 0, 0]", "[0, 0, -1.001]"}},
  };
  for (const Limits& limit : limits) {
    const std::string key = limit.key;
    for (const char* value : limit.inside) EXPECT_EQ(error_of(key + ": " + value), "") << key;
    for (const char* value : limit.outside) {
      EXPECT_EQ(error_of(key + ": " + value).rfind(key + " = ", 0), 0u) << key << ": " << value;
    }
  }
}

TEST(DefaultYaml, HasEveryKeyAndTheDefaults) {
  const std::string path = GYRO_DEBLUR_SOURCE_DIR "/config/default.yaml";
  std::vector<std::string> unknown;
  EXPECT_EQ(dump(load_config(path, &unknown)), dump(Config{}));
  EXPECT_TRUE(unknown.empty()) << unknown.front();
  const YAML::Node node = YAML::LoadFile(path);
  EXPECT_EQ(node.size(), other_values().size());
  for (const auto& entry : other_values()) EXPECT_TRUE(node[entry.first]) << entry.first;
}

/// One parameter of cfg/Deblur.cfg as YAML scalars; min and max are empty for those without.
struct Reconfigurable {
  std::string name, type, value, min, max;
};

std::vector<Reconfigurable> reconfigurable_parameters() {
  std::ifstream file(GYRO_DEBLUR_SOURCE_DIR "/cfg/Deblur.cfg");
  std::stringstream text;
  text << file.rdbuf();
  const std::string content = text.str();
  const std::regex call(
      R"re(\.add\(\s*"(\w+)",\s*(\w+),\s*\d+,\s*"[^"]*",\s*([^,)=]+)(?:,\s*([^,)=]+),\s*([^,)=]+))?(?:,\s*edit_method=\w+)?\))re");
  std::vector<Reconfigurable> result;
  for (std::sregex_iterator match(content.begin(), content.end(), call), end; match != end; ++match) {
    std::string value = (*match)[3];
    value.erase(std::remove(value.begin(), value.end(), '"'), value.end());
    if (value == "True") value = "true";
    if (value == "False") value = "false";
    result.push_back({(*match)[1], (*match)[2], value, (*match)[4], (*match)[5]});
  }
  const std::regex any_call(R"(\.add\()");
  const auto calls = std::distance(std::sregex_iterator(content.begin(), content.end(), any_call), {});
  EXPECT_EQ(static_cast<std::ptrdiff_t>(result.size()), calls) << "a parameter of Deblur.cfg was not understood";
  return result;
}

// What dynamic_reconfigure offers is what is accepted.
TEST(DeblurCfg, RepeatsDefaultsAndRanges) {
  const auto parameters = reconfigurable_parameters();
  ASSERT_GE(parameters.size(), 12u);
  for (const Reconfigurable& p : parameters) {
    std::vector<std::string> unknown;
    EXPECT_EQ(dump(parse(p.name + ": " + p.value, &unknown)), dump(Config{})) << p.name << " has another default";
    EXPECT_TRUE(unknown.empty()) << p.name << " is not a key of the configuration";
    if (p.min.empty()) {
      EXPECT_TRUE(p.type == "bool_t" || p.type == "str_t") << p.name << " has no range";
      continue;
    }
    // The least extent bounds the largest from below: as low as it may be.
    const std::string context = p.name == "max_extent" ? "min_extent: 1\n" : "";
    const auto accepts = [&](const std::string& value) { return error_of(context + p.name + ": " + value).empty(); };
    EXPECT_TRUE(accepts(p.min)) << p.name << " " << p.min;
    EXPECT_TRUE(accepts(p.max)) << p.name << " " << p.max;
    const auto beyond = [&](const std::string& bound, int direction) {
      const double value = std::stod(bound);
      const double step = p.type == "int_t" ? 1 : std::max(1e-9, std::abs(value) * 1e-6);
      char text[64];
      std::snprintf(text, sizeof(text), "%.15g", value + direction * step);
      return std::string(text);
    };
    EXPECT_FALSE(accepts(beyond(p.min, -1))) << p.name << " " << beyond(p.min, -1);
    EXPECT_FALSE(accepts(beyond(p.max, +1))) << p.name << " " << beyond(p.max, +1);
  }
}

TEST(LoadConfig, NamesTheFileThatCannotBeUsed) {
  const auto message = [](const std::string& path) -> std::string {
    try {
      load_config(path);
    } catch (const OptionError& error) {
      return error.what();
    }
    return {};
  };
  EXPECT_NE(message("/nonexistent/a.yaml").find("/nonexistent/a.yaml cannot be read"), std::string::npos);
  const std::string path = testing::TempDir() + "gyro_deblur_test_config.yaml";
  std::ofstream(path) << "noise_to_signal_ratio: [1, 2\n";
  EXPECT_NE(message(path).find(path + " cannot be read"), std::string::npos);
  std::ofstream(path) << "noise_to_signal_ratio: 7\n";
  EXPECT_EQ(message(path), "configuration " + path + ": noise_to_signal_ratio = 7 is outside [1e-05, 1]");
  std::ofstream(path) << "noise_to_signal_ratio: 0.5\n";
  EXPECT_EQ(load_config(path).pipeline.filter.noise_to_signal_ratio, 0.5);
  std::remove(path.c_str());
}

}  // namespace
}  // namespace gyro_deblur::config_test
