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

constexpr int kTries = 10;
constexpr const char* kWritten = "another run writes it";

bool is_named(int fd, const std::string& name) {
  struct stat ours {
  }, named{};
  return fstat(fd, &ours) == 0 && lstat(name.c_str(), &named) == 0 && ours.st_dev == named.st_dev &&
         ours.st_ino == named.st_ino;
}

/// Why nothing may be laid in the place of `name`, wherever links lead; null: it is a plain file, or nothing yet.
const char* in_the_way(const std::string& name) {
  struct stat about {};
  if (stat(name.c_str(), &about) != 0 || S_ISREG(about.st_mode)) return nullptr;
  return S_ISDIR(about.st_mode) ? "is a folder" : "is no plain file";
}

/// What a run that was killed left behind goes, and what somebody planted: the name alone, whatever else is called by
/// it. Why it stays, without words of `name`; null: the name is free, or was a moment ago.
const char* make_way(const std::string& name) {
  struct stat about {};
  if (lstat(name.c_str(), &about) != 0) return nullptr;
  if (S_ISLNK(about.st_mode)) {
    unlink(name.c_str());
    return nullptr;
  }
  if (!S_ISREG(about.st_mode)) return "is no plain file";
  const int fd = ::open(name.c_str(), O_WRONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return errno == ENOENT ? nullptr : "is there, and not ours";
  const bool written = flock(fd, LOCK_EX | LOCK_NB) != 0;
  // Under the lock: whoever made it has ended, and is not about to give it its name.
  if (!written && is_named(fd, name)) unlink(name.c_str());
  close(fd);
  return written ? kWritten : nullptr;
}

}  // namespace

AtomicFile::~AtomicFile() {
  if (out_ != nullptr) abandon();
}

void AtomicFile::abandon() {
  // Under the lock: after it the name may be another run's.
  std::remove(part().c_str());
  std::fclose(out_);
  out_ = nullptr;
}

rt::Error AtomicFile::fail(const char* doing) {
  const int why = errno;
  if (out_ != nullptr) abandon();
  return {file_ + ": " + doing + ": " + std::strerror(why)};
}

rt::Result<void> AtomicFile::open(const std::string& file) {
  file_ = file;
  if (const char* why = in_the_way(file); why != nullptr) return rt::Error{file + ": " + why};
  int fd = -1;
  // Another run that ends at this moment may take the name away between two steps.
  for (int tries = 0; fd < 0 && tries < kTries; ++tries) {
    if (const char* why = make_way(part()); why != nullptr) return rt::Error{part() + ": " + why};
    fd = ::open(part().c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
    if (fd < 0 && errno != EEXIST) return fail("cannot be created");
    if (fd < 0 || (flock(fd, LOCK_EX | LOCK_NB) == 0 && is_named(fd, part()))) continue;
    close(fd);
    fd = -1;
  }
  if (fd < 0) return rt::Error{part() + ": " + kWritten};
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
