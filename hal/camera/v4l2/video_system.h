// What the V4L2 camera asks of the machine: a thin layer over the system calls, so that tests can play a device that
// lies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hal/camera/device/machine_clocks.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// A video device as the machine lists it.
struct VideoNode {
  std::string path;                ///< "/dev/video0"
  std::vector<std::string> names;  ///< below /dev/v4l/by-id and by-path, without the folder
  std::string serial;              ///< USB serial number; empty: it has none
};

class VideoSystem : public MachineClocks {
 public:
  enum class Wait : std::uint8_t { kReady, kTimeout, kGone };

  /// As open(2), for reading and writing, non-blocking.
  virtual int open(const char* path) = 0;
  virtual void close(int descriptor) = 0;
  /// As ioctl(2); begun again when a signal interrupts it.
  virtual int ioctl(int descriptor, unsigned long request, void* argument) = 0;
  /// A shared mapping for reading and writing; null: none, see errno.
  virtual void* map(int descriptor, std::size_t bytes, std::int64_t offset) = 0;
  virtual void unmap(void* memory, std::size_t bytes) = 0;
  /// Waits for a buffer. kGone: the device has hung up or is in error. No allocation.
  virtual Wait wait_readable(int descriptor, rt::TimeNs timeout_ns) = 0;
  /// Every video device there is now. Blocks.
  virtual std::vector<VideoNode> nodes() = 0;
};

/// The kernel's. sys: where sysfs is mounted; dev: where devices are.
std::unique_ptr<VideoSystem> linux_video_system(const std::string& sys = "/sys", const std::string& dev = "/dev");

/// The path of the device that is meant: "/dev/video0" (any path), "by-id:NAME" (a name below /dev/v4l/by-id or
/// by-path, or a part of one that fits one device only), "serial:NUMBER" (the first node of that USB serial number).
/// Error: none, or several, with the list of what is there.
struct VideoChoice {
  std::string path;
  std::string error;  ///< empty: path is good
};
VideoChoice choose_video_node(const std::string& device, const std::vector<VideoNode>& nodes);

}  // namespace godwit::hal
