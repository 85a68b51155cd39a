// How much of a disc is left to others: what records must not fill it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace godwit::app {

/// Nothing is written while less is free than the smaller of both: parameters and the reset counter are kept there,
/// too.
struct DiscRoom {
  std::size_t leave_bytes = 100'000'000;
  double leave_share = 0.05;  ///< of the whole disc
};

/// Whether more than that is free where the folder lies, also when so many bytes more are written. False: errno says
/// ENOSPC. Of a disc that does not tell: true, writing will. Blocks.
bool has_room(const std::string& folder, const DiscRoom& room, std::uint64_t bytes = 0);

}  // namespace godwit::app
