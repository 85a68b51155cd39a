// Memory that is there when it is needed: locking it, and counting where it was not.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace godwit::rt {

/// Locks all memory of this process, present and future, into RAM (mlockall): from here on no thread waits for a page.
/// Returns what the machine refused and what would help, in words; empty: done. Blocks and allocates; before arming.
std::string lock_memory();

/// From here on threads that nobody plans (a library's, the log's) get stacks of this size, in place of the 8 MB that a
/// shell's limit gives them: of locked memory all is there, used or not. Before the first of them starts.
void limit_unplanned_stacks(std::size_t bytes);

/// Pages that had to be brought in while a thread ran.
struct PageFaults {
  std::int64_t minor = 0;  ///< mapped or zeroed by the kernel
  std::int64_t major = 0;  ///< read from a disk

  PageFaults operator-(const PageFaults& o) const { return {minor - o.minor, major - o.major}; }
};

/// Of the calling thread since it began. No allocation, no lock.
PageFaults thread_page_faults();

}  // namespace godwit::rt
