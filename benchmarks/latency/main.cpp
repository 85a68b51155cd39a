// godwit-latency: see options.cpp for what it says of itself.
#include <algorithm>
#include <cstdio>
#include <fmt/format.h>

#include "benchmarks/latency/compare.h"
#include "benchmarks/latency/flight.h"
#include "benchmarks/latency/options.h"
#include "benchmarks/latency/plot.h"
#include "benchmarks/latency/report.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"
#include "hal/atomic_file.h"

namespace {

using namespace godwit;

int fail(int code, const std::string& message) {
  fmt::print(stderr, "godwit-latency: {}\n", message);
  return code;
}

/// Opens the file before the flights, so that a folder that is not there does not cost their time.
rt::Result<void> open_output(const std::string& name, hal::AtomicFile* file) {
  return name.empty() ? rt::Result<void>() : file->open(name);
}

int finish(const std::string& name, const std::string& text, hal::AtomicFile* file) {
  if (name.empty()) return app::kExitDone;
  if (auto r = file->write(text); !r) return fail(app::kExitFailed, r.error().message);
  if (auto r = file->commit(); !r) return fail(app::kExitFailed, r.error().message);
  return app::kExitDone;
}

int finish_plot(const bench::Run& run, const std::string& name, hal::AtomicFile* file) {
  if (name.empty()) return app::kExitDone;
  const auto drawn = bench::plot(run);
  return drawn ? finish(name, drawn.value(), file) : fail(app::kExitFailed, drawn.error().message);
}

int run_compare(const bench::Options& o, hal::AtomicFile* file, const std::atomic<bool>& stop) {
  const auto compared = bench::compare(o, stop);
  if (stop.load(std::memory_order_relaxed)) return app::kExitInterrupted;
  if (!compared) return fail(app::kExitFailed, compared.error().message);
  if (!o.quiet) fmt::print("{}", bench::table(o, compared.value()));
  return finish(o.json_file, bench::json(o, compared.value()), file);
}

int run(int argc, char** argv, const std::atomic<bool>& stop) {
  bench::Options o;
  if (const int code = bench::parse_options(argc, argv, &o); code >= 0) return code;
  hal::AtomicFile json_file, plot_file;
  if (auto r = open_output(o.json_file, &json_file); !r) return fail(app::kExitRefused, r.error().message);
  if (auto r = open_output(o.plot_file, &plot_file); !r) return fail(app::kExitRefused, r.error().message);
  if (!o.compare.empty()) return run_compare(o, &json_file, stop);
  app::Config config;
  if (!o.config_file.empty()) {
    const app::ConfigReport report = app::load_config(o.config_file);
    for (const std::string& mistake : report.mistakes) fail(app::kExitRefused, mistake);
    if (!report.ok()) return app::kExitRefused;
    config = report.config;
  } else {
    config.threads.lock_memory = true;
  }
  auto pictures = o.live ? bench::live_pictures(config) : bench::load_pictures(o, stop);
  if (stop.load(std::memory_order_relaxed)) return app::kExitInterrupted;
  if (!pictures) return fail(app::kExitRefused, pictures.error().message);
  bench::Run run{pictures.value().name, o.config_file, pictures.value().fps, o.delays, o.live, {}};
  bool poses = true;
  for (const bool detector : {true, false}) {
    if (o.detector == (detector ? "off" : "on")) continue;
    auto flown = bench::fly(pictures.value(), o, config, detector, stop);
    if (stop.load(std::memory_order_relaxed)) return app::kExitInterrupted;
    if (!flown) return fail(app::kExitFailed, flown.error().message);
    poses = poses && flown.value().tracked > 0;
    run.flights.push_back(std::move(flown).value());
  }
  if (!o.quiet) fmt::print("{}", bench::table(run));
  const int told = finish(o.json_file, bench::json(run), &json_file);
  const int code = std::max(told, finish_plot(run, o.plot_file, &plot_file));
  if (!poses) fail(app::kExitFailed, "no pose was found: too short a flight, or pictures that show too little");
  return code == app::kExitDone && !poses ? static_cast<int>(app::kExitFailed) : code;
}

}  // namespace

int main(int argc, char** argv) {
  return app::run_program("godwit-latency", run, argc, argv);
}
