#include "firmware_app/commands/sim_command.h"

#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <fmt/format.h>

#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"
#include "firmware_app/sim/flight_writer.h"

namespace godwit::app {
void add_flight_options(CLI::App* command, FlightArguments* a) {
  command->add_option("SCENARIO", a->scenario, "Name of a scenario (street, survey, night ..), or a TOML file")
      ->required();
  command
      ->add_option("--seed", a->seed, "Another seed is another world, wind and noise; equal seeds give equal flights")
      ->type_name("N")
      ->check(whole_number(0, kLastSeed))
      ->capture_default_str();
  command
      ->add_option("--scenarios", a->folder,
                   "Folder in which scenarios are looked up (default: those that come with godwit)")
      ->type_name("DIR");
  command->add_flag("--imu-faults", a->imu_faults,
                    "The IMU is worse than its data sheet: twice the noise, biases that ramp, 3 ms late, 0.5 ms of "
                    "jitter, mounted 1.5 degrees wrong (beyond the scenario's own)");
}

rt::Result<std::unique_ptr<sim::Flight>> make_flight(const FlightArguments& a) {
  rt::Result<sim::Scenario> scenario = sim::find_scenario(a.scenario, scenario_folder(a.folder));
  if (!scenario) return scenario.error();
  if (a.imu_faults) scenario.value().imu = sim::with_usual_faults(scenario.value().imu);
  auto flight = std::make_unique<sim::Flight>(scenario.value(), a.seed);
  if (const rt::Result<void> clear = sim::check_clearance(*flight); !clear) return clear.error();
  return flight;
}

void add_sim_command(CLI::App* app, SimArguments* a) {
  CLI::App* command =
      app->add_subcommand("sim", "Write a simulated flight, with its truth, as a TUM and EuRoC/ASL folder");
  add_flight_options(command, &a->flight);
  command->add_option("--out", a->out, "Folder to write, made if it is not there")->type_name("DIR")->required();
  command->add_option("--format", a->format, "Pictures: jpg (quality 95) or png (lossless)")
      ->check(CLI::IsMember({"jpg", "png"}))
      ->capture_default_str();
  add_range_options(command, &a->start, &a->frames);
  command->footer(
      "Writes mav0/ (EuRoC/ASL), rgb.txt, camera.yaml, groundtruth.txt (camera), groundtruth_body.txt, imu.txt, "
      "boxes.csv\n"
      "(true boxes of people, cars and trucks), range.csv, gnss.csv and baro.csv; rgb.txt comes last.\n"
      "Example: godwit sim street --seed 7 --out out/street && godwit replay out/street --out out/street_run");
}

int run_sim(const SimArguments& a, const std::atomic<bool>& stop) {
  const auto flight = make_flight(a.flight);
  if (!flight) {
    fmt::print(stderr, "godwit: {}\n", flight.error().message);
    return kExitRefused;
  }
  const auto written = write_flight(*flight.value(), {a.out, a.format == "png", a.start, a.frames}, stop);
  if (!written) {
    fmt::print(stderr, "godwit: {}\n", written.error().message);
    return stop.load(std::memory_order_relaxed) ? kExitInterrupted : kExitFailed;
  }
  const FlightWritten& w = written.value();
  fmt::print("{} (seed {}): {:.1f} s, {:.1f} m, {} pictures", a.flight.scenario, a.flight.seed, w.seconds, w.path_m,
             w.pictures);
  if (w.dropped > 0) fmt::print(", {} dropped", w.dropped);
  fmt::print("; {:.1f} ms of one processor a picture; written to {}\n", w.render_ms, a.out);
  return kExitDone;
}

}  // namespace godwit::app
