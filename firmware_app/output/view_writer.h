// `--view DIR`: picture, mask and static features side by side, as in the paper's figure 11.
#pragma once

#include <cstdint>
#include <string>

#include "firmware_app/pipeline/frame_view.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Writes DIR/NNNNNN.png for every n-th frame: the picture; the same with its dynamic pixels in red; and with the
/// features behind its pose: corners green, edgelets yellow, those inside the mask that were seen plainly blue.
class ViewWriter final : public FrameView {
 public:
  /// Makes the folder. Error: folder, reason. `every` is at least 1.
  static rt::Result<ViewWriter> open(const std::string& folder, std::int64_t every);

  void look(const rt::FrameMeta& frame, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
            std::span<const vo::FrameFeature> features) override;
  bool counts() const override { return false; }

  std::int64_t written() const { return written_; }
  /// The first picture that could not be written, and why; empty: none.
  const std::string& error() const { return error_; }

 private:
  ViewWriter(std::string folder, std::int64_t every) : folder_(std::move(folder)), every_(every) {}

  std::string folder_;
  std::int64_t every_ = 1, seen_ = 0, written_ = 0;
  std::string error_;
};

}  // namespace godwit::app
