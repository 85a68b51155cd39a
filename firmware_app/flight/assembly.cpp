#include "firmware_app/flight/assembly.h"

#include <algorithm>

#include "firmware_app/flight/model_files.h"
#include "firmware_app/pipeline/odometry_stage.h"

namespace godwit::app {
namespace {

rt::Result<std::unique_ptr<rt::FramePool>> make_pool(const Config& config, const hal::CameraCalibration& calibration,
                                                     bool onlooker) {
  rt::FramePool::Layout layout;
  layout.width = calibration.width;
  layout.height = calibration.height;
  layout.pyramid_bytes = odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots = config.pipeline.frame_slots;
  if (layout.slots == 0) layout.slots = odometry_frame_slots();
  if (layout.slots < odometry_frame_slots_min()) {
    return rt::Error{"pipeline.frame_slots: " + std::to_string(layout.slots) +
                     " are too few to fly with; 0 or at least " + std::to_string(odometry_frame_slots_min()) +
                     " are allowed"};
  }
  layout.readers = kFrameReaders;
  if (config.detector.enabled) {
    layout.readers = kFrameReadersWithDetector;
    layout.slots = std::min(layout.slots + kDetectorSlots, rt::kMaxFrameSlots);
    layout.colour = calibration.channels == 3;
  }
  layout.onlooker = onlooker;
  if (onlooker) layout.slots = std::min(layout.slots + kOnlookerSlots, rt::kMaxFrameSlots);
  return rt::FramePool::create(layout);
}

rt::Result<std::unique_ptr<DynamicMasks>> open_masks(const Config::Detector& config, const vo::CameraModel& camera,
                                                     const rt::FramePool* pool) {
  const ModelFiles files = model_files(config);
  DynamicMasksOptions options;
  options.model = files.large;
  options.small_model = files.small;
  options.detector = detector_options(config);
  return DynamicMasks::open(options, camera, pool);
}

}  // namespace

std::optional<std::array<double, 16>> inertial_mounting(const Config& config,
                                                        const hal::CameraCalibration& calibration) {
  if (calibration.T_body_cam || config.link.T_body_cam.size() != 16) return calibration.T_body_cam;
  std::array<double, 16> out{};
  std::copy(config.link.T_body_cam.begin(), config.link.T_body_cam.end(), out.begin());
  return out;
}

void Assembly::plan_detector(PipelineOptions* options) const {
  options->detector = dynamic.get();
  if (dynamic == nullptr) return;
  options->scheduler.input_px = dynamic->input_px();
  options->scheduler.small_input_px = dynamic->small_input_px();
}

rt::Result<Assembly> assemble(const Config& config, const hal::CameraCalibration& calibration,
                              const AssemblyPlan& plan) {
  const auto model = make_camera_model(calibration);
  if (!model)
    return rt::Error{(plan.calibration_name.empty() ? "" : plan.calibration_name + ": ") + model.error().message};
  auto pool = make_pool(config, calibration, plan.onlooker);
  if (!pool) return pool.error();
  Assembly out;
  out.pool = std::move(pool).value();
  if (config.detector.enabled) {
    auto opened = open_masks(config.detector, model.value(), out.pool.get());
    if (!opened) return opened.error();
    out.dynamic = std::move(opened).value();
  }
  OdometryOptions odometry = odometry_options(calibration);
  if (plan.sequential) odometry.mapper_delay_frames = config.pipeline.mapper_delay_frames;
  odometry.gate = config.gate.enabled;
  if (plan.inertial) {
    odometry.inertial_T_body_cam = inertial_mounting(config, calibration);
    if (!odometry.inertial_T_body_cam)
      return rt::Error{
          (plan.calibration_name.empty() ? "" : plan.calibration_name + ": ") +
          std::string("the inertial sensor cannot be used without T_body_cam: where the camera sits on it")};
    odometry.inertial_errors = plan.imu_errors;
    if (!config.imu.calibration.empty()) {
      const auto errors = hal::read_imu_error_model(config.imu.calibration);
      if (!errors) return rt::Error{"imu.calibration: " + errors.error().message};
      odometry.inertial_errors = errors.value();
    }
    odometry.gyro_helps = plan.gyro_helps;
    odometry.inertial_time_offset_s = calibration.time_offset_s.value_or(0);
    odometry.coast_ns = static_cast<rt::TimeNs>(config.imu.coast_s * 1e9);
  }
  if (plan.aided) {
    odometry.aided_T_body_cam = inertial_mounting(config, calibration);
    if (!odometry.aided_T_body_cam)
      return rt::Error{(plan.calibration_name.empty() ? "" : plan.calibration_name + ": ") +
                       std::string("the autopilot's attitude cannot be used without T_body_cam: where the camera sits "
                                   "on the body")};
  }
  odometry.starting_height_m = config.aids.starting_height_m;
  MaskSource* const masks = plan.masks != nullptr ? plan.masks : out.dynamic.get();
  out.stage = make_odometry_stage(model.value(), odometry, out.pool.get(), masks, plan.view);
  return out;
}

}  // namespace godwit::app
