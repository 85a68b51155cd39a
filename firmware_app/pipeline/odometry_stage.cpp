#include "firmware_app/pipeline/odometry_stage.h"

#include <algorithm>
#include <array>
#include <limits>

#include "vo_core/mapper.h"
#include "vo_core/pyramid.h"
#include "vo_core/tracker.h"

namespace godwit::app {
namespace {

template <typename Item, std::size_t kItems>
constexpr int item_count(const vo::ExchangeRing<Item, kItems>*) {
  return static_cast<int>(kItems);
}
/// Messages that fit between tracker and mapper.
constexpr int kMessages = item_count(static_cast<decltype(vo::MapChannel::messages)*>(nullptr));

/// Slots beside the keyframes': those of keyframes that the mapper has forgotten and the tracker not yet, the messages
/// under way, the first view, the last frame, the one in work and the one being read.
constexpr int kSlotsBesideKeyframes = 4 + kMessages + 4;
constexpr int kFewestKeyframes = 8;
/// Views of the initialisation where movers must be found by geometry alone. On fr1_xyz with walkers 4 views bend the
/// first four seconds (ATE 0.036 m), 8 to 16 do not (0.004 to 0.005).
constexpr int kGatedViews = 8;

/// No mask comes later than this.
constexpr rt::TimeNs kLateMaskNs = rt::kNsPerSecond;
constexpr rt::TimeNs kNoTime = std::numeric_limits<rt::TimeNs>::min();

/// A keyframe that its own detection has not come for.
struct WaitingKeyframe {
  rt::TimeNs t_ns = kNoTime;        ///< capture time; kNoTime: this place is free
  rt::TimeNs t_known_ns = kNoTime;  ///< of the picture whose detection it was last purged by
};

class OdometryStage final : public FrameStage {
 public:
  OdometryStage(const vo::CameraModel& camera, const OdometryOptions& options, rt::FramePool* pool, MaskSource* masks,
                FrameView* view)
      : camera_(camera),
        pool_(pool),
        masks_(masks),
        view_(view),
        tracker_return_(pool->reader(kTrackerReader)),
        mapper_return_(pool->reader(kMapperReader)),
        channel_(std::make_unique<vo::MapChannel>()),
        tracker_(std::make_unique<vo::Tracker>(camera_, tracker_options(options, masks != nullptr), channel_.get())),
        mapper_(std::make_unique<vo::Mapper>(camera_, mapper_options(options, pool->slots()), channel_.get())) {}

  void track(const rt::FrameHandle& frame, FrameRecord* record) override {
    vo::FrameInput input;
    input.grey = pool_->grey(frame.slot);
    input.pyramid_storage = pool_->pyramid_storage(frame.slot);
    input.pyramid_bytes = pool_->pyramid_bytes();
    input.slot = frame.slot;
    input.sequence = frame.meta.sequence;
    input.t_capture_ns = frame.meta.t_capture_ns;
    if (masks_ != nullptr) {
      input.mask = masks_->mask_for(frame.meta, input.grey);
      purge_movers(frame.meta.t_capture_ns);
    }
    input.feature_share = feature_share_;
    const vo::FrameResult result = tracker_->track(input);
    if (view_ != nullptr)
      view_->look(frame.meta, input.grey, input.mask,
                  result.tracked ? tracker_->features() : std::span<const vo::FrameFeature>());
    if (masks_ != nullptr && result.tracked) tell_masks(frame.meta.t_capture_ns, result);
    fill(result, record);
    if (result.is_keyframe) note_keyframe(input.t_capture_ns);
    vo::SlotRelease release;
    while (tracker_->take_release(&release)) tracker_return_.give_back(release.slot, release.count);
  }

  void limit_features(double share) override { feature_share_ = share; }

  int mapper_backlog() const override { return kMessages - static_cast<int>(channel_->messages.free_items()); }

  bool map_step() override {
    const bool worked = mapper_->step();
    vo::SlotRelease release;
    while (mapper_->take_release(&release)) mapper_return_.give_back(release.slot, release.count);
    return worked;
  }

 private:
  void note_keyframe(rt::TimeNs t_capture_ns) {
    const auto note = [&](rt::TimeNs t) {
      waiting_[next_waiting_] = {t, kNoTime};
      next_waiting_ = (next_waiting_ + 1) % waiting_.size();
    };
    note(t_capture_ns);
    const vo::Map& map = tracker_->map();
    if (map.keyframe_count() != 2) return;
    // A new map has two at once: the first view is a frame of long ago.
    for (int k = 0; k < vo::kMaxKeyframes; ++k)
      if (map.keyframe(k).id == 1) note(map.keyframe(k).t_capture_ns);
  }

  /// Keyframes of which more is known by now than when they were masked: by detections of earlier pictures, at last by
  /// their own. One a frame: a bound on its cost.
  void purge_movers(rt::TimeNs now_ns) {
    for (WaitingKeyframe& k : waiting_) {
      if (k.t_ns == kNoTime) continue;
      if (now_ns - k.t_ns > kLateMaskNs) {
        k.t_ns = kNoTime;
        continue;
      }
      rt::MaskPyramidView mask;
      const rt::TimeNs t_detection_ns = masks_->late_mask(k.t_ns, k.t_known_ns, &mask);
      if (t_detection_ns == k.t_known_ns) continue;
      if (tracker_->late_mask(k.t_ns, mask)) k.t_known_ns = t_detection_ns;
      if (k.t_known_ns == k.t_ns) k.t_ns = kNoTime;
      return;
    }
  }

