// What the programs of godwit have in common around their run: signals and the last catch.
#pragma once

#include <atomic>

namespace godwit::app {

/// Calls run with a flag that SIGINT and SIGTERM raise, and returns what it returns. An exception that comes out of it
/// is told on the error stream under the program's name: kExitFailed; so is what cannot be written to the standard
/// output. SIGHUP and SIGPIPE are ignored; a standard stream
/// that is closed becomes one that goes nowhere. Once in a process, before any file is opened.
int run_program(const char* name, int (*run)(int argc, char** argv, const std::atomic<bool>& stop), int argc,
                char** argv);

/// Ends the process at once, without waiting for a thread that does not end: told in a line under the program's name.
[[noreturn]] void end_without(const char* name, const char* thread, int code);

}  // namespace godwit::app
