// A serial device that comes and goes, under one name.
#pragma once

#include <filesystem>
#include <gtest/gtest.h>
#include <pty.h>
#include <string>
#include <unistd.h>

namespace godwit::test {

class SerialLine {
 public:
  /// There from now on.
  explicit SerialLine(std::string device) : name(std::move(device)) { plug(); }
  ~SerialLine() { unplug(); }
  SerialLine(const SerialLine&) = delete;
  SerialLine& operator=(const SerialLine&) = delete;
  void plug() {
    EXPECT_EQ(openpty(&ours_, &theirs_, nullptr, nullptr, nullptr), 0);
    std::filesystem::create_symlink(ttyname(theirs_), name);
  }
  void unplug() {
    std::filesystem::remove(name);
    for (int* fd : {&ours_, &theirs_}) {
      if (*fd >= 0) close(*fd);
      *fd = -1;
    }
  }
  const std::string name;

 private:
  int ours_ = -1, theirs_ = -1;
};

}  // namespace godwit::test
