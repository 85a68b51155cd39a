#include "firmware_app/pipeline/feeder.h"

#include <algorithm>

#include "firmware_app/pipeline/stage.h"

namespace godwit::app {
namespace {
/// Clocks that are set against each other differ by less.
constexpr rt::TimeNs kFutureNs = 5 * rt::kNsPerMs;
/// A picture that is older on arrival is of no use to a pilot.
constexpr rt::TimeNs kOldNs = rt::kNsPerSecond;

int whole_ms(rt::TimeNs t) {
  return static_cast<int>(std::clamp<rt::TimeNs>(t / rt::kNsPerMs, 0, 1'000'000'000));
}
}  // namespace

bool Feeder::implausible(rt::TimeNs t_capture_ns, ShortText* why) {
  if (!live_) return false;
  const rt::TimeNs now = rt::monotonic_now_ns();
  if (t_capture_ns > now + kFutureNs) {
    why->assign_measured("camera clock: the capture time lies in the future [ms], allowed",
                         whole_ms(t_capture_ns - now), whole_ms(kFutureNs));
    return true;
  }
  if (t_capture_ns < now - kOldNs) {
    why->assign_measured("camera clock: the picture is old on arrival [ms], allowed", whole_ms(now - t_capture_ns),
                         whole_ms(kOldNs));
    return true;
  }
  if (t_capture_ns <= t_last_ns_) {
    why->assign("camera clock: the capture time did not advance");
    return true;
  }
  t_last_ns_ = t_capture_ns;
  return false;
}

Feeder::Outcome Feeder::read(int slot, rt::TimeNs timeout_ns, rt::FrameHandle* handle, FrameRecord* record) {
  hal::CapturedFrame frame;
  const rt::MutableImageView grey = slot >= 0 ? pool_->grey(slot) : rt::MutableImageView{};
  std::uint8_t* const bgr = slot >= 0 ? pool_->bgr(slot) : nullptr;
  const hal::CameraStatus status = camera_->next(grey, bgr, timeout_ns, &frame, &why_);
  ShortText clock;
  const rt::TimeNs t_delivered_ns = rt::monotonic_now_ns();
  const bool wrong_time = status == hal::CameraStatus::kFrame && implausible(frame.t_capture_ns, &clock);
  if (status == hal::CameraStatus::kFrame && slot >= 0 && !wrong_time) {
    pool_->meta(slot) = {frame.t_capture_ns, frame.t_source_ns, frame.sequence, t_delivered_ns};
    *handle = {slot, pool_->meta(slot)};
    const bool shown = onlooker_ != nullptr && onlooker_->has_room(live_);
    pool_->hand_out(slot, pool_->layout().readers + (shown ? 1 : 0));
    if (shown) onlooker_->show(*handle);
    return Outcome::kFrame;
  }
  if (slot >= 0) pool_->cancel(slot);
  if (status == hal::CameraStatus::kEnd) return Outcome::kEnd;
  if (status == hal::CameraStatus::kTimeout) return Outcome::kNothing;
  *record = {};
  record->sequence = frame.sequence;
  record->t_source_ns = frame.t_source_ns;
  record->t_capture_ns = frame.t_capture_ns;
  if (wrong_time) {
    record->fate = FrameFate::kBadPicture;
    record->reason = clock;
  } else if (status == hal::CameraStatus::kBadFrame) {
    record->fate = FrameFate::kBadPicture;
    record->reason.assign(why_);
  } else {
    pool_->count_drop();
    record->fate = FrameFate::kDroppedSlots;
    record->reason.assign("no frame slot was free");
  }
  return Outcome::kNoFrame;
}

}  // namespace godwit::app
