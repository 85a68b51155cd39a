// The tool `godwit`: the daemon's pipeline from files.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <atomic>

#include "firmware_app/commands/check_command.h"
#include "firmware_app/commands/doctor_command.h"
#include "firmware_app/commands/fly_command.h"
#include "firmware_app/commands/record_command.h"
#include "firmware_app/commands/replay_command.h"
#include "firmware_app/commands/sim_command.h"
#include "firmware_app/commands/top_command.h"
#include "firmware_app/commands/view_command.h"
#include "firmware_app/config/version.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/program.h"

namespace {

int run(int argc, char** argv, const std::atomic<bool>& stop) {
  using namespace godwit::app;
  CLI::App app("Visual navigation without satellites: a camera frame in, a pose out.", "godwit");
  app.set_version_flag("--version", "godwit " + version_words(version()));
  app.require_subcommand(1);
  app.footer(
      "Exit codes: 0 done; 1 failed on the way (output cannot be written); 2 did not start (command line,\n"
      "configuration, calibration or sequence is wrong); 75 restart asked for over the bus; 130 interrupted.");
  CheckArguments check;
  add_check_command(&app, &check);
  DoctorArguments doctor;
  add_doctor_command(&app, &doctor);
  ReplayArguments replay;
  add_replay_command(&app, &replay);
  FlyArguments fly;
  add_fly_command(&app, &fly);
  RecordArguments record;
  add_record_command(&app, &record);
  CalibrateArguments calibrate;
  add_calibrate_command(&app, &calibrate);
  SimArguments sim;
  add_sim_command(&app, &sim);
  TopArguments top;
  add_top_command(&app, &top);
  ViewArguments view;
  add_view_command(&app, &view);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? kExitDone : kExitRefused;
  }
  if (app.got_subcommand("check")) return run_check(check);
  if (app.got_subcommand("doctor")) return run_doctor(doctor, stop);
  if (app.got_subcommand("fly")) return run_fly(fly, stop);
  if (app.got_subcommand("record")) return run_record(record, stop);
  if (app.got_subcommand("calibrate")) return run_calibrate(calibrate, stop);
  if (app.got_subcommand("sim")) return run_sim(sim, stop);
  if (app.got_subcommand("top")) return run_top(top, stop);
  if (app.got_subcommand("view")) return run_view(view, stop);
  return run_replay(replay, stop);
}

}  // namespace

int main(int argc, char** argv) {
  return godwit::app::run_program("godwit", run, argc, argv);
}
