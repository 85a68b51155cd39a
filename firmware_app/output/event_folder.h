// An event on the disc: a folder in EuRoC's layout that `godwit replay` takes, whole or not there.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "firmware_app/output/disc_room.h"
#include "firmware_app/output/event_causes.h"
#include "hal/imu/imu.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Folders NNNNNN-KIND in `folder`, counted on from the highest number there. What is being written is called
/// NNNNNN-KIND.part. One thread, which may wait for the disc.
class EventFolders {
 public:
  struct Options {
    std::string folder;            ///< is made if it is not there (its parent must be)
    std::size_t budget_bytes = 0;  ///< of all events in it: the oldest make way
    DiscRoom room;
    std::string calibration;  ///< sensor.yaml
    /// Stand in event.json; "configuration" becomes configuration.toml.
    std::vector<std::pair<std::string, std::string>> info;
  };
  struct Event {
    std::vector<EventCause> causes;  ///< the first gives the folder its name
    std::uint64_t first = 0, end = 0;
    std::uint64_t most_bytes = 0;  ///< that the pictures may take, unpacked
    const std::vector<hal::ImuSample>* samples = nullptr;
  };
  /// The picture of this number.
  using Picture = std::function<std::pair<rt::FrameMeta, rt::ImageView>(std::uint64_t number)>;
  /// Called when it is on the disc. False: give up.
  using Done = std::function<bool(std::uint64_t number)>;

  explicit EventFolders(Options options) : options_(std::move(options)) {}
  ~EventFolders();
  EventFolders(const EventFolders&) = delete;
  EventFolders& operator=(const EventFolders&) = delete;

  /// Writes it, all of it on the disc before the folder gets its name. Error: the reason; nothing is left of it then.
  /// Returns the folder.
  rt::Result<std::string> write(const Event& event, const Picture& picture, const Done& done);

 private:
  rt::Result<void> open();
  rt::Result<void> make_room(std::uint64_t bytes);
  rt::Result<void> fill(const std::string& part, const Event& event, const Picture& picture, const Done& done);
  std::uint64_t next_number() const;

  const Options options_;
  int fd_ = -1;  ///< the folder, locked: nobody else writes there
  std::vector<std::uint8_t> packed_;
};

}  // namespace godwit::app
