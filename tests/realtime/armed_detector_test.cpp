// Armed beside a network: the detector's thread allocates, locks and faults as it must; camera and tracker under the
// same traps as ever must not feel it.
#include <atomic>
#include <gtest/gtest.h>
#include <sys/mman.h>

#include "firmware_app/flight/assembly.h"
#include "firmware_app/flight/pipeline_plan.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/lock_hook.h"
#include "tests/realtime/flown.h"

namespace godwit::app::armed_detector_test {
namespace {

/// Counts frames of which a part is masked. On the tracker's thread, under its rules.
class MaskCounter final : public FrameView {
 public:
  void look(const rt::FrameMeta&, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
            std::span<const vo::FrameFeature>) override {
    if (mask.levels == 0) return;
    int masked = 0;
    for (int y = 0; y < grey.height; ++y) {
      const std::uint8_t* const row = mask.level[0].data + static_cast<std::ptrdiff_t>(y) * mask.level[0].stride;
      for (int x = 0; x < grey.width; ++x) masked += row[x] != 0 ? 1 : 0;
    }
    frames_partly_masked += masked > 0 && masked < grey.width * grey.height ? 1 : 0;
  }
  int frames_partly_masked = 0;
};

TEST(ArmedDetector, TheNetworkBesideTheFlightTripsNoTrapOfCameraAndTracker) {
  constexpr int kFrames = 75;
  const auto scenario = sim::find_scenario("hover-in-crowd", GODWIT_SCENARIO_DIR);
  ASSERT_TRUE(scenario.ok()) << scenario.error().message;
  sim::Flight flight(scenario.value(), 1);
  const hal::CameraCalibration calibration = calibration_of(flight);
  test::Strides source(flight.camera(0));
  const std::atomic<bool> stop{false};
  LoopedPictures::Options camera_options;
  camera_options.total = kFrames;
  const auto camera = LoopedPictures::record(&source, 8, camera_options, stop);
  ASSERT_TRUE(camera.ok()) << camera.error().message;

  Config config;
  ASSERT_TRUE(config.detector.enabled) << "a daemon uses its network unless told otherwise";
  config.threads.lock_memory = true;
  MaskCounter masks;
  AssemblyPlan plan;
  plan.view = &masks;
  const auto parts = assemble(config, calibration, plan);
  ASSERT_TRUE(parts.ok()) << parts.error().message;
  PipelineOptions options;
  options.newest_frame = true;
  parts.value().plan_detector(&options);
  EXPECT_EQ(options.scheduler.input_px, 416);
  EXPECT_EQ(options.scheduler.small_input_px, 320);
  plan_pipeline(config, calibration.fps, &options);
  test::Notes notes(kFrames);

  const std::string refused = arm_memory(config);
  rt::trap_heap_use(true);
  rt::trap_lock_use(true);
  const auto run =
      run_pipeline(camera.value().get(), parts.value().stage.get(), parts.value().pool.get(), options, &notes, stop);
  rt::trap_heap_use(false);
  rt::trap_lock_use(false);
  munlockall();

  // The traps would have ended the program: heap and locks are proven by our being here.
  ASSERT_TRUE(run.ok()) << run.error().message;
  const PipelineCounters& c = run.value();
  EXPECT_EQ(c.due, static_cast<std::uint64_t>(kFrames));
  EXPECT_GT(c.scheduler.detections, 0u);
  EXPECT_EQ(c.scheduler.detections_failed, 0u);
  EXPECT_EQ(c.scheduler.detector_stuck, 0u);
  EXPECT_GT(masks.frames_partly_masked, 0) << "the crowd was seen";
  const rt::LogEntry* const told = notes.find("detections come");
  ASSERT_NE(told, nullptr);
  EXPECT_EQ(told->level, rt::LogLevel::kInfo);
  EXPECT_FALSE(notes.heard("detections fail"));
  bool detector = false;
  for (const ThreadReport& t : c.threads) {
    detector |= t.name == std::string("detector");
    EXPECT_LT(t.stack_used, rt::kThreadStackBytes * 3 / 4) << t.name;
    const bool real_time = t.name == std::string("camera") || t.name == std::string("tracker");
    if (real_time && refused.empty()) {
      EXPECT_EQ(t.faults.minor, 0) << t.name;
      EXPECT_EQ(t.faults.major, 0) << t.name;
    }
  }
  EXPECT_TRUE(detector);
  if (!refused.empty()) std::printf("page faults are not held against it: %s\n", refused.c_str());
  std::printf("%llu detections, %llu late; %d of %d frames partly masked\n",
              static_cast<unsigned long long>(c.scheduler.detections),
              static_cast<unsigned long long>(c.scheduler.detections_late), masks.frames_partly_masked, kFrames);
}

}  // namespace
}  // namespace godwit::app::armed_detector_test
