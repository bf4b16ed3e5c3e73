// Progress of a tool on stderr.
#pragma once

#include <unistd.h>

#include <cstddef>
#include <cstdio>
#include <string>
#include <utility>

namespace gyro_deblur {

/// A bar on a terminal, else a line every tenth, so that logs stay short.
class Progress {
 public:
  /// @param what  is counted, e.g. "images"
  Progress(std::size_t total, std::string what, bool quiet)
      : total_(total), what_(std::move(what)), quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {}

  /// Precondition: 1 <= count <= total.
  void done(std::size_t count) {
    if (quiet_) return;
    const std::size_t tenths = 10 * count / total_;
    if (terminal_) {
      constexpr std::size_t kWidth = 40;
      const std::size_t filled = kWidth * count / total_;
      std::fprintf(stderr, "\r[%s%s] %zu of %zu %s%s", std::string(filled, '#').c_str(),
                   std::string(kWidth - filled, ' ').c_str(), count, total_, what_.c_str(),
                   count == total_ ? "\n" : "");
    } else if (tenths > 10 * (count - 1) / total_) {
      std::fprintf(stderr, "%zu %%: %zu of %zu %s\n", 10 * tenths, count, total_, what_.c_str());
    }
  }

 private:
  std::size_t total_;
  std::string what_;
  bool quiet_, terminal_;
};

}  // namespace gyro_deblur
