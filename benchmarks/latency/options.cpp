#include "benchmarks/latency/options.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <cstdio>

#include "firmware_app/config/version.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"

namespace godwit::bench {

int parse_options(int argc, char** argv, Options* o) {
  CLI::App app(
      "The whole pipeline at the camera's own pace: how old a pose is when it stands and when it is on the bus, what "
      "each thread costs, what was late or lost.",
      "godwit-latency");
  app.set_version_flag("--version", "godwit-latency " + app::version_words(app::version()));
  CLI::Option* const input = app.add_option(
      "INPUT", o->input, "Folder of a recorded sequence (as for godwit replay), or the name of a simulated scenario");
  CLI::Option* const config =
      app.add_option("--config", o->config_file, "Configuration (TOML) to fly with")->type_name("FILE");
  std::string camera;
  CLI::Option* const live =
      app.add_option("--camera", camera,
                     "Live, in place of INPUT: the camera that this configuration names, flown with it")
          ->type_name("FILE")
          ->excludes(input)
          ->excludes(config);
  app.add_option("--detector", o->detector, "on, off, or both: one flight after the other")
      ->check(CLI::IsMember({"on", "off", "both"}))
      ->capture_default_str();
  app.add_option("--seconds", o->seconds, "Length of each flight [s]")
      ->check(app::number(1, app::kLongSeconds))
      ->capture_default_str();
  app.add_option("--fps", o->fps, "Pictures a second (default: the sequence's own rate, or 30)")
      ->check(app::number(1, 240));
  app.add_option("--pictures", o->pictures, "Pictures held in memory and shown forth and back")
      ->check(app::whole_number(2, app::kManyPictures))
      ->capture_default_str();
  app.add_option("--seed", o->seed, "Of a simulated scenario")
      ->check(app::whole_number(0, app::kLastSeed))
      ->capture_default_str();
  const auto delay = [&](const char* name, double* value, const char* what) {
    app.add_option(name, *value, what)->check(app::number(0, 1000))->capture_default_str()->excludes(live);
  };
  delay("--exposure-ms", &o->delays.exposure_ms, "Exposure of the simulated camera [ms]");
  delay("--readout-ms", &o->delays.readout_ms, "Readout of the simulated camera, first row to last [ms]");
  delay("--transfer-ms", &o->delays.transfer_ms, "From the last row to the picture in memory [ms]");
  app.add_option("--can", o->can, "Bus to send the poses on: multicast:N or socketcan:IFACE (default: none)")
      ->type_name("BUS");
  app.add_flag("--watched", o->watched,
               "Also keep and show the flight as godwitd does: flight_log, recorder and live of the configuration");
  app.add_option("--json", o->json_file, "Writes all figures (schema: docs/figures.schema.json)")->type_name("FILE");
  CLI::Option* const plot =
      app.add_option("--plot", o->plot_file, "Draws histogram and timeline of the ages")->type_name("FILE.png");
  app.add_option(
         "--compare", o->compare,
         "Two configurations (.toml) or two godwit-latency programs, flown in turn; INPUT and the other options "
         "hold for both")
      ->expected(2)
      ->excludes(plot)
      ->type_name("A B");
  app.add_option("--pairs", o->pairs, "Pairs of flights that --compare counts; an odd number becomes even by one more")
      ->check(app::whole_number(3, 1000))
      ->capture_default_str();
  app.add_flag("--quiet", o->quiet, "No table");
  app.footer(
      "Ages count from the middle of the exposure of the middle row. Exit codes: 0 done; 1 failed on the way, or no\n"
      "pose was found; 2 did not start; 130 interrupted.\n"
      "Example: godwit-latency street --seconds 30 --exposure-ms 8 --readout-ms 15 --transfer-ms 5 --json out.json");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? app::kExitDone : app::kExitRefused;
  }
  o->pairs += o->pairs % 2;
  o->live = !camera.empty();
  if (o->live) o->config_file = camera;
  if (!o->live && o->input.empty()) {
    std::fputs("godwit-latency: nothing to fly: INPUT, or --camera FILE, is needed (--help)\n", stderr);
    return app::kExitRefused;
  }
  return -1;
}

}  // namespace godwit::bench
