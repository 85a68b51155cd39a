#include "hal/atomic_file.h"

#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

namespace godwit::hal {
namespace {

/// The name itself is data of its folder. A file system that cannot do this loses no more than the name.
void sync_folder_of(const std::string& file) {
  const std::size_t slash = file.rfind('/');
  const std::string folder = slash == std::string::npos ? "." : file.substr(0, slash + 1);
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  fsync(fd);
  close(fd);
}

}  // namespace

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
  struct stat about {};
  if (lstat(part().c_str(), &about) == 0 && S_ISLNK(about.st_mode)) unlink(part().c_str());
  const int fd = ::open(part().c_str(), O_WRONLY | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);
  if (fd < 0) return fail("cannot be created");
  const char* why = nullptr;
  if (fstat(fd, &about) != 0 || !S_ISREG(about.st_mode)) why = "is no plain file";
  if (why == nullptr && flock(fd, LOCK_EX | LOCK_NB) != 0) why = "another run writes it";
  if (why == nullptr && ftruncate(fd, 0) != 0) why = "cannot be emptied";
  if (why != nullptr) {
    close(fd);
    return rt::Error{part() + ": " + why};
  }
  out_ = fdopen(fd, "wb");
  if (out_ == nullptr) {
    close(fd);
    return fail("cannot be created");
  }
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
  sync_folder_of(file_);
  return {};
}

}  // namespace godwit::hal
