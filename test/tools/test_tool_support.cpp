// What the tools have in common: exit codes, files that are written, progress.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tools/output_file.hpp"
#include "tools/progress.hpp"
#include "tools/tool_main.hpp"

namespace gyro_deblur {
namespace {

namespace fs = std::filesystem;

struct Ended {
  int exit_code;
  bool ran;
  std::string out, err;
};

/// A tool with one required argument NUMBER.
Ended run(std::vector<std::string> arguments, const std::string& error = "") {
  CommandLine app{"Does nothing.", "idle"};
  int number = 0;
  app.add_option("NUMBER", number).required();
  arguments.insert(arguments.begin(), "idle");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  Ended ended{};
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  ended.exit_code = run_tool(app, static_cast<int>(argv.size()), argv.data(), [&] {
    ended.ran = true;
    if (!error.empty()) throw std::runtime_error(error);
  });
  ended.out = testing::internal::GetCapturedStdout();
  ended.err = testing::internal::GetCapturedStderr();
  return ended;
}

TEST(ToolMain, ExitCodesDistinguishBadInputFromBadUsage) {
  const Ended good = run({"3"});
  EXPECT_EQ(good.exit_code, 0);
  EXPECT_TRUE(good.ran);
  EXPECT_EQ(good.err, "");

  const Ended help = run({"--help"});
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_FALSE(help.ran);
  EXPECT_NE(help.out.find("NUMBER"), std::string::npos);
  EXPECT_EQ(help.err, "");

  for (const std::vector<std::string>& bad : {std::vector<std::string>{}, {"three"}, {"3", "4"}, {"3", "--nonsense"}}) {
    const Ended ended = run(bad);
    EXPECT_EQ(ended.exit_code, 2);
    EXPECT_FALSE(ended.ran);
    EXPECT_EQ(ended.out, "");
    EXPECT_NE(ended.err, "");
  }

  const Ended failed = run({"3"}, "file.bag: no such file");
  EXPECT_EQ(failed.exit_code, 1);
  EXPECT_EQ(failed.err, "idle: file.bag: no such file\n");
}

class OutputFile : public testing::Test {
 protected:
  OutputFile() {
    std::string pattern = (fs::temp_directory_path() / "output_file_XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary directory");
    folder_ = pattern;
  }
  ~OutputFile() override { fs::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string content(const std::string& name) const {
    std::ifstream file(path(name));
    return {std::istreambuf_iterator<char>(file), {}};
  }
  std::size_t files() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }

