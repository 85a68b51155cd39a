// A file for people, read whole: never a pipe or a device that keeps its reader waiting, never without bound.
#pragma once

#include <cstddef>
#include <string>

#include "hal/rt/result.h"

namespace godwit::rt {

/// Blocks for a disc, not for anybody else; allocates. Error: what is no plain file, larger than most_bytes, or cannot
/// be read, with its name.
Result<std::string> read_small_file(const std::string& path, std::size_t most_bytes);

}  // namespace godwit::rt
