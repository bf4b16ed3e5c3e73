// Reads command-line arguments and prints the help.
#include "tools/command_line.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <sstream>
#include <type_traits>

#include <boost/algorithm/string.hpp>
#include <boost/format.hpp>
#include <boost/program_options.hpp>
#include <boost/range/adaptor/transformed.hpp>

namespace gyro_deblur {
namespace {

namespace po = boost::program_options;

constexpr unsigned kHelpWidth = 100, kHelpTextWidth = 60;  // columns, of all and at least of the texts

template <typename T>
std::string text_of(const T& value) {
  return boost::str(boost::format("%1%") % value);
}
template <typename T>
std::string text_of(const std::vector<T>& values) {
  return boost::join(values | boost::adaptors::transformed([](const T& value) { return text_of(value); }), " ");
}

/// NaN where it is no number.
double number(const std::string& word) {
  double value = 0;
  return boost::conversion::try_lexical_convert(word, value) ? value : std::numeric_limits<double>::quiet_NaN();
}

/// A negative number is a value. Boost takes it for an option.
std::vector<po::option> read_number(std::vector<std::string>& words) {
  if (std::isnan(number(words.front()))) return {};
  po::option value;
  value.value = value.original_tokens = {words.front()};
  words.erase(words.begin());
  return {value};
}

/// `count` values, 0: all up to the next option.
template <typename T>
struct ListValue : po::typed_value<std::vector<T>> {
  ListValue(std::vector<T>* list, unsigned count)
      : po::typed_value<std::vector<T>>(list), least(std::max(count, 1u)), most(count > 0 ? count : ~0u) {}
  unsigned min_tokens() const override { return least; }
  unsigned max_tokens() const override { return most; }
  const unsigned least, most;
};

template <typename Value, typename T>
po::value_semantic* with_default(Value* value, const T& variable, bool shown) {
  return shown ? value->default_value(variable, text_of(variable)) : value;
}
template <typename T>
po::value_semantic* make_value(T& variable, unsigned /*count*/, bool shows_default) {
  return with_default(po::value(&variable), variable, shows_default);
}
template <typename T>
po::value_semantic* make_value(std::vector<T>& variable, unsigned count, bool shows_default) {
  return with_default(new ListValue<T>(&variable, count), variable, shows_default);
}
template <typename T>
po::value_semantic* make_value(std::optional<T>& variable, unsigned /*count*/, bool /*shows_default*/) {
  return po::value<T>()->notifier([&variable](const T& value) { variable = value; });
}

}  // namespace

CommandLine::Option::Option(const std::string& names, std::string help)
    : name_(names.substr(0, names.find(','))), keys_(boost::erase_all_copy(names, "--")), help_(std::move(help)) {}

CommandLine::Option& CommandLine::Option::range(double lowest, double highest) {
  allowed_ = text_of(lowest) + " to " + text_of(highest);
  is_allowed_ = [=](const std::string& word) { return number(word) >= lowest && number(word) <= highest; };
  return *this;
}

CommandLine::Option& CommandLine::Option::positive() {
  allowed_ = "a number above 0";
  is_allowed_ = [](const std::string& word) { return number(word) > 0; };
  return *this;
}

CommandLine::Option& CommandLine::Option::not_negative() {
  allowed_ = "0 or more";
  is_allowed_ = [](const std::string& word) { return number(word) >= 0; };
  return *this;
}

CommandLine::Option& CommandLine::Option::one_of(const std::vector<std::string>& allowed) {
  allowed_ = "one of " + boost::join(allowed, ", ");
  is_allowed_ = [allowed](const std::string& word) { return std::count(allowed.begin(), allowed.end(), word) > 0; };
  return *this;
}

std::string CommandLine::Option::help() const {
  return help_ + (help_.empty() || allowed_.empty() ? "" : "; ") + allowed_ + (required_ ? " (required)" : "");
}

void CommandLine::Option::check(const std::vector<std::string>& words) const {
  for (const std::string& word : words) {
    // Boost takes the next option for the value of an option without one.
    if (!positional() && boost::starts_with(word, "--")) throw UsageError(name_ + " takes a value, which is missing");
    if (!is_allowed_(word)) throw UsageError(name_ + " is '" + word + "', allowed is " + allowed_);
  }
}

template <typename T>
CommandLine::Option& CommandLine::add_option(const std::string& name, T& variable, std::string help) {
  Option& option = options_.emplace_back(Option(name, std::move(help)));
  option.make_value_ = [&] { return make_value(variable, option.count_, option.shows_default_); };
  // Boost reads -1 as the largest unsigned number.
  constexpr bool kUnsigned = std::is_unsigned_v<T> || std::is_same_v<T, std::vector<std::uint64_t>>;
  return kUnsigned ? option.not_negative() : option;
}

#define GYRO_DEBLUR_ADD_OPTION(...) \
  template CommandLine::Option& CommandLine::add_option(const std::string&, __VA_ARGS__&, std::string)
GYRO_DEBLUR_ADD_OPTION(std::string);
GYRO_DEBLUR_ADD_OPTION(int);
GYRO_DEBLUR_ADD_OPTION(unsigned);
GYRO_DEBLUR_ADD_OPTION(long long);
GYRO_DEBLUR_ADD_OPTION(std::uint64_t);
GYRO_DEBLUR_ADD_OPTION(float);
GYRO_DEBLUR_ADD_OPTION(double);
GYRO_DEBLUR_ADD_OPTION(std::optional<int>);
GYRO_DEBLUR_ADD_OPTION(std::optional<double>);
GYRO_DEBLUR_ADD_OPTION(std::vector<int>);
GYRO_DEBLUR_ADD_OPTION(std::vector<double>);
GYRO_DEBLUR_ADD_OPTION(std::vector<std::uint64_t>);
GYRO_DEBLUR_ADD_OPTION(std::vector<std::string>);

CommandLine::Option& CommandLine::add_flag(const std::string& name, std::function<void()> action, std::string help) {
  Option& option = options_.emplace_back(Option(name, std::move(help)));
  option.make_value_ = [action = std::move(action)] {
    return po::bool_switch()->notifier([action](bool given) { given ? action() : void(); });
  };
  return option;
}

bool CommandLine::parse(int argc, const char* const* argv) {
  const std::vector<std::string> words(argv + std::min(argc, 1), argv + argc);
  const auto end = std::find(words.begin(), words.end(), "--");
  for (const char* help : {"-h", "--help"})
    if (std::find(words.begin(), end, help) != end) return false;

  po::options_description all;
  po::positional_options_description positional;
  for (const Option& option : options_) {
    all.add_options()(option.keys_.c_str(), option.make_value_());
    if (option.positional()) positional.add(option.keys_.c_str(), 1);
  }
  po::command_line_parser parser(words);
  parser.options(all).positional(positional).extra_style_parser(read_number);
  parser.style(po::command_line_style::unix_style & ~po::command_line_style::allow_guessing);
  po::variables_map values;
  try {
    const po::parsed_options parsed = parser.run();
    for (const po::option& given : parsed.options) {
      for (const Option& option : options_) {
        if (option.key() == given.string_key) option.check(given.value);
      }
    }
    po::store(parsed, values);
  } catch (const po::error& error) {
    throw UsageError(error.what());
  }
  for (Option& option : options_) {
    const po::variable_value& value = values[option.key()];
    option.given_ = !value.empty() && !value.defaulted();
    if (option.required_ && !option.given_) throw UsageError(option.name_ + " is missing");
  }
  po::notify(values);
  check_();
  return true;
}

std::string CommandLine::help() const {
  std::ostringstream usage, arguments, help;
  po::options_description options("Options", kHelpWidth, kHelpTextWidth);
  options.add_options()("help,h", "print this text");
  for (const Option& option : options_) {
    if (option.positional()) {
      usage << (option.required_ ? " " + option.name_ : " [" + option.name_ + "]");
      arguments << "  " << option.name_ << ": " << option.help() << "\n";
    } else {
      options.add_options()(option.keys_.c_str(), option.make_value_(), option.help().c_str());
    }
  }
  help << description_ << "\nUsage: " << name_ << " [OPTIONS]" << usage.str() << "\n" << arguments.str() << "\n";
  help << options << (footer_.empty() ? "" : "\n" + footer_ + "\n");
  return help.str();
}

}  // namespace gyro_deblur
