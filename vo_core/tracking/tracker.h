// The tracker: a frame in, a pose out. Owns the map; never waits for the mapper.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "hal/rt/image.h"
#include "hal/rt/time.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/image/coarse_mask.h"
#include "vo_core/map/keyframe_selector.h"
#include "vo_core/map/map_channel.h"
#include "vo_core/map/pose_certainty.h"
#include "vo_core/map/slot_releases.h"
#include "vo_core/tracking/frame_noise.h"
#include "vo_core/tracking/health.h"
#include "vo_core/tracking/initializer.h"
#include "vo_core/tracking/landmark_finder.h"
#include "vo_core/tracking/motion_gate.h"
#include "vo_core/tracking/pose_optimizer.h"
#include "vo_core/tracking/relocaliser.h"
#include "vo_core/tracking/reprojector.h"
#include "vo_core/tracking/shake_fit.h"
#include "vo_core/tracking/sparse_image_align.h"

namespace godwit::vo {

/// Time of each stage of one tracking call [ns]; zero where the stage did not run or no clock was given.
struct StageTimes {
  rt::TimeNs pyramid = 0, apply = 0, initialise = 0, align = 0, reproject = 0, pose = 0, keyframe = 0;
};

/// Where a camera that has lost the map should be in it.
struct PosePrior {
  bool known = false;
  std::uint32_t map_id = 0;
  SE3 T_cam_map;
  double place_sigma = 0;     ///< [map units], root of the sum over the axes
  double turn_sigma_rad = 0;  ///< the same
};

/// What a frame finds of the mapper, which works at its own pace: all of a flight by vision that its pictures do not
/// say. The same pictures, masks and orders give the same poses to the bit, however fast the mapper is.
struct FrameOrder {
  int room = -1;    ///< messages that the mapper had room for when the frame began; -1: as it is
  int deltas = -1;  ///< deltas of the mapper that were taken before the frame; -1: as there are
};

struct FrameInput {
  rt::ImageView grey;  ///< level 0, rows aligned to rt::kRowAlignment
  std::uint8_t* pyramid_storage = nullptr;
  std::size_t pyramid_bytes = 0;
  rt::MaskPyramidView mask;  ///< dynamic pixels, or levels == 0
  int slot = -1;             ///< with two references: the tracker's and the mapper's
  std::uint32_t sequence = 0;
  rt::TimeNs t_capture_ns = 0;
  RotationPrior rotation;  ///< rotation since the last frame, from an IMU
  MeasuredShake shake;     ///< of this frame's readout, from an IMU
  PosePrior expected;      ///< by dead reckoning: where a search for the map begins
  /// Of ReprojectorOptions::max_features, 0 to 1: fewer where time is short. Twice min_measurements are always looked
  /// for.
  double feature_share = 1.0;
};

/// Some of the map's points that a picture shows, evenly taken from its features.
struct SeenPoints {
  static constexpr int kMost = 32;
  int count = 0;
  std::array<Eigen::Vector3f, kMost> at;  ///< [map units]
};

struct FrameResult {
  State state = State::kInitialising;
  bool repeated = false;     ///< the picture is the one before, bit for bit: nothing was measured
  bool tracked = false;      ///< at least min_measurements image measurements updated the pose
  bool is_keyframe = false;  ///< also of a frame between movers that does not count as tracked
  KeyframeReason keyframe_reason = KeyframeReason::kNone;  ///< why it should become one, even if it could not
  std::uint32_t map_id = 0;                                ///< counts from 1; 0 when there is no map
  int measurements = 0;                                    ///< inliers of the pose optimisation
  int matches = 0;                                         ///< aligned points
  int shaded = 0;                                          ///< of them inside the mask
  int trials = 0;                                          ///< alignments tried
  int candidates = 0;                                      ///< map points projected into the picture
  SE3 T_world_cam;                                         ///< valid when tracked
  Mat6 covariance = Mat6::Zero();      ///< of the left twist (v, w) of T_cam_world, map units and rad
  Mat6 own_covariance = Mat6::Zero();  ///< the same from this frame's noise alone, the map taken for true
  RelativePose relative;               ///< to a keyframe of the map, with its covariance
  double median_depth = 0.0;
  SeenPoints points;              ///< of a frame with a pose
  double rms_px = 0.0;            ///< of the inliers
  double misfit = 0.0;            ///< their chi-square over its limit (TrackerOptions::noise_allowance left out)
  bool map_moved = false;         ///< a delta with moved poses was applied before this frame
  Vec3 moved_by = Vec3::Zero();   ///< by it the last frame's camera moved in the world [map units]
  Vec3 turned_by = Vec3::Zero();  ///< and turned: rotation vector along world axes [rad]
  int reason_value = 0;           ///< measured figure behind `reason`
  int reason_limit = 0;           ///< and its limit
  const char* reason = "";        ///< why the state is what it is, static text
  FrameOrder order;               ///< as it was found
  InitReport init;
  StageTimes times;
};

struct TrackerOptions {
  InitializerOptions initializer;
  SparseAlignOptions align;
  ReprojectorOptions reprojector;
  PoseOptimizerOptions pose;
  KeyframeSelectorOptions keyframe;
  RollingShutter shutter;
  RelocaliserOptions relocaliser;
  LandmarkFinderOptions landmarks;
  HealthOptions health;
  MotionGateOptions gate;
  MotionPriorOptions motion;
  PoseCertaintyOptions certainty;
  /// A pose stands if its inliers' chi-square stays below what 999 of 1,000 right poses have, at noise whose variance
  /// is so many times the stated one: motion blur and what else the noise model leaves out.
  double noise_allowance = 1.5;
  double shaded_sigma = 1.5;  ///< noise of a measurement inside the mask, of that of one outside
  /// A last frame no older than this is tracked from directly. After a longer gap, and by a keyframe, a pose is a
  /// guess.
  rt::TimeNs direct_gap_ns = 150 * rt::kNsPerMs;
  rt::TimeNs last_frame_gap_ns = rt::kNsPerSecond;  ///< older last frames are not aligned with any more
  /// Evidence (pose_evidence.h) adds up over frames that follow each other, to at most `most_evidence`; one frame takes
  /// at most `worst_frame` of it, since what blurs a picture blurs all of its points. In simulated flights a frame has
  /// 200 to 500, on tum_fr1_xyz 98 of 100 have more than 40; a pose that had left the right one for a wall's pattern
  /// -9 to -86. A guess begins with nothing and becomes a pose with `sure`: among walkers 97 of 100 right poses have
  /// it by their first frame, and one of 144 wrong ones, 8 cm off.
  /// A guess whose first picture has as much needs no second look; and a told pose vouches for its points with it.
  double most_evidence = 60.0;
  double worst_frame = -30.0;
  double sure = 40.0;
  double held = 20.0;       ///< a pose that followed right ones is right with this; and a guess where it was expected
  double promising = 10.0;  ///< makes a pose worth following; 99.4 % of the right ones and 6 of 144 wrong ones have it
  /// Between movers, and after them until one is told, a pose is told with this: by points that agreed with right poses
  /// before (evidence_of_vouched(); a mover's agree with each other) and, at most half of it, by how the camera moved.
  /// In eight severe flights, masks 85 and 120 ms old, 10 poses told are off by more than 5 cm; by the motion and all
  /// points alike, 35.
  double told = 20.0;
  int least_measurements = 12;     ///< a pose with fewer is none
  int least_beside_prior = 7;      ///< nor with fewer, where it is known how the camera moves
  double crowded = kCrowdedShare;  ///< where movers hide more of the picture, a lost pose is sought by landmarks
  /// With fewer measurements in the last frame, points that motion blur hides are looked for on coarser levels, too. On
  /// euroc_mh01 the fastest turns leave 36 measurements without that and 54 with it.
  int plenty = 120;
  int mapped_beside = 12;  ///< features outside the mask, without which no keyframe is made of a pose that is not told
  /// A pose that is found further than so many sigmas from where the camera should be is another place that looks
  /// alike. Less than so much is never too far: a share of the scene's depth, and an angle, as vision's own error may
  /// be.
  double most_expected_sigmas = 4;
  double expected_depth_share = 0.05, expected_turn_rad = 0.05;
  int unproved_frames = 5;     ///< so many frames may pass until one convinces
  int delta_delay_frames = 0;  ///< sequential runs: a delta is applied so many frames after the message that caused it
  rt::TimeNs (*clock)() = nullptr;  ///< for stage times only; nothing depends on it
};

class Tracker {
 public:
  Tracker(const CameraModel& camera, const TrackerOptions& options, MapChannel* channel);
  ~Tracker();
  Tracker(const Tracker&) = delete;
  Tracker& operator=(const Tracker&) = delete;

