// What a flight has written, as text.
#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace godwit::test {

/// The whole file; empty where it cannot be read.
inline std::string content(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::stringstream s;
  s << in.rdbuf();
  return s.str();
}

}  // namespace godwit::test