  static vo::MapperOptions mapper_options(const OdometryOptions& options, int slots) {
    vo::MapperOptions out;
    // Fewer slots than wanted: fewer keyframes, or in time they would hold every slot.
    out.max_keyframes = std::min(out.max_keyframes, slots - kSlotsBesideKeyframes);
    out.shutter.readout_s = options.readout_s;
    return out;
  }

  static vo::TrackerOptions tracker_options(const OdometryOptions& options, bool masked) {
    vo::TrackerOptions out;
    out.delta_delay_frames = options.mapper_delay_frames;
    out.clock = &rt::monotonic_now_ns;
    out.gate.on = options.gate;
    // Without masks the first map has movers in it; over more views their points give themselves away.
    if (options.gate && !masked) out.initializer.min_views = kGatedViews;
    out.initializer.readout = options.readout_frames;
    out.shutter.readout_s = options.readout_s;
    return out;
  }

  void tell_masks(rt::TimeNs t_capture_ns, const vo::FrameResult& result) {
    TrackedFrame told;
    told.t_capture_ns = t_capture_ns;
    told.map_id = result.map_id;
    told.T_cam_world = result.T_world_cam.inverse();
    std::size_t n = 0;
    for (const vo::FrameFeature& f : tracker_->features()) {
      const vo::MapPoint* const point = f.shaded ? nullptr : tracker_->map().find(f.point);
      if (point == nullptr || n == seen_points_.size()) continue;
      seen_points_[n++] = {f.px.x(), f.px.y(), static_cast<float>((told.T_cam_world * point->p_world).norm())};
    }
    told.points = std::span(seen_points_).first(n);
    masks_->frame_tracked(told);
  }

  static void fill(const vo::FrameResult& result, FrameRecord* record) {
    record->fate = FrameFate::kProcessed;
    record->tracked = result.tracked;
    record->has_pose = result.tracked || result.state == vo::State::kCoasting;
    record->is_keyframe = result.is_keyframe;
    record->map_moved = result.map_moved;
    Eigen::Map<Eigen::Vector3d>(record->moved_by.data()) = result.moved_by;
    Eigen::Map<Eigen::Vector3d>(record->turned_by.data()) = result.turned_by;
    record->map_id = result.map_id;
    record->features = result.measurements;
    record->state = vo::state_name(result.state);
    const vo::StageTimes& t = result.times;
    record->stage_ns = {t.pyramid, t.apply, t.initialise, t.align, t.reproject, t.pose, t.keyframe, 0};
    record->why = {result.reason, result.reason_value, result.reason_limit};
    if (result.reason[0] != '\0')
      record->reason.assign_measured(result.reason, result.reason_value, result.reason_limit);
    if (!record->has_pose) return;
    const Eigen::Quaterniond q = result.T_world_cam.quaternion();
    record->q_world_cam = {q.x(), q.y(), q.z(), q.w()};
    std::size_t k = 0;
    for (int row = 0; row < 6; ++row) {
      if (row < 3) record->t_world_cam[static_cast<std::size_t>(row)] = result.T_world_cam.t[row];
      for (int column = row; column < 6; ++column) record->covariance[k++] = result.covariance(row, column);
    }
  }

  const vo::CameraModel camera_;
  rt::FramePool* pool_;
  MaskSource* masks_;  ///< null: nothing is masked
  FrameView* view_;    ///< may be null
  rt::FrameReturn tracker_return_, mapper_return_;
  std::unique_ptr<vo::MapChannel> channel_;
  std::unique_ptr<vo::Tracker> tracker_;
  std::unique_ptr<vo::Mapper> mapper_;
  // Tracker's own.
  double feature_share_ = 1.0;
  std::array<WaitingKeyframe, 16> waiting_;
  std::size_t next_waiting_ = 0;
  std::array<SeenPoint, vo::kMaxFrameFeatures> seen_points_;
};

}  // namespace

OdometryOptions odometry_options(const hal::CameraCalibration& calibration) {
  OdometryOptions out;
  out.readout_frames = calibration.readout_frames;
  out.readout_s = calibration.readout_s();
  return out;
}

rt::Result<vo::CameraModel> make_camera_model(const hal::CameraCalibration& c) {
  if (c.distortion_model == hal::CameraCalibration::Distortion::kKannalaBrandt4) {
    return vo::CameraModel::kannala_brandt(c.width, c.height, c.fx, c.fy, c.cx, c.cy,
                                           {c.distortion[0], c.distortion[1], c.distortion[2], c.distortion[3]});
  }
  return vo::CameraModel::pinhole_radtan(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.distortion);
}

std::size_t odometry_pyramid_bytes(int width, int height) {
  return vo::pyramid_bytes(width, height, rt::kPyramidLevels);
}

int odometry_frame_slots() {
  return vo::MapperOptions{}.max_keyframes + kSlotsBesideKeyframes;
}

int odometry_frame_slots_min() {
  return kFewestKeyframes + kSlotsBesideKeyframes;
}

std::unique_ptr<FrameStage> make_odometry_stage(const vo::CameraModel& camera, const OdometryOptions& options,
                                                rt::FramePool* pool, MaskSource* masks, FrameView* view) {
  return std::make_unique<OdometryStage>(camera, options, pool, masks, view);
}

}  // namespace godwit::app
