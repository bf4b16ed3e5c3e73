// Prints the progress of a tool.
#include "tools/progress.hpp"

#include <unistd.h>

#include <cstdio>
#include <utility>

namespace gyro_deblur {

bool Progress::watched() { return isatty(STDERR_FILENO) != 0; }

Progress::Progress(std::size_t total, std::string what, bool quiet)
    : total_(total), what_(std::move(what)), quiet_(quiet), watched_(watched()) {}

void Progress::done(std::size_t count) {
  if (quiet_) return;
  if (watched_) {
    draw(count);
  } else if (const std::size_t tenths = 10 * count / total_; tenths > 10 * (count - 1) / total_) {
    std::fprintf(stderr, "%zu %%: %zu of %zu %s\n", 10 * tenths, count, total_, what_.c_str());
  }
}

void Progress::draw(std::size_t count) {
  constexpr std::chrono::milliseconds kPeriod{100};
  const auto now = std::chrono::steady_clock::now();
  if (count < total_ && drawn_ && now - drawn_at_ < kPeriod) return;
  constexpr std::size_t kWidth = 40;
  const std::size_t filled = kWidth * count / total_;
  std::fprintf(stderr, "\r[%s%s] %zu of %zu %s%s", std::string(filled, '#').c_str(),
               std::string(kWidth - filled, ' ').c_str(), count, total_, what_.c_str(), count == total_ ? "\n" : "");
  std::fflush(stderr);
  drawn_ = count < total_;
  drawn_at_ = now;
}

void Progress::clear() {
  if (drawn_) std::fprintf(stderr, "\r\033[K");
  drawn_ = false;
}

}  // namespace gyro_deblur
