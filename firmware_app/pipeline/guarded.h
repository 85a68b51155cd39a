// What others' code throws, as words: a sink or a library must not unwind past running threads.
#pragma once

#include <exception>
#include <string>

namespace godwit::app {

/// What the call threw, in its words; empty: nothing.
template <typename Call>
std::string guarded(Call call) {
  try {
    call();
    return "";
  } catch (const std::exception& e) {
    return e.what()[0] != '\0' ? e.what() : "an exception without a word";
  }
}

}  // namespace godwit::app
