// The simulated world: making it, and drawing and exposing a picture of it.
#include <benchmark/benchmark.h>
#include <string>
#include <vector>

#include "hal/sim/flight/flight.h"

namespace godwit {
namespace {

sim::Scenario scenario(const std::string& name) {
  auto read = sim::find_scenario(name, GODWIT_SCENARIO_DIR);
  if (!read) throw std::runtime_error(read.error().message);
  return read.value();
}

void make_world(benchmark::State& state, const std::string& name) {
  const sim::Scenario plan = scenario(name);
  for ([[maybe_unused]] auto _ : state) {
    const sim::Flight flight(plan, 1);
    benchmark::DoNotOptimize(sim::check_clearance(flight));
  }
}

/// Every eighth picture of the first 40 s.
void draw(benchmark::State& state, const std::string& name) {
  const sim::Flight flight(scenario(name), 1);
  const auto camera = flight.camera(0);
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(camera->width()) *
                                   static_cast<std::size_t>(camera->height()));
  const rt::MutableImageView grey{pixels.data(), camera->width(), camera->height(), camera->width()};
  hal::CapturedFrame frame;
  int index = 0;
  for ([[maybe_unused]] auto _ : state) {
    camera->skip_to(index);
    benchmark::DoNotOptimize(camera->next(grey, nullptr, 0, &frame, nullptr));
    benchmark::ClobberMemory();
    index = (index + 8) % 1200;
  }
}

[[maybe_unused]] const bool kRegistered = [] {
  for (const char* name : {"street", "survey", "hover-in-crowd", "flicker-100hz"}) {
    benchmark::RegisterBenchmark((std::string("sim_world/") + name).c_str(), make_world, name)
        ->Unit(benchmark::kMillisecond)
        ->Iterations(1);
    benchmark::RegisterBenchmark((std::string("sim_picture/") + name).c_str(), draw, name)
        ->Unit(benchmark::kMillisecond)
        ->Iterations(150);
  }
  return true;
}();

}  // namespace
}  // namespace godwit