  /// The next frame, with the masks that come before it, finds the mapper like this: a flight is flown again. The
  /// mapper is at least as far as it was then.
  void expect(const FrameOrder& order) { expected_ = order; }

  /// Estimates the pose of one frame. No allocation, bounded, no wait. Frames come in the order of their time.
  FrameResult track(const FrameInput& frame);

  /// The mask of an earlier frame, come late: if the frame is a keyframe, the map loses what that keyframe took from
  /// inside the mask (docs/architecture.md). Between two frames; no allocation, bounded. False: there is no room for
  /// the message now, try again after the next frame.
  bool late_mask(rt::TimeNs t_capture_ns, const rt::MaskPyramidView& mask);

  /// References to frame slots that the tracker no longer needs. False when there are none.
  bool take_release(SlotRelease* release);

  const Map& map() const { return *map_; }
  /// The measurements behind the last tracked frame's pose (inliers first matched in map order).
  std::span<const FrameFeature> features() const;

 private:
  struct Frame {
    int slot = -1;
    bool holds_mapper_reference = false;
    rt::PyramidView pyramid;
    rt::MaskPyramidView mask;  ///< valid only while the frame is being tracked
    bool crowded = false;      ///< much of it is masked
    SE3 T_cam_world;
    ReadoutMotion motion;
    bool velocity_known = false;  ///< velocity is that of the pose against the one before
    double gathered = 0.0;        ///< evidence over the frames that led to the pose [nats]
    PosePrediction predicted;     ///< by how the camera moved
    bool goes_on = false;         ///< the pose is one that this leads to
    PosePrior expected;
    std::uint32_t sequence = 0;
    std::uint32_t counter = 0;  ///< the tracker's own count
    rt::TimeNs t_capture_ns = 0;
  };

