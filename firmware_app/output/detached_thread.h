// A thread for a disc or a reader that may hang: nobody waits for its end.
#pragma once

#include <functional>

namespace godwit::app {

/// Runs the body, which must not throw and shares whatever it touches, on an ordinary thread that takes no signals; its
/// stack is small, since all memory may be locked. False: there is no thread to be had.
bool start_detached(const char* name, std::function<void()> body);

}  // namespace godwit::app
