#include "firmware_app/link/storage.h"

#include <cerrno>
#include <charconv>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <sstream>
#include <unistd.h>

namespace godwit::link {
namespace {

constexpr const char* kParameterFile = "link_parameters.txt";
constexpr const char* kResetFile = "link_reset_counter.txt";

std::string error_text(const std::string& path) {
  return path + ": " + std::strerror(errno);
}

// "NAME value" in each line; '#' begins a comment. Unknown names are passed over: they belong to another version.
rt::Result<void> read_parameters(const std::string& path, std::istream& in, ParameterValues* values) {
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream words(line);
    std::string name, text, rest;
    words >> name >> text;
    std::int64_t value = 0;
    const auto [end, failure] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty() || failure != std::errc() || end != text.data() + text.size() || words >> rest) {
      return rt::Error{path + ":" + std::to_string(number) + ": expected NAME and a whole number, found \"" + line +
                       "\""};
    }
    const Parameter p = ParameterSet::find(name);
    if (p == Parameter::kCount) continue;
    if (value < info(p).min || value > info(p).max) {
      return rt::Error{path + ":" + std::to_string(number) + ": " + name + " must be " + std::to_string(info(p).min) +
                       " to " + std::to_string(info(p).max)};
    }
    (*values)[static_cast<std::size_t>(p)] = value;
  }
  return {};
}

}  // namespace

rt::Result<StoredState> Storage::load(const ParameterValues& defaults) const {
  StoredState state;
  state.parameters = defaults;
  if (folder_.empty()) return state;
  if (access(folder_.c_str(), W_OK | X_OK) != 0) return rt::Error{"link: state folder " + error_text(folder_)};
  const std::string parameters = folder_ + "/" + kParameterFile, reset = folder_ + "/" + kResetFile;
  if (std::ifstream in(parameters); in) {
    if (const auto read = read_parameters(parameters, in, &state.parameters); !read.ok()) return read.error();
    state.has_parameters = true;
  }
  if (std::ifstream in(reset); in) {
    int value = -1;
    in >> value;
    if (!in || value < 0 || value > 255) return rt::Error{reset + ":1: expected a number from 0 to 255"};
    state.reset_counter = static_cast<std::uint8_t>(value + 1);
  }
  return state;
}

rt::Result<void> Storage::replace(const std::string& name, const std::string& text) const {
  if (folder_.empty()) return rt::Error{"no state folder is configured, nothing can be saved"};
  const std::string path = folder_ + "/" + name, beside = path + ".new";
  const int fd = open(beside.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
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
