// Memory that is there when it is needed: locking it, and counting where it was not.
#pragma once

#include <cstdint>
#include <string>

namespace godwit::rt {

/// Locks all memory of this process, present and future, into RAM (mlockall): from here on no thread waits for a page.
/// Returns what the machine refused and what would help, in words; empty: done. Blocks and allocates; before arming.
std::string lock_memory();

/// Pages that had to be brought in while a thread ran.
struct PageFaults {
  std::int64_t minor = 0;  ///< mapped or zeroed by the kernel
  std::int64_t major = 0;  ///< read from a disk

  PageFaults operator-(const PageFaults& o) const { return {minor - o.minor, major - o.major}; }
};

/// Of the calling thread since it began. No allocation, no lock.
PageFaults thread_page_faults();

}  // namespace godwit::rt
