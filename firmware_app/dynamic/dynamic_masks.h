// From the detector's thread to the tracker's: boxes of what may move, carried to the present frame, as masks.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "detector/box_carrier.h"
#include "detector/box_hold.h"
#include "detector/box_mask.h"
#include "detector/detector.h"
#include "firmware_app/dynamic/box_motion.h"
#include "firmware_app/dynamic/camera_turn.h"
#include "firmware_app/dynamic/parked_boxes.h"
#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/mask_source.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"
#include "hal/rt/triple_buffer.h"

namespace godwit::app {

struct DynamicMasksOptions {
  std::string model;        ///< ONNX file with its metadata beside it
  std::string small_model;  ///< for the smaller input of the ladder; empty: the same
  /// decode.score_threshold: from there on a box stands for itself.
  detector::DetectorOptions detector;
  /// Where a thing that the edge cuts off was before, the network may be as unsure as this. Not below the former:
  /// nothing is held. Off: at 0.15 people cut off were missed 9 times instead of 20 of 220 (godwit-mask-survey, 230
  /// pictures of two walkers on tum_fr1_xyz), but the masks that are nobody grew from 10.0 to 12.2 % of the picture.
  float hold_score = 1.F;
  /// Initialisation waits so long for the first mask (docs/architecture.md): until then everything counts as dynamic.
  rt::TimeNs first_mask_ns = 200 * rt::kNsPerMs;
};

/// The paper, section 2.3.1. detect() on the detector's thread, mask_for() on the tracker's; nobody waits.
class DynamicMasks final : public MaskSource, public DetectorStage {
 public:
  /// Loads the networks and runs each once. Error: names the file and the reason. The pool outlives it; its pictures
  /// are the camera's.
  static rt::Result<std::unique_ptr<DynamicMasks>> open(const DynamicMasksOptions& options,
                                                        const vo::CameraModel& camera, const rt::FramePool* pool);

  bool detect(const DetectorJob& job) override;
  const FoundBoxes* found() const override { return &found_; }
  void give(const FoundBoxes& found) override { detections_.write(found); }
  rt::MaskPyramidView mask_for(const rt::FrameMeta& frame, const rt::ImageView& grey) override;
  void frame_tracked(const TrackedFrame& frame) override {
    parked_.note_tracked(frame);
    turn_.note_tracked(frame.t_capture_ns, frame.map_id, frame.T_cam_world);
  }

  /// Sizes of the networks' inputs (ModelInfo::square_px); the same where there is one network.
  int input_px() const { return large_.info().square_px(); }
  int small_input_px() const { return small_ != nullptr ? small_->info().square_px() : input_px(); }
  rt::TimeNs t_detection_ns() const override { return t_detection_ns_; }
  rt::TimeNs late_mask(rt::TimeNs t_capture_ns, rt::TimeNs known_ns, rt::MaskPyramidView* mask) override;

  /// What was asked for and could not be had, in words; empty if nothing.
  std::string warning() const;

 private:
  DynamicMasks(const DynamicMasksOptions& options, const vo::CameraModel& camera, const rt::FramePool* pool,
               detector::Detector large, std::unique_ptr<detector::Detector> small);

  /// Those of them that are not parked. Valid until the next call.
  std::span<const detector::Box> moving(std::span<const detector::Box> boxes);

  const DynamicMasksOptions options_;
  const rt::FramePool* pool_;
  detector::Detector large_;
  std::unique_ptr<detector::Detector> small_;
  FoundBoxes found_;  ///< detector thread's own
  rt::TripleBuffer<FoundBoxes> detections_;

  // Tracker thread's own.
  detector::BoxCarrier carrier_;
  const detector::HoldLimits hold_;
  detector::BoxMask mask_;
  detector::BoxMask late_mask_;
  BoxMotion motion_;
  CameraTurn turn_;
  ParkedBoxes parked_;
  detector::BoxList moving_;
  FoundBoxes newest_;
  std::vector<bool> movable_;
  rt::TimeNs t_first_ns_ = 0;
  rt::TimeNs t_detection_ns_ = 0;  ///< see t_detection_ns()
  bool have_mask_ = false;
  rt::TimeNs t_held_ns_ = 0;   ///< capture time of the newest picture whose detection is carried on
  rt::TimeNs t_taken_ns_ = 0;  ///< the same of the frame with which that detection came in
};

}  // namespace godwit::app
