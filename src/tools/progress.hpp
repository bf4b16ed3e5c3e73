// Progress of a tool on stderr.
#pragma once

#include <chrono>
#include <cstddef>
#include <string>

namespace gyro_deblur {

/// The progress bar of all C++ programs: a bar on a terminal, otherwise a line every tenth.
class Progress {
 public:
  /// True when stderr is a terminal.
  static bool watched();

  /// @param what   is counted, e.g. "images"
  /// @param quiet  writes nothing; !watched(): nothing but the bar
  Progress(std::size_t total, std::string what, bool quiet);
  /// Takes away a bar that is not full.
  ~Progress() { clear(); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// Precondition: 1 <= count <= total.
  void done(std::size_t count);
  /// Makes room for a line of something else; the bar comes back with what is done next.
  void clear();

 private:
  void draw(std::size_t count);

  std::size_t total_;
  std::string what_;
  bool quiet_, watched_;
  bool drawn_ = false;
  std::chrono::steady_clock::time_point drawn_at_;
};

}  // namespace gyro_deblur
