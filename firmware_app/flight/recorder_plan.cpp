#include "firmware_app/flight/recorder_plan.h"

#include <fmt/format.h>
#include <utility>

#include "firmware_app/config/version.h"

namespace godwit::app {

std::string events_folder(const Config& config) {
  if (!config.recorder.enabled) return "";
  if (!config.recorder.folder.empty()) return config.recorder.folder;
  return config.link.state_folder.empty() ? "" : config.link.state_folder + "/events";
}

rt::Result<std::unique_ptr<EventRecorder>> start_recorder(const Config& config, const std::string& folder,
                                                          const hal::CameraCalibration& calibration,
                                                          rt::FramePool* pool, bool live,
                                                          std::function<void(const std::string&)> say,
                                                          std::function<void(const char*)> abandon) {
  EventRecorderOptions options;
  options.folder = folder;
  options.before_s = config.recorder.before_s;
  options.after_s = config.recorder.after_s;
  options.memory_bytes = static_cast<std::size_t>(config.recorder.memory_mb) * 1'000'000;
  options.budget_bytes = static_cast<std::size_t>(config.recorder.budget_mb) * 1'000'000;
  options.most_events = static_cast<std::uint64_t>(config.recorder.events);
  options.calibration = calibration;
  options.live = live;
  options.say = std::move(say);
  options.abandon = std::move(abandon);
  std::string text;
  for (const std::string& line : show_config(config)) text += line + "\n";
  options.info.emplace_back("version", version_words(version()));
  options.info.emplace_back("configuration", std::move(text));
  return EventRecorder::start(std::move(options), pool);
}

std::unique_ptr<EventRecorder> begin_recorder(const Config& config, const std::string& folder,
                                              const hal::CameraCalibration& calibration, rt::FramePool* pool,
                                              const std::function<void(const std::string&)>& say,
                                              std::function<void(const char*)> abandon) {
  if (folder.empty()) return nullptr;
  auto started = start_recorder(config, folder, calibration, pool, true, say, std::move(abandon));
  if (!started) {
    say("warning: " + started.error().message + "; it flies without");
    return nullptr;
  }
  say("event recorder: " + started.value()->description() + "; " + folder);
  return std::move(started).value();
}

std::string recorder_words(const EventReport& r) {
  return fmt::format("{} events written, {} not, {} beyond the limit; {} pictures and {} readings missed{}", r.written,
                     r.failed, r.suppressed, r.pictures_missed, r.samples_missed,
                     r.trouble.empty() ? "" : "; " + r.trouble);
}

}  // namespace godwit::app
