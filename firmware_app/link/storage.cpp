#include "firmware_app/link/storage.h"

#include <cerrno>
#include <charconv>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <sstream>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "hal/rt/small_file.h"

namespace godwit::link {
namespace {

constexpr const char* kParameterFile = "link_parameters.txt";
constexpr const char* kResetFile = "link_reset_counter.txt";

std::string error_text(const std::string& path) {
  return path + ": " + std::strerror(errno);
}

// "NAME value" in each line; '#' begins a comment. Unknown names are passed over: they belong to another version. What
// is wrong is left out, with a warning.
void read_parameters(const std::string& path, const std::string& text, StoredState* state) {
  std::istringstream in(text);
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line[0] == '#') continue;
    const auto wrong = [&](const std::string& why) {
      state->warnings.push_back(path + ":" + std::to_string(number) + ": " + why +
                                "; the configuration's value stands");
    };
    std::istringstream words(line);
    std::string name, text_value, rest;
    words >> name >> text_value;
    std::int64_t value = 0;
    const char* const end_of_text = text_value.data() + text_value.size();
    const auto [end, failure] = std::from_chars(text_value.data(), end_of_text, value);
    if (text_value.empty() || failure != std::errc() || end != end_of_text || words >> rest) {
      wrong("expected NAME and a whole number");
      continue;
    }
    const Parameter p = ParameterSet::find(name);
    if (p == Parameter::kCount) continue;
    if (value < info(p).min || value > info(p).max) {
      wrong(name + " must be " + std::to_string(info(p).min) + " to " + std::to_string(info(p).max));
      continue;
    }
    state->parameters[static_cast<std::size_t>(p)] = value;
    state->has_parameters = true;
  }
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
  if (access(folder_.c_str(), W_OK | X_OK) != 0) return rt::Error{"link: state folder " + error_text(folder_)};
  if (lock_fd_ < 0) {
    const std::string lock = folder_ + "/lock";
    lock_fd_ = open(lock.c_str(), O_RDWR | O_CREAT | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0644);
    if (lock_fd_ < 0) return rt::Error{"link: state folder " + error_text(lock)};
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
      read_parameters(parameters, text.value(), &state);
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
  const std::string path = folder_ + "/" + name, beside = path + ".new";
  unlink(beside.c_str());  // of a run that was killed; a link that somebody laid goes, not what it leads to
  const int fd = open(beside.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
  if (fd < 0) return rt::Error{error_text(beside)};
  std::size_t written = 0;
  while (written < text.size()) {
    const ssize_t n = write(fd, text.data() + written, text.size() - written);
    if (n <= 0) {
      rt::Error error{error_text(beside)};
      close(fd);
      unlink(beside.c_str());
      return error;
    }
    written += static_cast<std::size_t>(n);
  }
  const bool synced = fsync(fd) == 0;
  if (close(fd) != 0 || !synced || rename(beside.c_str(), path.c_str()) != 0) {
    rt::Error error{error_text(path)};
    unlink(beside.c_str());
    return error;
  }
  // The name itself is data of the folder.
  const int folder = open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder >= 0) {
    fsync(folder);
    close(folder);
  }
  return {};
}

void Storage::serve() {
  StorageRequest request;
  while (requests_.try_pop(&request)) {
    rt::Result<void> done;
    switch (request.kind) {
      case StorageRequest::Kind::kSaveParameters: {
        std::string text = "# godwit: parameters saved over the bus; they override the configuration\n";
        for (std::size_t i = 0; i < kParameters; ++i) {
          if (request.parameters[i] == request.defaults[i]) continue;
          text += std::string(kParameterTable[i].name) + " " + std::to_string(request.parameters[i]) + "\n";
        }
        done = replace(kParameterFile, text);
        break;
      }
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
