// A program run as a user runs it.
#pragma once

#include <array>
#include <cstdio>
#include <string>
#include <sys/wait.h>

namespace godwit::test {

struct Outcome {
  int exit_code = -1;
  std::string text;  ///< both streams
};

/// A shell's command; waits for its end.
inline Outcome run_command(const std::string& command) {
  Outcome outcome;
  std::FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  if (pipe == nullptr) return outcome;
  std::array<char, 4096> block{};
  while (std::fgets(block.data(), static_cast<int>(block.size()), pipe) != nullptr) outcome.text += block.data();
  const int status = pclose(pipe);
  if (WIFEXITED(status)) outcome.exit_code = WEXITSTATUS(status);
  return outcome;
}

}  // namespace godwit::test
