// The list of pictures of a recorded sequence: TUM's rgb.txt and EuRoC's data.csv. Pure functions over text.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "hal/record_file.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// Why a listed picture is not flown, although its line can be read.
enum class TimeFault : std::uint8_t {
  kNone,
  kRepeats,   ///< the same time as a picture before
  kGoesBack,  ///< earlier than a picture before
};

struct SequenceEntry {
  rt::TimeNs t_ns = 0;  ///< as listed, exact
  std::string file;     ///< as listed, relative to the folder the layout says
  int line = 0;         ///< in the index file, from 1
  TimeFault fault = TimeFault::kNone;
};

struct SequenceIndex {
  std::vector<SequenceEntry> entries;  ///< in the order of the file; never empty
  std::string cut_off;                 ///< where and how the list breaks off in its last line; empty: it does not
};

/// Lines "seconds file" ('#' starts a comment). Digits behind the ninth decimal are cut off. Error: names the file,
/// line and reason; a line that cannot be read refuses the whole index (but the last, cut_off), and so does an index
/// without pictures.
rt::Result<SequenceIndex> parse_tum_index(std::string_view text, const std::string& name);

/// Lines "nanoseconds,file". Errors as above.
rt::Result<SequenceIndex> parse_euroc_index(std::string_view text, const std::string& name);

}  // namespace godwit::hal
