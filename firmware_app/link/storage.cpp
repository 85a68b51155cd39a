#include "firmware_app/link/storage.h"

#include <cerrno>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <sstream>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "firmware_app/link/saved_parameters.h"
#include "hal/atomic_file.h"
#include "hal/rt/small_file.h"

namespace godwit::link {
namespace {

constexpr const char* kParameterFile = "link_parameters.txt";
constexpr const char* kResetFile = "link_reset_counter.txt";

std::string error_text(const std::string& path) {
  return path + ": " + std::strerror(errno);
}

/// Neither file is larger than a page.
constexpr std::size_t kMostBytes = 16384;

bool is_there(const std::string& path) {
  struct stat about {};
  return lstat(path.c_str(), &about) == 0;
}

}  // namespace

rt::Result<StoredState> Storage::load(const ParameterValues& defaults) {
  if (folder_.empty()) return peek(defaults);
  if (access(folder_.c_str(), X_OK) != 0) return rt::Error{"link: state folder " + error_text(folder_)};
  if (lock_fd_ < 0) {
    const std::string lock = folder_ + "/lock";
    lock_fd_ = open(lock.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);
    if (lock_fd_ < 0) {
      // A disc that is read-only or full grounds nobody, nor does what somebody planted in the lock's place. Which
      // reset counters were used before cannot be kept: it begins where the clock says, as likely as not elsewhere.
      const std::string why = error_text(lock);
      StoredState state = peek(defaults);
      state.warnings.push_back(why + "; nothing can be kept, and whether another godwit uses this folder is not known");
      state.reset_counter = static_cast<std::uint8_t>(std::time(nullptr) & 0xFF);
      return state;
    }
    if (flock(lock_fd_, LOCK_EX | LOCK_NB) != 0) {
      close(lock_fd_);
      lock_fd_ = -1;
      return rt::Error{"link: state folder " + folder_ + ": another godwit uses it; two would interleave their poses"};
    }
  }
  return peek(defaults);
}

StoredState Storage::peek(const ParameterValues& defaults) const {
  StoredState state;
  state.parameters = defaults;
  if (folder_.empty()) return state;
  const std::string parameters = folder_ + "/" + kParameterFile, reset = folder_ + "/" + kResetFile;
  if (is_there(parameters)) {
    if (const auto text = rt::read_small_file(parameters, kMostBytes); text.ok()) {
      read_saved_parameters(parameters, text.value(), &state);
    } else {
      state.warnings.push_back(text.error().message + "; the configuration's parameters stand");
    }
  }
  if (is_there(reset)) {
    const auto text = rt::read_small_file(reset, kMostBytes);
    int value = -1;
    if (text.ok()) std::istringstream(text.value()) >> value;
    if (value < 0 || value > 255) {
      // Which were used before is not known: it begins where the clock says, as likely as not elsewhere.
      state.warnings.push_back((text.ok() ? reset + ": no number from 0 to 255" : text.error().message) +
                               "; the reset counter begins anew");
      value = static_cast<int>(std::time(nullptr) & 0xFF);
    }
    state.reset_counter = static_cast<std::uint8_t>(value + 1);
  }
  return state;
}

Storage::~Storage() {
  if (lock_fd_ >= 0) close(lock_fd_);
}

rt::Result<void> Storage::replace(const std::string& name, const std::string& text) const {
  if (folder_.empty()) return rt::Error{"no state folder is configured, nothing can be saved"};
  hal::AtomicFile file;
  auto done = file.open(folder_ + "/" + name);
  if (done.ok()) done = file.write(text);
  return done.ok() ? file.commit() : done;
}

void Storage::serve() {
  StorageRequest request;
  while (requests_.try_pop(&request)) {
    rt::Result<void> done;
    switch (request.kind) {
      case StorageRequest::Kind::kSaveParameters:
        done = replace(kParameterFile, saved_parameters_text(request.parameters, request.defaults));
        break;
      case StorageRequest::Kind::kEraseParameters:
        if (folder_.empty()) break;
        if (unlink((folder_ + "/" + kParameterFile).c_str()) != 0 && errno != ENOENT) {
          done = rt::Error{error_text(folder_ + "/" + kParameterFile)};
        }
        break;
      case StorageRequest::Kind::kReserveResets:
        done = replace(kResetFile, std::to_string(request.reset_counter) + "\n");
        break;
    }
    if (!done.ok()) last_error_ = done.error().message;
    replies_.try_push({request.ticket, done.ok()});
  }
}

}  // namespace godwit::link
