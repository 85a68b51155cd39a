// What is said in words to the pilot (STATUSTEXT, LogMessage), and when: each change of state, the latency once a
// minute and when it grows.
#pragma once

#include <array>
#include <optional>
#include <string_view>

#include "firmware_app/link/latency.h"
#include "firmware_app/link/mavlink/messages.h"
#include "firmware_app/link/pose_sample.h"

namespace godwit::link {

/// One line, cut at the 50 characters of STATUSTEXT.
struct StatusLine {
  mavlink::StatusText::Severity severity = mavlink::StatusText::kInfo;
  std::array<char, 51> text{};
  std::string_view view() const { return text.data(); }
};

/// One thread; time is an argument; no allocation.
class StatusTexts {
 public:
  /// The line for the newest pose's state, where it is another than the one told; at most two a second. usable: its
  /// quality is above 0; stalled: no pose comes any more.
  std::optional<StatusLine> of_state(PoseState state, bool usable, bool stalled, rt::TimeNs now_ns);
  static StatusLine of_origin(bool sent);
  /// The latency's line where one is due. synchronised: by TIMESYNC; without it the way there is not in it.
  std::optional<StatusLine> of_latency(const LatencySummary& latency, bool synchronised, rt::TimeNs now_ns);

 private:
  PoseState told_state_ = PoseState::kInitialising;
  bool told_usable_ = false;
  rt::TimeNs t_told_ns_ = 0;
  bool told_growth_ = false;
  rt::TimeNs t_next_latency_ns_ = 0;
};

}  // namespace godwit::link
