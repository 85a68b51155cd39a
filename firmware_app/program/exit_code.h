// What the tool's exit code says.
#pragma once

namespace godwit::app {

enum ExitCode : int {
  kExitDone = 0,          ///< done
  kExitFailed = 1,        ///< failed on the way: output could not be written, a device went away
  kExitRefused = 2,       ///< did not start: command line, configuration, calibration or sequence is wrong
  kExitRestart = 75,      ///< RestartNode came over the bus and was granted; systemd starts anew
  kExitInterrupted = 130  ///< stopped by a signal; nothing was written
};

}  // namespace godwit::app
