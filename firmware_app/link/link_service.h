// The link with everything it needs: opens the bus or port, reads what was kept, owns the buffers between threads. What
// a command that flies creates; the link thread calls wait() and step(), a thread that may block calls serve_storage().
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "firmware_app/link/link_node.h"

namespace godwit::link {

struct LinkSettings {
  std::string can;           ///< "multicast:N" or "socketcan:IFACE"; empty: no bus
  std::string mavlink;       ///< "udp:HOST:PORT" or "serial:DEVICE:BAUD"; empty: through the tunnel on the bus
  std::string state_folder;  ///< where parameters and reset counter are kept; must exist; empty: nothing is kept
  /// Somebody calls take_input(); else nothing is collected, and of the autopilot's messages only its attitude is asked
  /// for, which the link itself reads.
  bool collect_inputs = false;
  LinkConfig link;                      ///< identity.unique_id all zeros: that of this computer
  bool wait_for_bus = false;            ///< an interface or port that is not there yet is looked for, not refused
  bool between_pictures = false;        ///< poses go out between pictures, too: somebody calls reading()
  DepartureRing* departures = nullptr;  ///< told of each pose that left; outlives the service; null: nobody measures
};

/// What is asked of the autopilot: of all that it can tell only what somebody reads.
mavlink::EndpointConfig asked_for(const LinkSettings& settings);

class LinkService {
 public:
  /// Blocks and allocates; before arming. The error names what is wrong and the remedy where there is one.
  static rt::Result<std::unique_ptr<LinkService>> open(const LinkSettings& settings);
  ~LinkService();
  LinkService(const LinkService&) = delete;
  LinkService& operator=(const LinkService&) = delete;

  /// For the log: what the user should change about the interface, found when it was opened; what was saved over the
  /// bus and is not used; what of the configuration it overrides.
  std::vector<std::string> advice() const;

  /// Tracker thread: the newest pose, and a wake-up for the link thread. No allocation, no lock, no blocking call.
  void publish(const PoseSample& sample);
  /// The same thread: it begins to work on a picture.
  void frame_begun() { node_->frame_begun(rt::monotonic_now_ns()); }
  /// The same thread: its picture was the one before, bit for bit, and the state stands.
  void picture_repeated() { node_->picture_repeated(rt::monotonic_now_ns()); }
  /// The inertial sensor's thread: the newest reading; heard where poses go out between pictures. The same rules.
  void reading(const hal::ImuSample& sample) {
    if (between_pictures_) readings_.push(sample);
  }
  /// One other thread, whoever watches the machine.
  void publish(const SystemHealth& health) { health_.write(health); }
  /// The pipeline: what the autopilot told, oldest first; false where nothing waits. Who was away for too long hears
  /// what comes from now on.
  bool take_input(AutopilotInput* input) { return link::take_input(&inputs_, input); }
  /// The same inputs, for who reads them through an adapter: the reader's side, of that one thread.
  InputRing* inputs() { return &inputs_; }
  /// A thread for log and display: the newest status; false where it has been read already.
  bool take_status(LinkStatus* status) { return status_.read(status); }

  /// Link thread: sleeps until a pose or a frame comes or silence becomes an error, at most timeout_ns (5 ms at most
  /// are wise: step() keeps time).
  void wait(rt::TimeNs timeout_ns);
  /// Link thread. No allocation, no lock, no blocking call.
  void step(rt::TimeNs now_ns) { node_->step(now_ns); }
  /// A thread that may block, some ten times a second.
  void serve_storage() { storage_.serve(); }
  /// The same thread: the last failure to keep something, empty where there was none.
  const std::string& storage_error() const { return storage_.last_error(); }

  LinkNode& node() { return *node_; }

 private:
  explicit LinkService(const LinkSettings& settings)
      : storage_(settings.state_folder), between_pictures_(settings.between_pictures) {}

  std::vector<std::string> advice_;  ///< all but the interface's
  Storage storage_;
  std::unique_ptr<hal::CanBus> bus_;
  std::unique_ptr<BytePort> bytes_;
  rt::TripleBuffer<PoseSample> poses_;
  rt::TripleBuffer<SystemHealth> health_;
  rt::TripleBuffer<LinkStatus> status_;
  InputRing inputs_;
  const bool between_pictures_;
  ReadingRing readings_;
  std::unique_ptr<LinkNode> node_;
  int wake_fd_ = -1;
};

}  // namespace godwit::link
