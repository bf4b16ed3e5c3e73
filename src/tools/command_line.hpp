// Arguments of the command-line tools. Boost.Program_options reads them, and is compiled in command_line.cpp alone.
#pragma once

#include <deque>
#include <functional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace boost::program_options {
class value_semantic;
}

namespace gyro_deblur {

/// Wrong arguments. what() names the argument, its value and what is allowed.
class UsageError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The options "--name VALUE" or "--name=VALUE" and the positional arguments of a tool, in any order. An option is
/// given once. The option of a std::vector takes all values up to the next option, and may be given again.
/// "--" ends the options. -h and --help are always there.
class CommandLine {
 public:
  class Option {
   public:
    Option& required() { return required_ = true, *this; }
    Option& range(double lowest, double highest);
    Option& positive();
    Option& not_negative();
    Option& one_of(const std::vector<std::string>& allowed);
    /// This many values for a std::vector.
    Option& values(unsigned count) { return count_ = count, *this; }
    /// Shows the present value of the variable in the help. Not for std::optional.
    Option& show_default() { return shows_default_ = true, *this; }
    /// After parse(): whether it was among the arguments.
    bool given() const { return given_; }

   private:
    friend class CommandLine;
    Option(const std::string& names, std::string help);
    bool positional() const { return name_.front() != '-'; }
    std::string key() const { return keys_.substr(0, keys_.find(',')); }
    void check(const std::vector<std::string>& words) const;
    std::string help() const;

    std::string name_, keys_, help_, allowed_;  // keys: all names as Boost wants them
    unsigned count_ = 0;                        // of values; 0: as the type of the variable says
    bool required_ = false, shows_default_ = false, given_ = false;
    std::function<bool(const std::string&)> is_allowed_ = [](const std::string&) { return true; };
    std::function<boost::program_options::value_semantic*()> make_value_;
  };

  /// @param description  what the tool does, at the head of its help
  CommandLine(std::string description, std::string name)
      : description_(std::move(description)), name_(std::move(name)) {}

  /// @param name  "--name", or "--name,--former-name" where one has several; of a positional argument: without dashes
  /// @param variable  parse() writes a given value to it; has to outlive this object; its types: see command_line.cpp
  /// @return valid as long as this object
  template <typename T>
  Option& add_option(const std::string& name, T& variable, std::string help = "");
  Option& add_flag(const std::string& name, std::function<void()> action, std::string help);
  Option& add_flag(const std::string& name, bool& variable, std::string help = "") {
    return add_flag(name, std::function<void()>([&variable] { variable = true; }), std::move(help));
  }
  /// Shown below the options.
  void footer(std::string text) { footer_ = std::move(text); }
  /// Called when all arguments are read; throws UsageError where they contradict each other.
  void check(std::function<void()> check) { check_ = std::move(check); }

  /// Throws UsageError.
  /// @return false when help is asked for: the other arguments are not looked at then
  bool parse(int argc, const char* const* argv);
  std::string help() const;
  const std::string& name() const { return name_; }

 private:
  std::string description_, name_, footer_;
  std::deque<Option> options_;  // their addresses stay
  std::function<void()> check_ = [] {};
};

}  // namespace gyro_deblur
