// The table of parameters: complete, and what its documents say. test_config.cpp has the keys one by one.
#include "config/parameters.hpp"

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <regex>
#include <set>
#include <string>
#include <type_traits>

#include <gtest/gtest.h>

#include "parameter_documents.hpp"

namespace gyro_deblur::parameters_test {
namespace {

/// Parameters and constants.
std::vector<const Parameter*> all_rows() {
  std::vector<const Parameter*> rows;
  for (const ParameterGroup& group : parameter_groups()) {
    for (const Parameter& parameter : group.parameters) rows.push_back(&parameter);
  }
  for (const Parameter& constant : constants()) rows.push_back(&constant);
  return rows;
}

/// A value of the row's type that is not the default.
Value other_value(const Parameter& p) {
  struct Other {
    const Parameter& p;
    Value operator()(bool value) const { return !value; }
    Value operator()(int) const { return static_cast<int>(p.limits->max); }
    Value operator()(double) const { return p.limits->max; }
    Value operator()(TimeNs) const { return to_ns(p.limits->max); }
    Value operator()(const std::string&) const { return p.choices.empty() ? std::string("other") : p.choices.back(); }
    Value operator()(const Choice&) const { return Choice{p.choices.back()}; }
    Value operator()(const std::vector<std::string>&) const { return std::vector<std::string>{"a", "b"}; }
    Value operator()(const Eigen::Vector3d&) const { return Value(std::in_place_type<Eigen::Vector3d>, 0.1, 0.2, 0.3); }
    Value operator()(const std::optional<Eigen::Matrix3d>&) const {
      return std::optional<Eigen::Matrix3d>(Eigen::Matrix3d::Identity());
    }
  };
  return std::visit(Other{p}, p.standard());
}

TEST(Parameters, RowsAreComplete) {
  std::set<std::string> keys;
  for (const ParameterGroup& group : parameter_groups()) {
    EXPECT_FALSE(group.name.empty());
    for (const Parameter& p : group.parameters) {
      SCOPED_TRACE(p.key);
      EXPECT_EQ(find_parameter(p.key), &p);
      EXPECT_EQ(find_constant(p.key), nullptr);
    }
  }
  for (const Parameter& p : constants()) {
    SCOPED_TRACE(p.key);
    EXPECT_EQ(find_constant(p.key), &p);
    EXPECT_EQ(find_parameter(p.key), nullptr);
    EXPECT_EQ(p.change, Change::AT_START);
  }
  for (const Parameter* row : all_rows()) {
    const Parameter& p = *row;
    SCOPED_TRACE(p.key);
    EXPECT_TRUE(keys.insert(p.key).second) << "a second time";
    EXPECT_TRUE(std::regex_match(p.key, std::regex("[A-Za-z][A-Za-z0-9_]*")));
    EXPECT_TRUE(std::regex_match(p.text, std::regex("[^\"\\n]*[^\"\\n ]\\."))) << p.text;
    const Value value = p.standard();
    const bool is_time = std::holds_alternative<TimeNs>(value);
    const bool is_number = std::holds_alternative<int>(value) || std::holds_alternative<double>(value) || is_time ||
                           std::holds_alternative<Eigen::Vector3d>(value);
    EXPECT_EQ(p.limits.has_value(), is_number);
    if (p.limits) {
      EXPECT_LT(p.limits->min, p.limits->max);
    }
    if (is_time) {
      EXPECT_STREQ(p.limits->unit, "s");
    }
    if (std::holds_alternative<Choice>(value)) {
      EXPECT_GE(p.choices.size(), 2u);
    }
    // An exposure of 0 is one that is not known.
    if (p.key != "exposure_time") {
      EXPECT_NO_THROW(p.check(value));
    }
    EXPECT_NO_THROW(p.check(other_value(p)));
  }
  EXPECT_EQ(find_parameter("gama"), nullptr);
}

TEST(Parameters, EachSetsItsOwnMember) {
  for (const Parameter* p : all_rows()) {
    SCOPED_TRACE(p->key);
    const Value value = other_value(*p);
    ASSERT_FALSE(value == p->standard());
    Config config;
    p->set(config, value);
    EXPECT_TRUE(p->get(config) == value);
    for (const Parameter* other : all_rows()) {
      if (other != p) {
        EXPECT_TRUE(other->get(config) == other->standard()) << other->key;
      }
    }
  }
}

template <typename... Members>
std::size_t count(const Members&...) {
  return sizeof...(Members);
}

// The lists do not compile when a member is added or removed. As each row sets a member of its own, equal numbers mean
// that none is left out.
TEST(Parameters, EveryMemberHasARow) {
  {
    const auto& [a, b, c, d] = BlurFieldOptions();
    EXPECT_EQ(parameters_of<BlurFieldOptions>().size(), count(a, b, c, d));
  }
  {
    const auto& [a, b, c, d] = ValidationOptions();
    EXPECT_EQ(parameters_of<ValidationOptions>().size(), count(a, b, c, d));
  }
  {
    const auto& [a, b, c, d] = FilterOptions();
    EXPECT_EQ(parameters_of<FilterOptions>().size(), count(a, b, c, d));
  }
  {
    const auto& [a, b] = NoiseModel();
    EXPECT_EQ(parameters_of<NoiseModel>().size(), count(a, b));
  }
  {
    const auto& [a, b, c, d] = KeypointOptions();
    EXPECT_EQ(parameters_of<KeypointOptions>().size(), count(a, b, c, d));
  }
  {
    const auto& [a, b, c, d, e, f, g] = TrackerOptions();
    EXPECT_EQ(parameters_of<TrackerOptions>().size(), count(a, b, c, d, e, f, g));
  }
  {
    const auto& [a, b, c, d, e] = GyroOptions();
    EXPECT_EQ(parameters_of<GyroOptions>().size(), count(a, b, c, d, e));
  }
  {
    const auto& [a, b, c, d] = ShutterTiming();
    EXPECT_EQ(parameters_of<ShutterTiming>().size(), count(a, b, c, d));
  }
  {
    const auto& [kind, unit, field] = ExposureSource();
    EXPECT_EQ(parameters_of<ExposureSource>().size(), count(field)) << "kind and unit are exposure_source";
    EXPECT_EQ(count(kind, unit), 2u);
  }
  {
    const auto& [blur_field, validation, kernel, noise, keypoints, a, b, c, d, e, f, g] = PipelineOptions();
    EXPECT_EQ(parameters_of<PipelineOptions>().size(), count(a, b, c, d, e, f, g));
    EXPECT_EQ(count(blur_field, validation, kernel, noise, keypoints), 5u);
  }
  {
    const auto& [pipeline, gyro, shutter, a, b, c, d, e, given, f, tracker, g, h, calibration, i, j, k, l, m, n, o, p,
                 q] = Config();
    EXPECT_EQ(parameters_of<Config>().size(), count(a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q));
    EXPECT_EQ(count(pipeline, gyro, shutter, given, tracker, calibration), 6u);
  }
}

/// Checks that two options compare as different when one member of one of them is changed.
template <typename Options>
void expect_comparison_sees_every_row(Options PipelineOptions::*part) {
  EXPECT_TRUE(Options() == Options());
  for (const Parameter* p : parameters_of<Options>()) {
    Config config;
    p->set(config, other_value(*p));
    EXPECT_FALSE(config.pipeline.*part == Options()) << p->key;
  }
}

TEST(Parameters, ComparisonsSeeEveryMember) {
  expect_comparison_sees_every_row(&PipelineOptions::blur_field);
  expect_comparison_sees_every_row(&PipelineOptions::filter);
  expect_comparison_sees_every_row(&PipelineOptions::keypoints);
  FilterOptions fourier;
  fourier.regularization = Regularization::PAPER;
  EXPECT_FALSE(fourier == FilterOptions());
}

TEST(Parameters, AreOnlyGivenToTheirOwnStruct) {
  EXPECT_THROW(find_parameter("noise_to_signal_ratio")->get(GyroOptions()), std::logic_error);
  Config config;
  EXPECT_THROW(find_parameter("noise_to_signal_ratio")->set(config, 1), std::bad_variant_access) << "an integer";
}

// dynamic_reconfigure has four types. An enumerator is a string.
TEST(Parameters, ThatMayChangeHaveATypeOfDynamicReconfigure) {
  std::size_t changing = 0;
  for (const Parameter* p : all_rows()) {
    if (p->change != Change::WHILE_RUNNING) continue;
    ++changing;
    const Value value = p->standard();
    EXPECT_TRUE(std::holds_alternative<bool>(value) || std::holds_alternative<int>(value) ||
                std::holds_alternative<double>(value) || std::holds_alternative<std::string>(value) ||
                std::holds_alternative<Choice>(value))
        << p->key;
    if (p->limits) {
      EXPECT_FALSE(p->limits->above) << p->key << ": its ranges are closed";
    }
    EXPECT_EQ(p->text.find('\''), std::string::npos) << p->key << ": its descriptions have no quotes";
  }
  EXPECT_GE(changing, 12u);
}

std::string read_file(const std::string& path) {
  std::ifstream file(path);
  EXPECT_TRUE(file) << path;
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Compares a file of the source tree with what the table says, or writes it.
void expect_file(const std::string& name, const std::string& expected) {
  const std::string path = GYRO_DEBLUR_SOURCE_DIR "/" + name;
  if (std::getenv("GYRO_DEBLUR_UPDATE") != nullptr) std::ofstream(path) << expected;
  EXPECT_TRUE(read_file(path) == expected)
      << name << " is not what src/config/parameters.cpp says. GYRO_DEBLUR_UPDATE=1 test_config writes it.";
}

TEST(ParameterDocuments, DefaultYaml) { expect_file("config/default.yaml", test::default_yaml()); }

TEST(ParameterDocuments, DeblurCfg) { expect_file("cfg/Deblur.cfg", test::deblur_cfg()); }

TEST(ParameterDocuments, Page) {
  const std::string name = "doc/guides/parameters.md";
  const std::string page = read_file(GYRO_DEBLUR_SOURCE_DIR "/" + name);
  const std::string begin = "<!-- parameters: begin -->\n", end = "<!-- parameters: end -->\n";
  const std::size_t first = page.find(begin), last = page.find(end);
  ASSERT_NE(first, std::string::npos);
  ASSERT_NE(last, std::string::npos);
  expect_file(name, page.substr(0, first + begin.size()) + "\n" + test::parameter_tables() + "\n" + page.substr(last));
}

}  // namespace
}  // namespace gyro_deblur::parameters_test
