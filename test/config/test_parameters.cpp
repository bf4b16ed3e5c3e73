// The tables of parameters: complete, and what their documents say. test_config.cpp reads each key.
#include "config/config_table.hpp"

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <regex>
#include <set>
#include <string>
#include <type_traits>
#include <vector>

#include <gtest/gtest.h>

#include "other_value.hpp"
#include "parameter_documents.hpp"

namespace gyro_deblur::parameters_test {
namespace {

template <typename T, typename... Types>
constexpr bool kIsOneOf = (std::is_same_v<T, Types> || ...);

TEST(Parameters, RowsAreComplete) {
  std::set<std::string> keys;
  for_each_parameter(Config(), [&](const Row& row, const auto& value) {
    using T = std::decay_t<decltype(value)>;
    const std::string key = row.key, text = row.text;
    SCOPED_TRACE(key);
    EXPECT_TRUE(keys.insert(key).second) << "a second time";
    EXPECT_TRUE(std::regex_match(key, std::regex("[A-Za-z][A-Za-z0-9_]*")));
    EXPECT_TRUE(std::regex_match(text, std::regex("[^\"\\n]*[^\"\\n ]\\."))) << text;
    EXPECT_EQ(row.limits.has_value(), (kIsOneOf<T, int, double, TimeNs, Eigen::Vector3d>));
    if (row.limits) {
      EXPECT_LT(row.limits->min, row.limits->max);
    }
    if (std::is_same_v<T, TimeNs>) {
      EXPECT_STREQ(row.limits->unit, "s");
    }
    if (HasNames<T>::value) {
      EXPECT_GE(choices_of<T>(row).size(), 2u);
      EXPECT_FALSE(test::to_yaml(value).empty()) << "the default has no name";
    }
    // An exposure of 0 is one that is not known.
    if (key != "exposure_time") {
      EXPECT_NO_THROW(require_allowed(row, value));
    }
    EXPECT_NO_THROW(require_allowed(row, test::other_value(row, value)));
  });
  EXPECT_GE(keys.size(), 40u);
  for (const GivenNumber& number : kGivenNumbers) EXPECT_EQ(keys.count(number.key), 1u) << number.key;
}

/// The value of each member in YAML.
std::vector<std::string> values_of(const Config& config) {
  std::vector<std::string> values;
  for_each_parameter(config, [&](const Row&, const auto& value) { values.push_back(test::to_yaml(value)); });
  return values;
}

TEST(Parameters, EachSetsItsOwnMember) {
  const std::vector<std::string> standard = values_of(Config());
  for (std::size_t i = 0; i < standard.size(); ++i) {
    Config config;
    std::size_t row_index = 0;
    for_each_parameter(config, [&](const Row& row, auto& value) {
      if (row_index++ == i) value = test::other_value(row, value);
    });
    const std::vector<std::string> values = values_of(config);
    for (std::size_t j = 0; j < standard.size(); ++j) EXPECT_EQ(values[j] != standard[j], i == j) << i << ' ' << j;
  }
}

/// Converts to the type of any member.
struct AnyValue {
  template <typename T>
  operator T() const;
};

template <typename T, typename... Members>
constexpr auto takes(int) -> decltype(T{std::declval<Members>()...}, true) {
  return true;
}
template <typename T, typename... Members>
constexpr bool takes(...) {
  return false;
}

/// How many members a struct has.
template <typename T, typename... Members>
constexpr std::size_t member_count() {
  if constexpr (takes<T, Members..., AnyValue>(0)) {
    return member_count<T, Members..., AnyValue>();
  } else {
    return sizeof...(Members);
  }
}

/// Counts the rows and parts of a table and of those of its parts.
template <typename Options>
struct Completeness {
  void group(const char*, const char* = "") const {}
  template <typename T>
  void operator()(const Row&, T Options::*member) {
    add(member);
  }
  template <typename Part>
  void part(Part Options::*member) {
    add(member);
    Completeness<Part> part;
    visit(Table<Part>(), part);
    // Kind and unit are the row exposure_source.
    part.expect_all(std::is_same_v<Part, ExposureSource> ? 2 : 0);
  }
  template <typename T>
  void add(T Options::*member) {
    const Options options;
    const auto* const base = reinterpret_cast<const char*>(&options);
    offsets.insert(reinterpret_cast<const char*>(&(options.*member)) - base);
  }
  void expect_all(std::size_t others) const {
    EXPECT_EQ(offsets.size() + others, member_count<Options>()) << typeid(Options).name();
  }
  std::set<std::ptrdiff_t> offsets;
};

TEST(Parameters, EveryMemberHasARow) {
  Completeness<Config> config;
  visit(Table<Config>(), config);
  config.expect_all(2);  // without `given` and `calibration`
}

/// Checks that two options compare as different when one member of one of them is changed.
template <typename Options>
void expect_comparison_sees_every_row() {
  EXPECT_TRUE(Options() == Options());
  std::vector<std::string> keys;
  for_each_parameter(Options(), [&](const Row& row, const auto&) { keys.push_back(row.key); });
  EXPECT_EQ(keys.size(), member_count<Options>());
  for (const std::string& key : keys) {
    Options options;
    for_each_parameter(options, [&](const Row& row, auto& value) {
      if (row.key == key) value = test::other_value(row, value);
    });
    EXPECT_FALSE(options == Options()) << key;
  }
}

TEST(Parameters, ComparisonsSeeEveryMember) {
  expect_comparison_sees_every_row<BlurFieldOptions>();
  expect_comparison_sees_every_row<FilterOptions>();
  expect_comparison_sees_every_row<KeypointOptions>();
  FilterOptions fourier;
  fourier.regularization = Regularization::PAPER;
  EXPECT_FALSE(fourier == FilterOptions());
}

// dynamic_reconfigure has four types. An enumerator is a string.
TEST(Parameters, ThatMayChangeHaveATypeOfDynamicReconfigure) {
  std::size_t changing = 0;
  for_each_parameter(Config(), [&](const Row& row, const auto& value) {
    if (row.change != Change::WHILE_RUNNING) return;
    ++changing;
    using T = std::decay_t<decltype(value)>;
    EXPECT_TRUE((kIsOneOf<T, bool, int, double, std::string> || HasNames<T>::value)) << row.key;
    if (row.limits) {
      EXPECT_FALSE(row.limits->above) << row.key << ": its ranges are closed";
    }
    EXPECT_EQ(std::string(row.text).find('\''), std::string::npos) << row.key << ": its descriptions have no quotes";
  });
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
      << name << " is not what the tables say. GYRO_DEBLUR_UPDATE=1 test_config writes it.";
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
