// What the tracker saw of a frame, for whoever looks at a flight: the picture, its dynamic pixels and its features.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware_app/pipeline/frame_view.h"
#include "vo_core/image/coarse_mask.h"

namespace godwit::app {

/// The tracker's thread copies a frame only after the reader has asked for one, into memory taken beforehand. Nobody
/// waits: one flag says whose the copy is.
class LivePicture final : public FrameView {
 public:
  /// Takes and touches the memory. Pictures of more pixels than kMostPixels are told thinned.
  LivePicture(int width, int height);

  /// Tracker's thread. Unasked it costs a look at the flag. No allocation, no lock, no wait.
  void look(const rt::FrameMeta& frame, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
            std::span<const vo::FrameFeature> features) override;

  /// One other thread. Appends what the tracker copied since the last call as a line {"picture":{..}} with its end
  /// (docs/live.md), and asks for the next. False: nothing came, or it is old: nobody has looked for long.
  bool add_line(rt::TimeNs now_ns, std::string* out);

  static constexpr int kMostPixels = 370'000;

 private:
  struct Feature {
    float x = 0, y = 0;
    std::int8_t level = 0;
    char kind = 'c';
  };

  const int step_;  ///< every step-th row and column is told
  const int width_, height_;
  /// Reader -> tracker: true, and the copy is the tracker's to write. Tracker -> reader: false, and it is the reader's
  /// to read. Each side's release store ends its use of the copy, the other's acquire load begins its own; without them
  /// the reader could tell half of a picture that is still being written.
  std::atomic<bool> wanted_{false};
  bool asked_ = false;  ///< the reader's alone
  rt::FrameMeta meta_;
  std::vector<std::uint8_t> grey_;
  vo::CoarseMask mask_;
  std::size_t feature_count_ = 0;
  std::array<Feature, vo::kMaxFrameFeatures> features_{};
};

}  // namespace godwit::app