  void begin_map();
  void drop_map();
  void forget_first_view();
  bool have_map() const { return last_keyframe_id_ != 0; }
  void apply_deltas(FrameResult* result);
  void apply(const MapDelta& d);
  /// Takes the frame. True: it began a map, in the place of the one that was searched for too long, if there was one.
  /// Unless it `may_begin`, tracks are followed for a later frame.
  bool initialise(const FrameInput& in, const Frame& frame, bool may_begin, FrameResult* result);
  FrameEvidence::Kind locate(const FrameInput& in, Frame* frame, FrameResult* result);
  bool align_with_last(const FrameInput& in, Frame* frame, const SE3& T_cur_last_guess, FrameResult* result);
  /// From the last frame: by its picture, and where that does not convince, by how the camera moved.
  bool look_near_last(const FrameInput& in, const SE3& guess, bool near, Frame* frame, FrameResult* result);
  bool align_with_keyframe(const RelocalisationGuess& guess, Frame* frame);
  bool look_where_expected(const PosePrior& expected, Frame* frame, FrameResult* result);
  bool look_for_likeness(int attempt, Frame* frame, FrameResult* result);
  bool recognise_landmarks(int attempt, bool near, Frame* frame, FrameResult* result);
  /// The pose of so many of measurements_, with what is predicted of it, if they do not disagree with that.
  PoseOptimizerResult fit_pose(int matches, Frame* frame);
  // Finds the map in the frame and its pose from that. `coarser`: where it is not found, on coarser levels, too.
  bool measure(const FrameInput& in, bool coarser, Frame* frame, FrameResult* result);
  /// Evidence for the pose of the last measure() by points that were right before. A mover's points agree with each
  /// other, and with the pose that follows it: they speak for that alone.
  double evidence_of_vouched() const;
  /// The points that agree with a pose that vouched ones speak for are vouched from here on.
  void vouch();
  /// What a pose found in the map again is, by the evidence of its picture.
  FrameEvidence::Kind found(const FrameResult& r);
  // These say in refusal_ what they refuse for.
  bool proves(double wanted, double evidence);
  bool as_noisy_as_stated(const FrameResult& r);
  bool as_expected(const Frame& frame);
  bool told_between_movers(const Frame& frame);
  bool expects(const FrameInput& in) const { return in.expected.known && in.expected.map_id == map_id_; }
  bool find_in_map(const FrameInput& in, Frame* frame, FrameResult* result);
  /// Between movers, where a pose is followed that nothing vouched for tells: every other frame is looked for in the
  /// map as well, since it may be one of them who is followed. True: found by points that are vouched for.
  bool find_beside(const FrameInput& in, Frame* frame, FrameResult* result);
  void adopt_features();
  void take_pose(FrameEvidence::Kind kind, const FrameInput& in, Frame* frame, FrameResult* result);
  bool same_picture(const rt::ImageView& picture);
  void consider_keyframe(Frame* frame, FrameResult* result);
  bool send_reset();
  bool send(MessageKind kind, Frame* frame, std::uint32_t keyframe_id, int place);
  int insert_keyframe(const Frame& frame, std::uint32_t id);
  void take_points(SeenPoints* points) const;
  double scene_depth(const SE3& T_cam_world, double* min_depth);
  void retire(Frame* frame);
  /// last_ and its features step aside for a frame found by guess, and come back where that was not confirmed.
  void keep_followed();
  void go_back_to_followed();
  /// Messages that may be sent with this frame. Looked at once: what the mapper takes meanwhile counts for the next.
  int room() {
    if (room_ < 0) {
      // Never more than there is: what is expected may be another flight's.
      const int free = static_cast<int>(channel_->messages.free_items());
      order_.room = expected_.room >= 0 ? std::min(expected_.room, free) : free;
      room_ = order_.room;
    }
    return room_;
  }
  void commit_message() {
    channel_->messages.commit();
    --room_;
  }
  rt::TimeNs now() const { return options_.clock ? options_.clock() : 0; }

