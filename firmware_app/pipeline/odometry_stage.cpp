#include "firmware_app/pipeline/odometry_stage.h"

#include <algorithm>

#include "firmware_app/pipeline/aided_poses.h"
#include "firmware_app/pipeline/earth_poses.h"
#include "firmware_app/pipeline/inertial_poses.h"
#include "firmware_app/pipeline/mask_exchange.h"
#include "hal/rt/spsc_ring.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {
namespace {

template <typename Item, std::size_t kItems>
constexpr int item_count(const vo::ExchangeRing<Item, kItems>*) {
  return static_cast<int>(kItems);
}
/// Messages that fit between tracker and mapper.
constexpr int kMessages = item_count(static_cast<decltype(vo::MapChannel::messages)*>(nullptr));

/// Slots beside the keyframes': those of keyframes that the mapper has forgotten and the tracker not yet, the messages
/// under way, the first view, the last frame, the one in work and the one being read. The one that was followed before
/// a guess takes a message's: until the guess is confirmed none is sent.
constexpr int kSlotsBesideKeyframes = 4 + kMessages + 4;
constexpr int kFewestKeyframes = 8;
/// Views of the initialisation where movers must be found by geometry alone. On fr1_xyz with walkers 4 views bend the
/// first four seconds (ATE 0.036 m), 8 to 16 do not (0.004 to 0.005).
constexpr int kGatedViews = 8;

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
        mapper_(std::make_unique<vo::Mapper>(camera_, mapper_options(options, keyframe_slots(*pool)), channel_.get())),
        exchange_(masks, tracker_.get()),
        gyro_helps_(options.gyro_helps),
        // Rows are read on both sides of the capture time; the sensor's clock may be ahead.
        read_after_ns_(std::llround((0.5 * options.readout_s + std::max(0.0, options.inertial_time_offset_s)) * 1e9)) {
    if (options.inertial_T_body_cam) {
      inertial_ = std::make_unique<InertialPoses>(*options.inertial_T_body_cam, options.coast_ns,
                                                  options.inertial_time_offset_s, options.inertial_errors,
                                                  std::llround(options.readout_s * 1e9));
    } else if (options.aided_T_body_cam) {
      aided_ = std::make_unique<AidedPoses>(*options.aided_T_body_cam);
    }
    if (options.starting_height_m > 0 && inertial_ != nullptr) inertial_->starts_at_height(options.starting_height_m);
    if (options.starting_height_m > 0 && aided_ != nullptr) aided_->starts_at_height(options.starting_height_m);
  }

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
      exchange_.purge_movers(frame.meta.t_capture_ns);
    }
    input.feature_share = feature_share_;
    if (inertial_ != nullptr && gyro_helps_) input.rotation = inertial_->turn_since_last(frame.meta.t_capture_ns);
    if (inertial_ != nullptr && gyro_helps_) input.shake = inertial_->shake(frame.meta.t_capture_ns);
    if (inertial_ != nullptr) input.expected = inertial_->expected(frame.meta.t_capture_ns);
    const vo::FrameResult result = tracker_->track(input);
    if (view_ != nullptr) look(frame.meta, input, result, record);
    if (masks_ != nullptr) exchange_.frame_done(frame.meta.t_capture_ns, result);
    fill(result, record);
    order_.room = result.order.room;
    order_.deltas = result.order.deltas;
    order_.feature_share = input.feature_share;
    order_.t_detection_ns = masks_ != nullptr ? masks_->t_detection_ns() : 0;
    ++order_.number;
    record->order = order_;
    take_mapping(&record->mapping);
    if (inertial_ != nullptr) inertial_->make_metric(result, frame.meta.t_capture_ns, record);
    if (aided_ != nullptr) aided_->make_metric(result, frame.meta.t_capture_ns, record);
    earth_.tell(record);
    vo::SlotRelease release;
    while (tracker_->take_release(&release)) tracker_return_.give_back(release.slot, release.count);
  }

  rt::TimeNs read_after_ns() const override { return read_after_ns_; }

  void take_imu(const hal::ImuSample& sample) override {
    ++order_.readings;
    order_.t_reading_ns = sample.t_ns;
    if (inertial_ != nullptr) inertial_->take(sample);
  }

  void take_aid(const hal::AidSample& sample) override {
    if (inertial_ != nullptr) inertial_->take(sample);
    if (aided_ != nullptr) aided_->take(sample);
    earth_.take(sample);
  }

  void limit_features(double share) override { feature_share_ = share; }

  void expect(const FlownOrder& order) override {
    tracker_->expect({order.room, order.deltas});
    feature_share_ = order.feature_share;
  }

  int mapper_backlog() const override { return kMessages - static_cast<int>(channel_->messages.free_items()); }

  bool map_step() override {
    const bool worked = mapper_->step();
    if (worked) tell_mapping();
    vo::SlotRelease release;
    while (mapper_->take_release(&release)) mapper_return_.give_back(release.slot, release.count);
    return worked;
  }

 private:
  static int keyframe_slots(const rt::FramePool& pool) {
    const bool with_detector = pool.layout().readers == kFrameReadersWithDetector;
    return pool.slots() - kSlotsBesideKeyframes - (with_detector ? kDetectorSlots : 0) -
           (pool.layout().onlooker ? kOnlookerSlots : 0);
  }

  static vo::MapperOptions mapper_options(const OdometryOptions& options, int keyframe_slots) {
    vo::MapperOptions out;
    // Fewer slots than wanted: fewer keyframes, or in time they would hold every slot.
    out.max_keyframes = std::min(out.max_keyframes, keyframe_slots);
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

  void look(const rt::FrameMeta& meta, const vo::FrameInput& input, const vo::FrameResult& result,
            FrameRecord* record) {
    const rt::TimeNs wall = rt::monotonic_now_ns(), cpu = rt::thread_cpu_now_ns();
    view_->look(meta, input.grey, input.mask,
                result.tracked ? tracker_->features() : std::span<const vo::FrameFeature>());
    if (view_->counts()) return;
    record->view_ns = rt::monotonic_now_ns() - wall;
    record->view_cpu_ns = rt::thread_cpu_now_ns() - cpu;
  }

  static void fill(const vo::FrameResult& result, FrameRecord* record) {
    record->fate = FrameFate::kProcessed;
    record->tracked = result.tracked;
    record->has_pose = result.tracked || result.state == vo::State::kCoasting;
    record->repeated = result.repeated;
    record->is_keyframe = result.is_keyframe;
    record->keyframe_reason = vo::keyframe_reason_name(result.keyframe_reason);
    record->map_moved = result.map_moved;
    Eigen::Map<Eigen::Vector3d>(record->moved_by.data()) = result.moved_by;
    Eigen::Map<Eigen::Vector3d>(record->turned_by.data()) = result.turned_by;
    record->map_id = result.map_id;
    record->features = result.measurements;
    record->state = result.state;
    const vo::StageTimes& t = result.times;
    record->stage_ns = {t.pyramid, t.apply, t.initialise, t.align, t.reproject, t.pose, t.keyframe, 0};
    record->why = {result.reason, result.reason_value, result.reason_limit};
    if (result.reason[0] != '\0')
      record->reason.assign_measured(result.reason, result.reason_value, result.reason_limit);
    if (!record->has_pose) return;
    fill_pose(result.T_world_cam, &record->t_world_cam, &record->q_world_cam);
    record->covariance = upper_triangle(result.covariance);
    record->own_covariance = upper_triangle(result.own_covariance);
    record->median_depth = result.median_depth;
    const vo::RelativePose& relative = result.relative;
    record->reference_id = relative.keyframe_id;
    record->t_reference_ns = relative.t_keyframe_ns;
    fill_pose(relative.T_ref_cam, &record->t_ref_cam, &record->q_ref_cam);
    record->reference_covariance = upper_triangle(relative.covariance);
  }

  static void fill_pose(const vo::SE3& T, std::array<double, 3>* t, std::array<double, 4>* q) {
    Eigen::Map<Eigen::Vector3d>(t->data()) = T.t;
    Eigen::Map<Eigen::Vector4d>(q->data()) = T.quaternion().coeffs();
  }

  static std::array<double, 21> upper_triangle(const vo::Mat6& C) {
    std::array<double, 21> out;
    std::size_t k = 0;
    for (int row = 0; row < 6; ++row)
      for (int column = row; column < 6; ++column) out[k++] = C(row, column);
    return out;
  }

  // Mapper thread. The tracker's half is take_mapping. What finds no room is dropped and missing in the log only.
  void tell_mapping() { reports_.try_push(mapper_->report()); }

  // Tracker thread. All that came back since the last frame, as one.
  void take_mapping(MappingRecord* out) {
    vo::MapperReport r;
    for (std::size_t i = 0; i < kReports && reports_.try_pop(&r); ++i) {
      ++out->messages;
      out->seeds_updated += r.seeds_updated;
      out->points_new += r.points_new;
      out->seeds = r.seeds;
      out->keyframes = r.keyframes;
      out->points = r.points;
      const vo::BundleReport& b = r.bundle;
      if (b.iterations == 0) continue;
      ++out->adjustments;
      out->free_keyframes = b.free_keyframes;
      out->fixed_keyframes = b.fixed_keyframes;
      out->adjusted_points = b.points;
      out->observations = b.observations;
      out->iterations = b.iterations;
      out->outliers = b.outliers;
      out->rms_before_px = b.rms_before_px;
      out->rms_after_px = b.rms_after_px;
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
  static constexpr std::size_t kReports = 16;  ///< more than there are messages
  rt::SpscRing<vo::MapperReport, kReports> reports_;
  // Tracker's own.
  MaskExchange exchange_;  ///< used only with masks
  const bool gyro_helps_;
  const rt::TimeNs read_after_ns_;
  std::unique_ptr<InertialPoses> inertial_;  ///< null: no inertial sensor is flown by
  std::unique_ptr<AidedPoses> aided_;        ///< null: that one is, or nobody else's attitude is used
  EarthPoses earth_;
  double feature_share_ = 1.0;
  FlownOrder order_;  ///< of the last frame, and the readings since
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
