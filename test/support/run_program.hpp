// Runs a command-line tool as a user would.
#pragma once

#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <stdexcept>
#include <string>
#include <vector>

namespace gyro_deblur::test {

struct ProgramResult {
  int exit_code = -1;        ///< -1: ended by a signal
  std::string output;        ///< stdout and stderr
  long peak_memory_kib = 0;  ///< resident
};

/// The shell's answer where a program cannot be started is 127, and that of this.
inline ProgramResult run_program(const std::vector<std::string>& command) {
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  int ends[2];
  if (pipe(ends) != 0) throw std::runtime_error("cannot start " + command.front());
  const pid_t program = fork();
  if (program < 0) throw std::runtime_error("cannot start " + command.front());
  if (program == 0) {
    dup2(ends[1], STDOUT_FILENO);
    dup2(ends[1], STDERR_FILENO);
    close(ends[0]);
    close(ends[1]);
    execvp(arguments.front(), arguments.data());
    _exit(127);
  }
  close(ends[1]);
  ProgramResult result;
  std::array<char, 4096> buffer;
  for (ssize_t n; (n = read(ends[0], buffer.data(), buffer.size())) > 0;) {
    result.output.append(buffer.data(), static_cast<std::size_t>(n));
  }
  close(ends[0]);
  int status = 0;
  rusage used{};
  if (wait4(program, &status, 0, &used) == program && WIFEXITED(status)) result.exit_code = WEXITSTATUS(status);
  result.peak_memory_kib = used.ru_maxrss;
  return result;
}

}  // namespace gyro_deblur::test
