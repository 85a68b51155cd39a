// A file that exists whole or not at all.
#pragma once

#include <cstdio>
#include <string>
#include <string_view>

#include "hal/rt/result.h"

namespace godwit::hal {

/// Writes to NAME.part and renames to NAME in commit(). Whatever goes wrong before (full disk, no right to write, the
/// process killed, a power cut) leaves no NAME, or the one that there was. What is no plain file is no NAME: a device
/// would be gone and a plain file stand in its place (/dev/null, /dev/stdout). NAME.part is a file of its own: what a
/// killed run left there goes, and so does a link of either kind that somebody laid there, not what it leads to; what
/// another run writes stays, and is an error. The destructor removes an uncommitted NAME.part. One thread.
class AtomicFile {
 public:
  AtomicFile() = default;
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Error of each: the file and the reason. After an error the file is closed and nothing of it is left.
  rt::Result<void> open(const std::string& file);
  rt::Result<void> write(std::string_view text);
  /// Brings everything to the disk, still as NAME.part. What can fail for want of room fails here.
  rt::Result<void> flush();
  /// Flushes, gives the file its name, and brings the name to the disk.
  rt::Result<void> commit();

  const std::string& file() const { return file_; }

 private:
  std::string part() const { return file_ + ".part"; }
  rt::Error fail(const char* doing);
  void abandon();

  std::string file_;
  std::FILE* out_ = nullptr;
};

}  // namespace godwit::hal
