#include "firmware_app/config_schema.h"

#include <algorithm>

#include "hal/rt/frame_pool.h"

namespace godwit::app {
namespace {

constexpr int kMostCpus = 1024;
constexpr int kHighestPriority = 98;  // 99 is the kernel's own: its watchdog and migration threads
constexpr std::size_t kLongestPath = 1024;

void add_thread(const std::string& section, rt::ThreadPlan* plan, std::vector<Key>* to) {
  to->push_back(keys::whole_list(section + ".cpus", 0, kMostCpus - 1, 64, &plan->cpus));
  to->push_back(keys::whole(section + ".priority", 0, kHighestPriority, &plan->priority));
}

}  // namespace

std::vector<Key> config_keys(Config* c) {
  using Source = Config::Camera::Source;
  std::vector<Key> out = {
      keys::whole("pipeline.frame_slots", 0, rt::kMaxFrameSlots, &c->pipeline.frame_slots),
      keys::whole("pipeline.mapper_delay_frames", 1, 30, &c->pipeline.mapper_delay_frames),

      keys::flag("threads.lock_memory", &c->threads.lock_memory),
  };
  add_thread("threads.camera", &c->threads.camera, &out);
  add_thread("threads.tracker", &c->threads.tracker, &out);
  add_thread("threads.mapper", &c->threads.mapper, &out);
  for (Key& key : std::vector<Key>{
           keys::number("scheduler.deadline_ms", 5, 1000, "ms", &c->scheduler.deadline_ms),
           keys::number("scheduler.tracker_p95_ms", 1, 1000, "ms", &c->scheduler.tracker_p95_ms),
           keys::number("scheduler.temperature_c", 30, 120, "degrees C", &c->scheduler.temperature_c),
           keys::number("scheduler.calm_s", 1, 600, "s", &c->scheduler.calm_s),

           keys::choice<Source>("camera.source", {{"none", Source::kNone}, {"sim", Source::kSim}}, &c->camera.source),
           keys::text("camera.scenario", kLongestPath, "a scenario's name or file", &c->camera.scenario),
           keys::text("camera.scenarios", kLongestPath, "a folder", &c->camera.scenarios),
           keys::whole<std::uint64_t>("camera.seed", 0, 1'000'000'000, &c->camera.seed),
           keys::whole("camera.pictures", 2, 10000, &c->camera.pictures),
       }) {
    out.push_back(std::move(key));
  }
  return out;
}

void check_contradictions(ConfigReport* report) {
  const Config& c = report->config;
  if (c.threads.mapper.priority > 0 && c.threads.mapper.priority >= c.threads.tracker.priority) {
    const int most = std::max(0, c.threads.tracker.priority - 1);
    report->mistake("threads.mapper.priority", "tracking comes first, with threads.tracker.priority = " +
                                                   std::to_string(c.threads.tracker.priority) + "; 0 to " +
                                                   std::to_string(most) + " is allowed");
  }
  if (c.scheduler.tracker_p95_ms >= c.scheduler.deadline_ms) {
    report->mistake("scheduler.tracker_p95_ms", keys::decimal(c.scheduler.tracker_p95_ms) +
                                                    " is not below scheduler.deadline_ms (" +
                                                    keys::decimal(c.scheduler.deadline_ms) +
                                                    "): it would act only when it is too late; less is allowed");
  }
}

}  // namespace godwit::app
