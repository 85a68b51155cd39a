#include "firmware_app/output/live_picture.h"

#include <algorithm>
#include <cstring>
#include <fmt/format.h>
#include <iterator>

#include "firmware_app/output/base64.h"

namespace godwit::app {
namespace {

/// What was copied for somebody who has gone is not told to the next.
constexpr rt::TimeNs kOldNs = 2 * rt::kNsPerSecond;

int step_of(int width, int height) {
  int step = 1;
  while ((width / step) * (height / step) > LivePicture::kMostPixels) ++step;
  return step;
}

/// Lengths of runs, row after row: free, masked, free, ...
void add_runs(const vo::CoarseMask& mask, std::string* out) {
  bool masked = false;
  int length = 0;
  const char* comma = "";
  const auto put = [&] {
    fmt::format_to(std::back_inserter(*out), "{}{}", comma, length);
    comma = ",";
  };
  for (int i = 0; i < mask.columns * mask.rows; ++i) {
    if ((mask.cell[i] != 0) != masked) {
      put();
      masked = !masked;
      length = 0;
    }
    ++length;
  }
  put();
}

}  // namespace

LivePicture::LivePicture(int width, int height)
    : step_(step_of(width, height)), width_(width / step_), height_(height / step_), grey_(width_ * height_) {
  mask_.cell.fill(0);
}

void LivePicture::look(const rt::FrameMeta& frame, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
                       std::span<const vo::FrameFeature> features) {
  if (!wanted_.load(std::memory_order_acquire)) return;
  meta_ = frame;
  const std::size_t width = width_;
  for (int y = 0; y < std::min(height_, grey.height / step_); ++y) {
    std::uint8_t* const to = grey_.data() + y * width;
    const std::uint8_t* const from = grey.row(y * step_);
    if (step_ == 1) {
      std::memcpy(to, from, width);
    } else if (step_ == 2) {  // known to the compiler, which then takes many at a time
      for (int x = 0; x < width_; ++x) to[x] = from[2 * x];
    } else {
      for (int x = 0; x < width_; ++x) to[x] = from[static_cast<std::ptrdiff_t>(x) * step_];
    }
  }
  mask_.assign(mask);
  feature_count_ = std::min(features.size(), features_.size());
  for (std::size_t i = 0; i < feature_count_; ++i) {
    const vo::FrameFeature& f = features[i];
    const char kind = f.shaded ? 's' : f.type == vo::FeatureType::kCorner ? 'c' : 'e';
    features_[i] = {f.px.x(), f.px.y(), f.level, kind};
  }
  wanted_.store(false, std::memory_order_release);
}

bool LivePicture::add_line(rt::TimeNs now_ns, std::string* out) {
  if (wanted_.load(std::memory_order_acquire)) return false;
  const bool told = asked_ && now_ns - meta_.t_delivered_ns < kOldNs;
  if (told) {
    const auto to = std::back_inserter(*out);
    fmt::format_to(to, R"({{"picture":{{"sequence":{},"t_capture_ns":{},"width":{},"height":{},"step":{},"features":[)",
                   meta_.sequence, meta_.t_capture_ns, width_, height_, step_);
    for (std::size_t i = 0; i < feature_count_; ++i) {
      const Feature& f = features_[i];
      fmt::format_to(to, R"({}[{:.1f},{:.1f},{},"{}"])", i == 0 ? "" : ",", f.x, f.y, f.level, f.kind);
    }
    fmt::format_to(to, R"(],"mask":{{"columns":{},"rows":{},"runs":[)", mask_.columns, mask_.rows);
    add_runs(mask_, out);
    *out += R"(]},"grey":")";
    append_base64(grey_, out);
    *out += "\"}}\n";
  }
  asked_ = true;
  wanted_.store(true, std::memory_order_release);
  return told;
}

}  // namespace godwit::app
