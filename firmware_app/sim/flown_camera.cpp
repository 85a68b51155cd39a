#include "firmware_app/sim/flown_camera.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <thread>

#include "firmware_app/output/progress_bar.h"
#include "firmware_app/sim/flight_writer.h"
#include "firmware_app/sim/picture_memory.h"

namespace godwit::app {

FlownCamera::FlownCamera(const sim::Flight& flight, const FlownCameraOptions& options)
    : camera_(flight.camera(0)),
      real_pace_(options.real_pace),
      read_after_ns_(std::llround(0.5e9 * flight.scenario().camera.rig.readout_s)),
      time_(options.time) {
  first_ = static_cast<int>(std::min<std::int64_t>(options.start, camera_->frames()));
  left_ = camera_->frames() - first_;
  if (options.frames > 0) left_ = static_cast<int>(std::min<std::int64_t>(options.frames, left_));
  camera_->skip_to(first_);
  if (options.truth_masks) masks_ = std::make_unique<TruthMasks>(width(), height());
  boxes_ = boxes_head();
}

rt::Result<void> FlownCamera::render_ahead(const std::atomic<bool>& stop) {
  if (const auto room = room_for_pictures(left_, width(), height()); !room) {
    return rt::Error{"--render-ahead: " + room.error().message + "; fly fewer with --frames"};
  }
  const std::size_t bytes = width() * height();
  ahead_.resize(left_);
  ProgressBar bar(left_);
  for (std::size_t i = 0; i < ahead_.size(); ++i) {
    if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted; nothing was written"};
    Drawn& drawn = ahead_[i];
    drawn.pixels = std::make_unique<std::uint8_t[]>(bytes);
    draw({drawn.pixels.get(), width(), height(), width()}, &drawn);
    bar.show(static_cast<std::int64_t>(i) + 1, "rendering");
  }
  return {};
}

void FlownCamera::draw(const rt::MutableImageView& grey, Drawn* drawn) {
  drawn->status = camera_->next(grey, nullptr, 0, &drawn->frame, &drawn->why);
  drawn->frame.sequence -= static_cast<std::uint32_t>(first_);
  if (drawn->status == hal::CameraStatus::kFrame && grey.data != nullptr) drawn->boxes = camera_->scene().boxes();
}

void FlownCamera::fetch(const rt::MutableImageView& grey, Drawn* drawn) {
  *drawn = std::move(ahead_[next_ahead_++]);
  if (drawn->status != hal::CameraStatus::kFrame || grey.data == nullptr) return;
  const std::size_t row_bytes = width();
  for (int y = 0; y < height(); ++y) {
    std::memcpy(grey.row(y), drawn->pixels.get() + y * row_bytes, row_bytes);
  }
}

hal::CameraStatus FlownCamera::next(const rt::MutableImageView& grey, std::uint8_t* /*bgr*/, rt::TimeNs /*timeout_ns*/,
                                    hal::CapturedFrame* frame, std::string* why) {
  if (left_ == 0) return hal::CameraStatus::kEnd;
  --left_;
  Drawn drawn;
  if (ahead_.empty()) {
    draw(grey, &drawn);
  } else {
    fetch(grey, &drawn);
  }
  *frame = drawn.frame;
  if (why != nullptr) *why = drawn.why;
  if (drawn.status == hal::CameraStatus::kFrame && grey.data != nullptr) {
    boxes_ += boxes_lines(drawn.boxes, frame->t_source_ns);
    if (masks_ != nullptr) masks_->put(frame->sequence, drawn.boxes);
  }
  if (real_pace_) {
    // The picture was drawn before its time; it is there when its last row was read, on the clock that began with the
    // first.
    if (start_ns_ == 0) start_ns_ = rt::monotonic_now_ns() - frame->t_source_ns;
    frame->t_capture_ns = start_ns_ + frame->t_source_ns;
  }
  if (time_ != nullptr && !time_->offset_ns()) time_->pin(frame->t_source_ns, frame->t_capture_ns);
  if (real_pace_) {
    const rt::TimeNs wait = frame->t_capture_ns + read_after_ns_ - rt::monotonic_now_ns();
    if (wait > 0) std::this_thread::sleep_for(std::chrono::nanoseconds(wait));
  }
  return drawn.status;
}

}  // namespace godwit::app
