#include "firmware_app/commands/doctor_detector.h"

#include <algorithm>
#include <array>
#include <optional>
#include <vector>

#include "detector/detector.h"
#include "firmware_app/flight/model_files.h"
#include "firmware_app/flight/pipeline_plan.h"

namespace godwit::app {
namespace {

constexpr const char* kBackends[] = {"the processor", "CUDA", "CUDA with half precision"};

/// Median of five detections in a picture of noise, after one that is not counted.
rt::Result<rt::TimeNs> time_a_picture(detector::Detector* network, int width, int height) {
  std::vector<std::uint8_t> grey(width * height);
  std::uint32_t noise = 1;
  for (std::uint8_t& pixel : grey) {
    noise = noise * 1664525U + 1013904223U;
    pixel = static_cast<std::uint8_t>(noise >> 24U);
  }
  std::array<rt::TimeNs, 5> took{};
  detector::BoxList boxes;
  const auto detect = [&] { return network->detect({grey.data(), width, height, width, 1}, &boxes); };
  if (auto warm = detect(); !warm) return warm.error();
  for (rt::TimeNs& one : took) {
    const rt::TimeNs before = rt::monotonic_now_ns();
    if (auto done = detect(); !done) return done.error();
    one = rt::monotonic_now_ns() - before;
  }
  std::sort(took.begin(), took.end());
  return took[took.size() / 2];
}

/// Tells of one network; how long it takes for a picture, if it works.
std::optional<rt::TimeNs> examine(const std::string& file, const detector::DetectorOptions& options, int width,
                                  int height, DoctorReport* report) {
  auto opened = detector::Detector::open(file, options);
  if (!opened) {
    report->wrong("detector: " + opened.error().message);
    return std::nullopt;
  }
  detector::Detector& network = opened.value();
  const auto took = time_a_picture(&network, width, height);
  if (!took) {
    report->wrong("detector: " + file + ": " + took.error().message);
    return std::nullopt;
  }
  if (!network.warning().empty()) report->wrong(network.warning());
  report->fits(fmt::format("detector: {}: input {} x {}, {} classes, {:.0f} ms a picture on {}", file,
                           network.info().input_width, network.info().input_height, network.info().classes.size(),
                           rt::to_ms(took.value()), kBackends[static_cast<std::size_t>(network.backend())]));
  return took.value();
}

}  // namespace

std::string pace_advice(rt::TimeNs large_ns, rt::TimeNs small_ns, const SchedulerOptions& s, bool tiled) {
  const auto period = [&](rt::TimeNs took) { return detection_period_ns(s.period_frames * s.frame_ns, took); };
  const auto oldest = [&](rt::TimeNs took) { return oldest_mask_ns(period(took), took); };
  const std::string mend = std::string("; a machine with CUDA (detector.backend), or a smaller network, does better") +
                           (tiled ? "; so does detector.tiled = false" : "");
  if (oldest(small_ns) > s.mask_age_ns) {
    return fmt::format("too slow: masks grow {:.0f} ms old, more than {:.0f}; movers that are quick are missed",
                       rt::to_ms(oldest(small_ns)), rt::to_ms(s.mask_age_ns)) +
           mend;
  }
  if (oldest(large_ns) > s.mask_age_ns) {
    return fmt::format(
               "the large input is too slow (masks would grow {:.0f} ms old, more than {:.0f}): the small one "
               "is used from the start",
               rt::to_ms(oldest(large_ns)), rt::to_ms(s.mask_age_ns)) +
           mend;
  }
  if (period(large_ns) > s.period_frames * s.frame_ns) {
    return fmt::format("a picture every {:.0f} ms instead of every {:.0f}: slower than wanted, but enough",
                       rt::to_ms(period(large_ns)), rt::to_ms(s.period_frames * s.frame_ns));
  }
  return {};
}

void examine_detector(const Config& config, int picture_width, int picture_height, double fps, DoctorReport* report) {
  if (!config.detector.enabled) {
    report->note("detector: none is wanted (detector.enabled is false)");
    return;
  }
  bool good = true;
  check_model_files(config.detector, [&](const std::string& key, const std::string& why) {
    report->wrong(key + ": " + why);
    good = false;
  });
  if (!good) return;
  const ModelFiles files = model_files(config.detector);
  const detector::DetectorOptions options = detector_options(config.detector);
  const auto large = examine(files.large, options, picture_width, picture_height, report);
  auto small = large;
  if (!files.small.empty()) small = examine(files.small, options, picture_width, picture_height, report);
  if (config.detector.model.empty())
    report->note("detector: the networks that come with godwit are data under GPL-3.0");
  if (!large || !small) return;
  PipelineOptions pipeline;
  plan_pipeline(config, fps, &pipeline);
  const std::string advice = pace_advice(*large, *small, pipeline.scheduler, config.detector.tiled);
  if (advice.empty()) {
    report->fits("detector: quick enough for a picture every " + std::to_string(pipeline.scheduler.period_frames) +
                 " frames");
  } else {
    report->note("detector: " + advice);
  }
}

}  // namespace godwit::app
