#include "hal/rt/small_file.h"

#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

namespace godwit::rt {

Result<std::string> read_small_file(const std::string& path, std::size_t most_bytes) {
  // Without O_NONBLOCK a named pipe would keep open() waiting for its other end.
  const int fd = open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return Error{path + ": " + std::strerror(errno)};
  struct stat about {};
  std::string why;
  std::string text;
  if (fstat(fd, &about) != 0) {
    why = std::strerror(errno);
  } else if (!S_ISREG(about.st_mode)) {
    why = "no plain file";
  } else {
    // One byte more than allowed tells a larger one, also one that grows.
    text.resize(most_bytes + 1);
    std::size_t size = 0;
    ssize_t n = 1;
    while (n > 0 && size < text.size()) {
      n = read(fd, text.data() + size, text.size() - size);
      if (n < 0) why = std::strerror(errno);
      if (n > 0) size += n;
    }
    text.resize(size);
    if (size > most_bytes) why = "larger than " + std::to_string(most_bytes) + " bytes";
  }
  close(fd);
  if (!why.empty()) return Error{path + ": " + why};
  return text;
}

}  // namespace godwit::rt
