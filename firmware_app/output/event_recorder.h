// The event recorder: the last seconds of pictures and readings, written down when something goes wrong or somebody
// asks.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "firmware_app/output/disc_room.h"
#include "firmware_app/output/event_causes.h"
#include "firmware_app/pipeline/onlooker.h"
#include "hal/camera/calibration.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"
#include "hal/rt/thread.h"

namespace godwit::app {

struct EventRecorderOptions {
  std::string folder;  ///< is made if it is not there (its parent must be)
  double before_s = 5, after_s = 3;
  std::size_t memory_bytes = 100'000'000;    ///< for pictures: where that holds fewer seconds, fewer are kept before
  std::size_t budget_bytes = 2'000'000'000;  ///< of all events in the folder: the oldest make way
  std::uint64_t most_events = 20;            ///< of one flight; what comes after is counted
  DiscRoom room;
  hal::CameraCalibration calibration;  ///< of the pictures; its fps says how many a second are to be held (0: 30)
  /// Times are moments of this machine's clock. False: nobody is late, so what is shown waits for the disc.
  bool live = true;
  bool by_signal = true;  ///< SIGUSR1, blocked in all threads (block_event_signal), asks for an event
  /// Stand in each event: version, commit, configuration.
  std::vector<std::pair<std::string, std::string>> info;
  /// What is to be told: each event, why one was not written. Any thread that may allocate and lock.
  std::function<void(const std::string&)> say;
  /// Called by finish() where the thread that copies does not end within two seconds; must not return. Null: it is
  /// waited for, since it reads the pool.
  std::function<void(const char* thread)> abandon;
};

struct EventReport {
  std::uint64_t written = 0;
  std::uint64_t failed = 0;      ///< the disc refused it
  std::uint64_t suppressed = 0;  ///< too many in the flight, or at a time
  std::uint64_t pictures_missed = 0, samples_missed = 0;
  std::string trouble;  ///< why the last one was not written; empty: none failed
};

/// A thread copies what the flight shows it into memory taken beforehand; another writes. Neither is waited for: what
/// the first has no room for is missed and counted, a disc that is full, slow or gone costs the event and nothing else.
/// The flight's slots come back within a copy's time. Never throws after start().
class EventRecorder {
 public:
  /// Takes memory and threads; the pool's layout has an onlooker. Error: no memory, no thread, pictures so large that
  /// the memory holds none of them.
  static rt::Result<std::unique_ptr<EventRecorder>> start(EventRecorderOptions options, rt::FramePool* pool);
  /// finish() without patience.
  ~EventRecorder();
  EventRecorder(const EventRecorder&) = delete;
  EventRecorder& operator=(const EventRecorder&) = delete;

  Onlooker* onlooker();
  /// "keeps 8.0 s of 640 x 480 pictures at 30 Hz in 83 MB", and what of it is less than wanted.
  std::string description() const;

  /// The sink's thread, each frame.
  void frame(const FrameRecord& record) noexcept;
  /// Any thread that may lock: what is there now, and what comes in the next seconds.
  void request(const std::string& who) noexcept;

  /// After the flight. An event whose seconds are not over ends here; waits for the disc, at most so long.
  EventReport finish(rt::TimeNs patience_ns) noexcept;
  EventReport report() const noexcept;

 private:
  struct State;
  explicit EventRecorder(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
  EventCauses causes_;
  rt::Thread copier_;
};

}  // namespace godwit::app