  const CameraModel camera_;
  TrackerOptions options_;
  MapChannel* channel_;
  std::unique_ptr<Map> map_;
  Initializer initializer_;
  std::unique_ptr<SparseImageAlign> align_;
  std::unique_ptr<Reprojector> reprojector_;
  std::unique_ptr<Relocaliser> relocaliser_;
  std::unique_ptr<LandmarkFinder> landmarks_;
  const MotionGate gate_;
  FrameNoise noise_;
  ShakeFit shake_;
  MeasuredShake first_shake_;            ///< of the first view
  std::array<MeasuredShake, 3> shakes_;  ///< of the last pictures without a map, the newest first
  MotionPrior motion_;
  Mat6 with_prior_ = Mat6::Identity();  ///< covariance of the last measure()'s pose
  double weight_scale_ = 1.0;           ///< of the last measure()
  PoseCertainty certainty_;
  Health health_;

  std::uint32_t epoch_ = 0;
  std::uint32_t map_id_ = 0;
  std::uint32_t frame_counter_ = 0;
  std::uint32_t next_keyframe_id_ = 1;
  bool reset_pending_ = true;

  FrameOrder expected_, order_;  ///< of the next frame, and as this one found it
  int room_ = -1;                ///< what is left of it; -1: not looked at since the last frame

  Frame first_;            ///< first view of the initialisation
  CoarseMask first_mask_;  ///< its dynamic pixels, kept until it is sent
  Frame last_;             ///< last frame with a pose
  Frame followed_;         ///< the last one that was followed, while last_ was found by guess and is unproved
  struct Seen {
    SE3 T_cam_world;
    rt::TimeNs t_capture_ns = 0;
    bool known = false;
  };
  Seen seen_;              ///< where the camera was when a pose last held, whatever became of guesses since then
  int untold_ = 0;         ///< frames followed since one between movers was told; beyond them, too, until one is told
  int unproved_ = 0;       ///< last_ was found by guess: frames since then, all waiting for one that convinces
  Reason refusal_;         ///< why the last pose was refused; no text: its measurements were too few
  double evidence_ = 0.0;  ///< for the pose of the last measure() [nats]
  double vouched_ = 0.0;  ///< between movers, and until one is told after them, what vouched points say of it; else all
  int relocalise_attempt_ = 0;
  std::uint32_t reprojection_mark_ = 0;
  std::uint64_t picture_hash_ = 0;
  bool have_picture_hash_ = false;
  std::array<FrameFeature, kMaxFrameFeatures> features_, features_scratch_;
  std::array<FrameFeature, kMaxFrameFeatures> followed_features_;
  int followed_count_ = 0;
  int feature_count_ = 0;
  int map_feature_count_ = 0;  ///< the first so many of them lie outside the mask: what a keyframe may keep
  int match_count_ = 0;        ///< of the last measure(), in features_scratch_ and measurements_
  int rejected_count_ = 0;     ///< behind them: what the gate took out
  std::array<PoseMeasurement, kMaxFrameFeatures> measurements_;
  std::array<AlignPoint, kMaxFrameFeatures> align_points_;

  std::uint32_t last_keyframe_id_ = 0;  ///< 0: there is no map
  int frames_since_keyframe_ = 0;
  int last_keyframe_features_ = 0;
  CoarseMask keyframe_mask_;  ///< dynamic pixels of the last keyframe
  double median_depth_ = 1.0, min_depth_ = 0.3;

  SlotReleases releases_;
};

}  // namespace godwit::vo
