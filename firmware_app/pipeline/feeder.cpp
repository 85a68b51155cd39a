#include "firmware_app/pipeline/feeder.h"

#include "firmware_app/pipeline/stage.h"

namespace godwit::app {

Feeder::Outcome Feeder::read(int slot, rt::TimeNs timeout_ns, rt::FrameHandle* handle, FrameRecord* record) {
  hal::CapturedFrame frame;
  const rt::MutableImageView grey = slot >= 0 ? pool_->grey(slot) : rt::MutableImageView{};
  std::uint8_t* const bgr = slot >= 0 ? pool_->bgr(slot) : nullptr;
  const hal::CameraStatus status = camera_->next(grey, bgr, timeout_ns, &frame, &why_);
  if (status == hal::CameraStatus::kFrame && slot >= 0) {
    pool_->meta(slot) = {frame.t_capture_ns, frame.t_source_ns, frame.sequence};
    pool_->hand_out(slot, kFrameReaders);
    *handle = {slot, pool_->meta(slot)};
    return Outcome::kFrame;
  }
  if (slot >= 0) pool_->cancel(slot);
  if (status == hal::CameraStatus::kEnd) return Outcome::kEnd;
  if (status == hal::CameraStatus::kTimeout) return Outcome::kNothing;
  *record = {};
  record->sequence = frame.sequence;
  record->t_source_ns = frame.t_source_ns;
  record->t_capture_ns = frame.t_capture_ns;
  if (status == hal::CameraStatus::kBadFrame) {
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
