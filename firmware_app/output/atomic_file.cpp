#include "firmware_app/output/atomic_file.h"

#include <cerrno>
#include <cstring>
#include <unistd.h>

namespace godwit::app {

AtomicFile::~AtomicFile() {
  if (out_ == nullptr) return;
  std::fclose(out_);
  std::remove(part().c_str());
}

rt::Error AtomicFile::fail(const char* doing) {
  const int why = errno;
  if (out_ != nullptr) {
    std::fclose(out_);
    out_ = nullptr;
    std::remove(part().c_str());
  }
  return {file_ + ": " + doing + ": " + std::strerror(why)};
}

rt::Result<void> AtomicFile::open(const std::string& file) {
  file_ = file;
  out_ = std::fopen(part().c_str(), "wb");
  if (out_ == nullptr) return fail("cannot be created");
  return {};
}

rt::Result<void> AtomicFile::write(std::string_view text) {
  if (std::fwrite(text.data(), 1, text.size(), out_) != text.size()) return fail("cannot be written");
  return {};
}

rt::Result<void> AtomicFile::flush() {
  if (std::fflush(out_) != 0 || fsync(fileno(out_)) != 0) return fail("cannot be written");
  return {};
}

rt::Result<void> AtomicFile::commit() {
  // The file's own name must not appear before its contents are on the disk: some file systems would otherwise keep the
  // rename and lose the data when power fails.
  auto flushed = flush();
  if (!flushed) return flushed;
  if (std::rename(part().c_str(), file_.c_str()) != 0) return fail("cannot be renamed");
  std::FILE* const done = out_;
  out_ = nullptr;
  if (std::fclose(done) != 0) return fail("cannot be closed");
  return {};
}

}  // namespace godwit::app
