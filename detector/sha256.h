// SHA-256 (FIPS 180-4), to tell whether a network's file is the one that its metadata describes.
//
// Our own: one function of a few lines, checked against the standard's examples. The libraries that have it (libcrypto,
// nettle) come under other names and versions on JetPack's Ubuntu 20.04 than on Debian 12, and the daemon needs nothing
// else of them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "hal/rt/result.h"

namespace godwit::detector {

class Sha256 {
 public:
  void add(std::span<const std::uint8_t> bytes);
  /// 64 lower-case hexadecimal digits of all that was added. Ends it.
  std::string digits();

 private:
  void take_block(const std::uint8_t* block);

  std::array<std::uint32_t, 8> state_{0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                      0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
  std::array<std::uint8_t, 64> waiting_{};
  std::uint64_t bytes_ = 0;
};

/// The largest YOLOv5 has 350 MB, ours 8. Reading more would keep the answer to a signal away for seconds.
constexpr std::int64_t kMostNetworkBytes = 512 << 20;

/// Of a plain file; a pipe, a device or a larger file is refused, not waited for. Allocates; not for the frame path.
/// Error: file, reason.
rt::Result<std::string> sha256_of_file(const std::string& path);

}  // namespace godwit::detector
