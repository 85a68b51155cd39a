// What the checks in the virtual machine share: each says what held and what did not, and goes on.
#pragma once

#include <cstdio>
#include <cstdlib>
#include <string>

namespace godwit::vm {

inline int failures = 0;

inline bool check(bool ok, const std::string& what) {
  std::printf("%s %s\n", ok ? "ok   " : "FAIL ", what.c_str());
  std::fflush(stdout);
  if (!ok) ++failures;
  return ok;
}

/// A shell command that must succeed.
inline bool run(const std::string& command) {
  return check(std::system(command.c_str()) == 0, command);
}

}  // namespace godwit::vm
