#include "firmware_app/dynamic/dynamic_masks.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

namespace godwit::app {
namespace {

/// Boxes are followed by the picture inside them, and detections come several times a second: little is unknown of
/// where they are. Where people cover most of the picture every free pixel counts.
detector::CarrierLimits carrier_limits() {
  detector::CarrierLimits out;
  out.growth_per_s = 0.1F;
  return out;
}
detector::MaskMargin mask_margin() {
  detector::MaskMargin out;
  out.share = 0.02F;
  return out;
}

/// The network tells of what it is unsure of, too: which of that counts is settled where it is known what was there.
detector::DetectorOptions down_to_unsure(const DynamicMasksOptions& options) {
  detector::DetectorOptions out = options.detector;
  out.decode.score_threshold = std::min(out.decode.score_threshold, options.hold_score);
  return out;
}
detector::HoldLimits hold_limits(const DynamicMasksOptions& options, const rt::FramePool& pool) {
  detector::HoldLimits out;
  out.width = pool.layout().width;
  out.sure_score = options.detector.decode.score_threshold;
  if (options.hold_score >= out.sure_score) out.detections = 0;
  return out;
}

/// By class: may be parked. Vehicles by COCO's and VisDrone's names; nobody else is, least of all people, whatever a
/// network calls them: who stands goes on in a moment.
std::vector<bool> may_park(const std::vector<std::string>& classes) {
  constexpr std::array<std::string_view, 6> kVehicles = {"bicycle", "car", "motorcycle", "bus", "truck", "van"};
  std::vector<bool> out;
  out.reserve(classes.size());
  for (const std::string& name : classes)
    out.push_back(std::find(kVehicles.begin(), kVehicles.end(), name) != kVehicles.end());
  return out;
}

}  // namespace

rt::Result<std::unique_ptr<DynamicMasks>> DynamicMasks::open(const DynamicMasksOptions& options,
                                                             const vo::CameraModel& camera, const rt::FramePool* pool) {
  const detector::DetectorOptions unsure = down_to_unsure(options);
  auto large = detector::Detector::open(options.model, unsure);
  if (!large) return large.error();
  std::unique_ptr<detector::Detector> small;
  if (!options.small_model.empty()) {
    auto opened = detector::Detector::open(options.small_model, unsure);
    if (!opened) return opened.error();
    if (opened.value().info().classes != large.value().info().classes)
      return rt::Error{options.small_model + ": its classes are not those of " + options.model};
    small = std::make_unique<detector::Detector>(std::move(opened).value());
  }
  return std::unique_ptr<DynamicMasks>(
      new DynamicMasks(options, camera, pool, std::move(large).value(), std::move(small)));
}

DynamicMasks::DynamicMasks(const DynamicMasksOptions& options, const vo::CameraModel& camera, const rt::FramePool* pool,
                           detector::Detector large, std::unique_ptr<detector::Detector> small)
    : options_(options),
      pool_(pool),
      large_(std::move(large)),
      small_(std::move(small)),
      carrier_(pool->layout().width, pool->layout().height, carrier_limits()),
      hold_(hold_limits(options, *pool)),
      mask_(pool->layout().width, pool->layout().height, rt::kPyramidLevels, mask_margin()),
      late_mask_(pool->layout().width, pool->layout().height, rt::kPyramidLevels, mask_margin()),
      motion_(pool->layout().width, pool->layout().height),
      turn_(camera),
      parked_(camera, may_park(large_.info().classes)) {
  for (std::size_t i = 0; i < large_.info().classes.size(); ++i)
    movable_.push_back(large_.movable(static_cast<int>(i)));
}

std::string DynamicMasks::warning() const {
  return large_.warning();
}

bool DynamicMasks::detect(const DetectorJob& job) {
  const rt::ImageView grey = pool_->grey(job.frame.slot);
  detector::PictureView picture{grey.data, grey.width, grey.height, grey.stride, 1};
  if (const std::uint8_t* bgr = pool_->bgr(job.frame.slot)) picture = {bgr, grey.width, grey.height, grey.width * 3, 3};
  const bool use_small = small_ != nullptr && job.input_px < input_px();
  detector::Detector& network = use_small ? *small_ : large_;
  if (!network.detect(picture, &found_.boxes)) return false;
  // Only what may move goes on: the rest would take the place of it.
  int kept = 0;
  for (const detector::Box& box : found_.boxes.view())
    if (network.movable(box.class_id)) found_.boxes.box[kept++] = box;
  found_.boxes.count = kept;
  found_.t_capture_ns = job.frame.meta.t_capture_ns;
  detections_.write(found_);
  return true;
}

rt::MaskPyramidView DynamicMasks::mask_for(const rt::FrameMeta& frame, const rt::ImageView& grey) {
  if (t_first_ns_ == 0) t_first_ns_ = frame.t_capture_ns;
  carrier_.advance(frame.t_capture_ns, motion_.next(grey, carrier_.followed()), turn_.next(frame.t_capture_ns));
  parked_.note_boxes(frame.t_capture_ns, carrier_.boxes());
  t_detection_ns_ = 0;
  if (detections_.read(&newest_)) {
    t_detection_ns_ = newest_.t_capture_ns;
    // By now its picture's boxes may be known from a newer detection than when that picture came.
    std::span<const detector::Box> before;
    if (carrier_.boxes_at(newest_.t_capture_ns, &before)) parked_.correct_boxes(newest_.t_capture_ns, before);
    detector::hold(before, newest_.t_capture_ns - t_held_ns_, hold_, &newest_.boxes);
    parked_.take_detection(newest_.t_capture_ns, newest_.boxes.view());
    if (carrier_.replace(newest_.t_capture_ns, newest_.boxes.view())) {
      have_mask_ = true;
      t_held_ns_ = newest_.t_capture_ns;
      t_taken_ns_ = frame.t_capture_ns;
    }
  }
  if (!have_mask_ && frame.t_capture_ns - t_first_ns_ < options_.first_mask_ns) {
    const std::array<detector::Box, 1> all{
        detector::Box{0.F, 0.F, static_cast<float>(grey.width), static_cast<float>(grey.height), 1.F, -1}};
    mask_.update(all, movable_);
    return mask_.view();
  }
  mask_.update(moving(carrier_.boxes()), movable_);
  return mask_.view();
}

std::span<const detector::Box> DynamicMasks::moving(std::span<const detector::Box> boxes) {
  moving_.clear();
  for (const detector::Box& box : boxes)
    if (!parked_.parked(box.track)) moving_.push(box);
  return std::as_const(moving_).view();
}

rt::TimeNs DynamicMasks::late_mask(rt::TimeNs t_capture_ns, rt::TimeNs known_ns, rt::MaskPyramidView* mask) {
  // From the frame with which the detection came in on, masks were made with it.
  std::span<const detector::Box> boxes;
  if (!have_mask_ || t_held_ns_ <= known_ns || t_capture_ns >= t_taken_ns_ || !carrier_.boxes_at(t_capture_ns, &boxes))
    return known_ns;
  late_mask_.update(moving(boxes), movable_);
  *mask = late_mask_.view();
  return t_held_ns_;
}

}  // namespace godwit::app
