// Arguments of the tools: what is read, what is refused, what the help says.
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "tools/command_line.hpp"

namespace gyro_deblur {
namespace {

/// A tool with an argument of every kind.
struct Arguments {
  std::string input, output, format = "a";
  int threads = 2;
  std::uint64_t seed = 1;
  std::vector<std::uint64_t> seeds;
  std::optional<int> cpu;
  double gain = 0.5;
  float shift = 0;
  std::optional<double> start_s;
  std::vector<double> extents_px{5, 10}, offsets_px;
  std::vector<std::string> field;
  bool quiet = false, keypoints = true;
};

bool parse(Arguments& a, const std::vector<std::string>& words, std::string* help = nullptr) {
  CommandLine line("Does nothing to an image.", "idle");
  line.add_option("INPUT", a.input, "image").required();
  line.add_option("OUTPUT", a.output, "where to write");
  line.add_option("--format", a.format, "of the output").one_of({"a", "b"});
  line.add_option("--threads,--cores", a.threads, "at most").range(0, 256).show_default();
  line.add_option("--seed", a.seed, "of the noise");
  line.add_option("--seeds", a.seeds, "of each run");
  line.add_option("--cpu", a.cpu, "its number");
  line.add_option("--gain", a.gain, "factor").positive().show_default();
  line.add_option("--shift", a.shift, "[px]");
  line.add_option("--start", a.start_s, "[s]").not_negative();
  line.add_option("--extents", a.extents_px, "[px]").range(1, 100).show_default();
  line.add_option("--offsets", a.offsets_px, "[px]");
  line.add_option("--field", a.field, "two images").values(2);
  line.add_flag("--quiet", a.quiet, "no progress");
  line.add_flag(
      "--no-keypoints", [&a] { a.keypoints = false; }, "leave out keypoints");
  line.footer("Ends here.");
  line.check([&a] {
    if (a.quiet && a.threads == 1) throw UsageError("--quiet needs two threads");
  });
  if (help != nullptr) *help = line.help();
  std::vector<const char*> argv{"idle"};
  for (const std::string& word : words) argv.push_back(word.c_str());
  return line.parse(static_cast<int>(argv.size()), argv.data());
}

std::string refusal(const std::vector<std::string>& words) {
  Arguments a;
  try {
    parse(a, words);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(CommandLine, ReadsEveryKindOfArgument) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"in.png",    "--threads",
                        "4",         "--seed=18446744073709551615",
                        "--gain",    "2e-2",
                        "--shift",   "-1.5",
                        "--start",   "0",
                        "--extents", "20",
                        "30",        "--quiet",
                        "--format",  "b",
                        "out",       "--no-keypoints",
                        "--field",   "u",
                        "v"}));
  EXPECT_EQ(a.input, "in.png");
  EXPECT_EQ(a.output, "out");
  EXPECT_EQ(a.format, "b");
  EXPECT_EQ(a.threads, 4);
  EXPECT_EQ(a.seed, 18446744073709551615u);
  EXPECT_EQ(a.gain, 0.02);
  EXPECT_EQ(a.shift, -1.5f);
  EXPECT_EQ(a.start_s, 0.0);
  EXPECT_EQ(a.extents_px, (std::vector<double>{20, 30}));
  EXPECT_EQ(a.field, (std::vector<std::string>{"u", "v"}));
  EXPECT_TRUE(a.quiet);
  EXPECT_FALSE(a.keypoints);
}

TEST(CommandLine, LeavesWhatIsNotGiven) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"in.png"}));
  EXPECT_EQ(a.output, "");
  EXPECT_EQ(a.threads, 2);
  EXPECT_EQ(a.start_s, std::nullopt);
  EXPECT_EQ(a.extents_px, (std::vector<double>{5, 10}));
  EXPECT_FALSE(a.quiet);
}

TEST(CommandLine, AListCanBeGivenAgainAndEndsAtTheNextOption) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"in.png", "--extents", "20", "--quiet", "out", "--extents=30", "40"}));
  EXPECT_EQ(a.extents_px, (std::vector<double>{20, 30, 40}));
  EXPECT_EQ(a.output, "out");
}

TEST(CommandLine, NegativeNumbersAreValues) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"-7", "--shift", "-1e-3", "--offsets", "-30", "40", "-.5", "--quiet", "--", "-8"}));
  EXPECT_EQ(a.input, "-7");
  EXPECT_EQ(a.output, "-8");
  EXPECT_EQ(a.shift, -1e-3f);
  EXPECT_EQ(a.offsets_px, (std::vector<double>{-30, 40, -0.5}));
}

TEST(CommandLine, AnOptionMayHaveSeveralNames) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"in.png", "--cores", "3"}));
  EXPECT_EQ(a.threads, 3);
  EXPECT_EQ(a.cpu, std::nullopt);
}

TEST(CommandLine, ReadsOptionalAndUnsignedNumbers) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"in.png", "--cpu", "-1", "--seeds", "0", "18446744073709551615"}));
  EXPECT_EQ(a.cpu, -1);
  EXPECT_EQ(a.seeds, (std::vector<std::uint64_t>{0, 18446744073709551615u}));
}

