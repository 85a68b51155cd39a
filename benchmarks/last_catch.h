// The last catch of a program that measures. (godwit's own have that of firmware_app/program, which takes signals too.)
#pragma once

#include <cstdio>
#include <exception>

namespace godwit::bench {

/// Returns what run(argc, argv) returns. An exception of a library that comes out of it (CLI11, yaml-cpp, OpenCV, a
/// number in a table that is none) is told on the error stream under the program's name: 1.
inline int last_catch(const char* name, int (*run)(int argc, char** argv), int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s: %s\n", name, e.what());
    return 1;
  }
}

}  // namespace godwit::bench
