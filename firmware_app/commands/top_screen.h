// What `godwit top` shows of a line that godwitd told.
#pragma once

#include <string>
#include <string_view>

#include "hal/rt/result.h"

namespace godwit::app {

/// Lines for people, each at most so many columns wide, with a newline behind the last. What the line does not tell is
/// "-". Error: it is no line of godwitd's, or tells why there is none.
rt::Result<std::string> top_screen(std::string_view line, std::size_t columns);

}  // namespace godwit::app
