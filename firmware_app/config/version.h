// Of which sources the programs are made.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace godwit::app {

/// Static text.
struct Version {
  std::string_view number;  ///< "0.1.0"
  std::string_view commit;  ///< its first 12 digits, or "unknown"
  bool dirty;               ///< tracked files differed from it
};
const Version& version();

/// "5cbb52e0a1b2", "5cbb52e0a1b2-dirty" or "unknown".
std::string commit_words(const Version& version);
/// "0.1.0 (commit 5cbb52e0a1b2)".
std::string version_words(const Version& version);
/// As GetNodeInfo tells it: the first 8 digits of the commit; 0: unknown. There is no room for "dirty".
std::uint32_t vcs_commit(const Version& version);
/// The first two figures of the number, as GetNodeInfo tells them.
std::uint8_t major_of(const Version& version);
std::uint8_t minor_of(const Version& version);

}  // namespace godwit::app
