// What people are told of the aids on the bus: when one is heard, falls silent or cannot be used, and why.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "firmware_app/autopilot/bus_aids.h"

namespace godwit::app {

struct AidNews {
  bool warning = false;
  std::string words;
};

/// One thread, which may block.
class AidWatch {
 public:
  /// What changed since the last look.
  std::vector<AidNews> look(const BusAids& aids, rt::TimeNs now_ns);

 private:
  struct Kind {
    bool used = false;
    rt::TimeNs t_unused_ns = 0;      ///< it is heard and not used since then; 0: not
    const char* told_why = nullptr;  ///< of the last warning
  };
  std::array<Kind, hal::kAidKinds> kinds_;
};

/// A line for each kind that was heard.
std::vector<std::string> aid_report(const BusAids& aids);

/// "rangefinder", "barometer", "satellites" or "attitude".
const char* aid_words(hal::AidKind kind);

}  // namespace godwit::app
