// What the link keeps over a restart: saved parameters and the reset counter. Files are touched by serve() alone, on a
// thread that may wait; the link thread only passes messages.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware_app/link/parameters.h"
#include "hal/rt/result.h"
#include "hal/rt/spsc_ring.h"

namespace godwit::link {

struct StoredState {
  ParameterValues parameters{};  ///< the defaults where nothing was saved
  bool has_parameters = false;   ///< anything was saved
  /// What was kept and is not used, in words; it grounds nobody.
  std::vector<std::string> warnings;
  /// First reset counter this run may use: past all that were used before.
  std::uint8_t reset_counter = 0;
};

struct StorageRequest {
  enum class Kind : std::uint8_t { kSaveParameters, kEraseParameters, kReserveResets };
  Kind kind = Kind::kSaveParameters;
  std::uint32_t ticket = 0;
  ParameterValues parameters{};
  ParameterValues defaults{};      ///< what equals them is not written: it follows the configuration
  std::uint8_t reset_counter = 0;  ///< kReserveResets: counters up to this one may be used before the next request
};

struct StorageReply {
  std::uint32_t ticket = 0;
  bool ok = false;
};

/// Two small text files in a folder, each replaced whole (written beside, synchronised, renamed), so that a power cut
/// leaves the old or the new one. An empty folder name keeps nothing: saving then fails and says so on the bus.
class Storage {
 public:
  explicit Storage(std::string folder) : folder_(std::move(folder)) {}
  ~Storage();
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;

  /// Reads what was kept. A missing file is no error, and a damaged one costs what is damaged in it, with a warning
  /// that names file and line; without a readable counter it begins anywhere. Blocks, allocates. Error: the folder is
  /// not there, cannot be written, or another process uses it (until the end of this one).
  rt::Result<StoredState> load(const ParameterValues& defaults);
  /// The same without the lock, to look at.
  StoredState peek(const ParameterValues& defaults) const;

  /// Link thread. False: too many requests wait.
  bool request(const StorageRequest& request) { return requests_.try_push(request); }
  /// Link thread.
  bool reply(StorageReply* reply) { return replies_.try_pop(reply); }
  /// A thread that may block: does what was requested. Call it some ten times a second.
  void serve();
  /// The last failure of serve(), for the log; called on serve's thread.
  const std::string& last_error() const { return last_error_; }

 private:
  rt::Result<void> replace(const std::string& name, const std::string& text) const;

  std::string folder_;
  int lock_fd_ = -1;  ///< holds the folder's lock
  std::string last_error_;
  rt::SpscRing<StorageRequest, 8> requests_;
  rt::SpscRing<StorageReply, 8> replies_;
};

}  // namespace godwit::link