TEST(CommandLine, TwoDashesEndTheOptions) {
  Arguments a;
  EXPECT_TRUE(parse(a, {"--quiet", "--", "--in.png", "-h"}));
  EXPECT_EQ(a.input, "--in.png");
  EXPECT_EQ(a.output, "-h");
}

TEST(CommandLine, SaysWhatIsWrongAndWhatIsAllowed) {
  const std::pair<std::vector<std::string>, std::string> kCases[] = {
      {{}, "INPUT is missing"},
      {{"i", "o", "p"}, "too many positional options have been specified on the command line"},
      {{"i", "--nonsense"}, "unrecognised option '--nonsense'"},
      {{"i", "-x"}, "unrecognised option '-x'"},
      {{"i", "--thread", "3"}, "unrecognised option '--thread'"},
      {{"i", "--threads"}, "the required argument for option '--threads' is missing"},
      {{"i", "--threads", "--quiet"}, "--threads takes a value, which is missing"},
      {{"i", "--threads", "257"}, "--threads is '257', allowed is 0 to 256"},
      {{"i", "--threads", "-1"}, "--threads is '-1', allowed is 0 to 256"},
      {{"i", "--threads", "2.5"}, "the argument ('2.5') for option '--threads' is invalid"},
      {{"i", "--threads", "three"}, "--threads is 'three', allowed is 0 to 256"},
      {{"i", "--threads", ""}, "--threads is '', allowed is 0 to 256"},
      {{"i", "--threads", "99999999999"}, "--threads is '99999999999', allowed is 0 to 256"},
      {{"i", "--threads", "1", "--threads", "2"}, "option '--threads' cannot be specified more than once"},
      {{"i", "--threads", "1", "--cores", "2"}, "option '--threads' cannot be specified more than once"},
      {{"i", "--seed", "-1"}, "--seed is '-1', allowed is 0 or more"},
      {{"i", "--seed", "99999999999999999999"}, "the argument ('99999999999999999999') for option '--seed' is invalid"},
      {{"i", "--seeds", "1", "-1"}, "--seeds is '-1', allowed is 0 or more"},
      {{"i", "--cpu", "1.5"}, "the argument ('1.5') for option '--cpu' is invalid"},
      {{"i", "--gain", "0"}, "--gain is '0', allowed is a number above 0"},
      {{"i", "--gain", "nan"}, "--gain is 'nan', allowed is a number above 0"},
      {{"i", "--gain", "1px"}, "--gain is '1px', allowed is a number above 0"},
      {{"i", "--shift", "1px"}, "the argument ('1px') for option '--shift' is invalid"},
      {{"i", "--shift", "1e999"}, "the argument ('1e999') for option '--shift' is invalid"},
      {{"i", "--start=-0.5"}, "--start is '-0.5', allowed is 0 or more"},
      {{"i", "--extents"}, "the required argument for option '--extents' is missing"},
      {{"i", "--extents", "5", "101"}, "--extents is '101', allowed is 1 to 100"},
      {{"i", "--field", "u"}, "the required argument for option '--field' is missing"},
      {{"i", "--format", "c"}, "--format is 'c', allowed is one of a, b"},
      {{"i", "--quiet=yes"}, "option '--quiet' does not take any arguments"},
      {{"i", "--quiet", "--threads", "1"}, "--quiet needs two threads"},
  };
  for (const auto& [words, text] : kCases) EXPECT_EQ(refusal(words), text);
}

TEST(CommandLine, HelpIsAskedForWhateverElseIsWrong) {
  for (const char* word : {"-h", "--help"}) {
    Arguments a;
    EXPECT_FALSE(parse(a, {"--nonsense", word}));
  }
}

TEST(CommandLine, HelpNamesArgumentsDefaultsAndLimits) {
  Arguments a;
  std::string help;
  parse(a, {"in.png"}, &help);
  EXPECT_EQ(help.find("Does nothing to an image.\nUsage: idle [OPTIONS] INPUT [OUTPUT]\n  INPUT: image (required)\n"),
            0u)
      << help;
  for (const char* line :
       {"\n  -h [ --help ]", "print this text\n", "\n  --threads arg (=2)", "at most; 0 to 256\n",
        "\n  --gain arg (=0.5)", "factor; a number above 0\n", "\n  --extents arg (=5 10)", "[px]; 1 to 100\n",
        "\n  --format arg", "of the output; one of a, b\n", "\n  --quiet", "no progress\n", "\nEnds here.\n"}) {
    EXPECT_NE(help.find(line), std::string::npos) << line << help;
  }
}

TEST(CommandLine, LongTextsAreWrapped) {
  std::string word, text;
  for (int i = 0; i < 60; ++i) text += "word ";
  CommandLine line("Does nothing.", "idle");
  line.add_option("--an-option-whose-name-is-long", word, text);
  const std::string help = line.help();
  for (std::size_t begin = 0, end; (end = help.find('\n', begin)) != std::string::npos; begin = end + 1) {
    EXPECT_LE(end - begin, 100u) << help.substr(begin, end - begin);
  }
  std::size_t count = 0;
  for (std::size_t at = help.find("word"); at != std::string::npos; at = help.find("word", at + 1)) ++count;
  EXPECT_EQ(count, 60u);
}

}  // namespace
}  // namespace gyro_deblur