  fs::path folder_;
};

TEST_F(OutputFile, HasItsNameOnlyWhenItIsComplete) {
  write_text(path("a"), "old");
  {
    PartialFile file(path("a"));
    EXPECT_EQ(file.path(), path("a.part"));
    write_text(file.path(), "new");
    EXPECT_EQ(content("a"), "old");
    file.finish();
    EXPECT_EQ(content("a"), "new");
  }
  EXPECT_EQ(content("a"), "new");
  EXPECT_EQ(files(), 1u);
}

TEST_F(OutputFile, LeavesNothingBehindWhenSomethingGoesWrong) {
  write_text(path("a"), "old");
  const auto fail = [this] {
    PartialFile file(path("a"));
    write_text(file.path(), "ne");
    throw std::runtime_error("disk full");
  };
  EXPECT_THROW(fail(), std::runtime_error);
  EXPECT_EQ(content("a"), "old");
  EXPECT_EQ(files(), 1u);
}

TEST_F(OutputFile, IsNamedWhenItCannotBeWritten) {
  try {
    write_text(path("none/a"), "text");
    FAIL() << "no exception";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(error.what(), path("none/a") + ": cannot be written: check folder, permissions and free space");
  }
  EXPECT_THROW(write_text("/dev/full", "text"), std::runtime_error);
  EXPECT_THROW(write_json("/dev/full", {{"a", 1}}), std::runtime_error);
}

TEST_F(OutputFile, ReportIsWrittenWhereOneIsWanted) {
  const nlohmann::json report{{"frames", 3}, {"engine", "cpu"}};
  write_json("", report);
  EXPECT_EQ(files(), 0u);
  write_json(path("report.json"), report);
  EXPECT_EQ(nlohmann::json::parse(content("report.json")), report);
}

// Renaming would put a file in the device's place.
TEST_F(OutputFile, DeviceStaysWhatItIs) {
  fs::create_symlink("/dev/null", path("device"));
  for (const bool complete : {false, true}) {
    PartialFile file(path("device"));
    EXPECT_EQ(file.path(), path("device"));
    write_text(file.path(), "text");
    if (complete) file.finish();
  }
  EXPECT_EQ(fs::read_symlink(path("device")), "/dev/null");
  EXPECT_EQ(files(), 1u);
}

TEST_F(OutputFile, FramesAreInTheReportBeforeItIsComplete) {
  const nlohmann::json frames{{{"stamp_ns", 1}, {"reason", "NONE"}}, {{"stamp_ns", 2}, {"reason", "NO_GYRO"}}};
  for (const std::size_t count : {0, 1, 2}) {
    nlohmann::json expected{{"engine", "cpu"}, {"frames", nlohmann::json::array()}};
    FrameReport report(path("report.json"));
    for (std::size_t i = 0; i < count; ++i) {
      report.add(frames[i]);
      expected["frames"].push_back(frames[i]);
    }
    report.finish({{"engine", "cpu"}});
    EXPECT_EQ(nlohmann::json::parse(content("report.json")), expected) << content("report.json");
  }
  {
    FrameReport abandoned(path("report.json"));
    // More than a stream holds back: it is on the disk, and nowhere else.
    for (int i = 0; i < 10000; ++i) abandoned.add(frames[0]);
    EXPECT_GT(fs::file_size(path("report.json.part")), 200000u);
  }
  EXPECT_EQ(nlohmann::json::parse(content("report.json"))["frames"].size(), 2u);
  EXPECT_EQ(files(), 1u);

  FrameReport none("");
  EXPECT_FALSE(none.wanted());
  none.finish({{"engine", "cpu"}});
  EXPECT_EQ(files(), 1u);
  EXPECT_THROW(FrameReport(path("none/report.json")), std::runtime_error);
  EXPECT_THROW(FrameReport("/dev/full"), std::runtime_error);
}

/// What `work` writes to stderr when that is a log.
template <typename Work>
std::string logged(Work work) {
  testing::internal::CaptureStderr();
  work();
  return testing::internal::GetCapturedStderr();
}

/// What `work` writes to stderr when that is a terminal.
template <typename Work>
std::string shown(Work work) {
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
  if (terminal < 0 || grantpt(terminal) != 0 || unlockpt(terminal) != 0) throw std::runtime_error("no terminal");
  const int screen = open(ptsname(terminal), O_RDWR | O_NOCTTY);
  const int saved = dup(STDERR_FILENO);
  dup2(screen, STDERR_FILENO);
  work();
  // Shows where to stop reading.
  constexpr char kEnd = '\x04';
  if (write(STDERR_FILENO, &kEnd, 1) != 1) throw std::runtime_error("the terminal does not take a byte");
  dup2(saved, STDERR_FILENO);
  std::string text;
  for (char c; read(terminal, &c, 1) == 1 && c != kEnd;) text += c;
  for (const int file : {saved, screen, terminal}) close(file);
  return text;
}

void count_to(Progress& progress, std::size_t last) {
  for (std::size_t i = 1; i <= last; ++i) progress.done(i);
}

TEST(ProgressOfATool, IsALineEveryTenthInALog) {
  const std::string lines = logged([] {
    Progress progress(25, "images", false);
    count_to(progress, 25);
  });
  EXPECT_EQ(std::count(lines.begin(), lines.end(), '\n'), 10);
  EXPECT_EQ(lines.find("10 %: 3 of 25 images\n"), 0u);
  EXPECT_NE(lines.find("100 %: 25 of 25 images\n"), std::string::npos);
  EXPECT_EQ(logged([] {
              Progress progress(1, "images", false);
              count_to(progress, 1);
            }),
            "100 %: 1 of 1 images\n");
}

TEST(ProgressOfATool, SaysNothingWhenQuietOrWhenOnlyABarIsWanted) {
  EXPECT_EQ(logged([] {
              Progress progress(25, "images", true);
              count_to(progress, 25);
            }),
            "");
  EXPECT_EQ(logged([] {
              EXPECT_FALSE(Progress::watched());
              Progress progress(25, "messages", !Progress::watched());
              count_to(progress, 20);
              progress.clear();
            }),
            "");
  EXPECT_EQ(shown([] {
              Progress progress(25, "images", true);
              count_to(progress, 20);
            }),
            "");
}

TEST(ProgressOfATool, IsABarOnATerminal) {
  const std::string bar = shown([] {
    EXPECT_TRUE(Progress::watched());
    Progress progress(4, "messages", !Progress::watched());
    count_to(progress, 4);
  });
  EXPECT_EQ(bar.find("\r[##########                              ] 1 of 4 messages"), 0u);
  const std::string full = "\r[" + std::string(40, '#') + "] 4 of 4 messages\r\n";
  ASSERT_GE(bar.size(), full.size());
  EXPECT_EQ(bar.substr(bar.size() - full.size()), full);
}

TEST(ProgressOfATool, BarMakesRoomAndIsTakenAway) {
  const std::string kClear = "\r\033[K";
  const std::string text = shown([] {
    Progress progress(2, "messages", false);
    progress.clear();  // nothing there yet
    progress.done(1);
    progress.clear();
    progress.clear();  // nothing there any more
    progress.done(1);
  });
  const std::string bar = "\r[" + std::string(20, '#') + std::string(20, ' ') + "] 1 of 2 messages";
  EXPECT_EQ(text, bar + kClear + bar + kClear);
}

}  // namespace
}  // namespace gyro_deblur
