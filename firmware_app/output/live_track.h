// Where the camera was since its frame began, for whoever looks at a flight: so many places at most.
#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

#include "firmware_app/pipeline/frame_record.h"

namespace godwit::app {

/// frame() is the collector's, add_line() one other thread's. Of fixed size: where it is full, every second place goes.
class LiveTrack {
 public:
  static constexpr std::size_t kPlaces = 1200;

  LiveTrack() { places_.reserve(kPlaces); }

  /// A frame that is given in other coordinates than the last, another map or navigation frame, begins the track anew.
  void frame(const FrameRecord& record) noexcept;

  /// Appends {"track":{..}} with its end (docs/live.md), once a second.
  void add_line(rt::TimeNs now_ns, std::string* out);

 private:
  std::mutex mutex_;
  std::vector<std::array<float, 3>> places_;
  std::array<float, 3> newest_{};  ///< which may not be kept
  bool metric_ = false, any_ = false;
  std::uint32_t number_ = 0;            ///< of the map, or metric: of the navigation frame
  std::uint64_t every_ = 1, seen_ = 0;  ///< every so many-th is kept
  rt::TimeNs t_next_ns_ = 0;            ///< the other thread's alone
};

}  // namespace godwit::app
