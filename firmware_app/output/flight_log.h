// The flight log: every frame, what the mapper did, every event and the machine's temperature, in ULog files of a
// folder.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "firmware_app/link/link_node.h"
#include "firmware_app/output/disc_room.h"
#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/frame_record.h"
#include "hal/imu/imu.h"
#include "hal/machine/machine_state.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/result.h"

namespace godwit::app {

struct FlightLogOptions {
  std::string folder;                         ///< is made if it is not there (its parent must be)
  std::size_t budget_bytes = 2'000'000'000;   ///< of all flights in the folder: older ones make way
  std::size_t file_bytes = 64'000'000;        ///< a new file is begun after so many
  std::size_t buffer_bytes = 1'000'000;       ///< what may wait for the disc
  rt::TimeNs sync_ns = rt::kNsPerSecond / 2;  ///< so often the disc is made to have what was written
  DiscRoom room;                              ///< what is left of the disc
  /// Stand in each file: version, commit, configuration.
  std::vector<std::pair<std::string, std::string>> info;
  std::vector<std::pair<std::string, double>> parameters;  ///< the same of those that are figures
  bool machine = true;                                     ///< temperature once a second
};

struct FlightLogReport {
  std::uint64_t written_bytes = 0;
  std::uint64_t dropped = 0;  ///< messages that found no room, or that the disc refused
  std::uint32_t files = 0;
  std::string trouble;  ///< the last reason why nothing could be written; empty: none
};

/// The file after this one, NNNNNN.ulg, in its folder, whether it is there or not; empty: this is no name of a file
/// that a flight log has.
std::string next_flight_file(const std::string& file);

/// Files NNNNNN.ulg, counted on from the highest number there. Each is whole in itself and ends after a whole message,
/// also where the disc was full; where the machine dies, what the disc got since the last synchronisation is at the end
/// of the file, perhaps cut. A disc that is full, or nearly, slow or gone costs messages and nothing else: they are
/// counted, it is tried again each second, and the first file after it says for how long nothing was written. Never
/// throws.
class FlightLog {
 public:
  explicit FlightLog(FlightLogOptions options);
  /// Waits a second at most for what is not yet written.
  ~FlightLog();
  FlightLog(const FlightLog&) = delete;
  FlightLog& operator=(const FlightLog&) = delete;

  /// One thread, which may allocate and lock for a moment; none of these waits for the disc.
  void frame(const FrameRecord& record) noexcept;
  void reading(const hal::ImuSample& sample) noexcept;
  void detection(const FoundBoxes& found) noexcept;
  /// Once a second is enough.
  void bus(const link::LinkStatus& status) noexcept;
  void event(const rt::LogEntry& entry) noexcept;
  void text(int level, rt::TimeNs t_ns, std::string_view line) noexcept;

  /// The flight ends here. Waits until all is on the disc, at most so long; then nothing is written any more. The same
  /// thread.
  FlightLogReport finish(rt::TimeNs patience_ns) noexcept;
  /// Any thread.
  FlightLogReport report() const noexcept;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace godwit::app
