// The controls of a V4L2 device: found by name or number, read and set, of 32 bits or 64.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "hal/camera/v4l2/video_system.h"
#include "hal/rt/result.h"

namespace godwit::hal {

struct V4l2Control {
  std::uint32_t id = 0;
  bool wide = false;  ///< of 64 bits, as Tegra's exposure and gain are
  std::int64_t low = 0, high = 0, step = 1;
};

/// Of one open device. Everything asks the driver and may block; one thread.
class V4l2Controls {
 public:
  V4l2Controls(VideoSystem* system, int descriptor, std::string path)
      : system_(system), fd_(descriptor), path_(std::move(path)) {}

  /// Nothing: the device has none, or has switched it off.
  std::optional<V4l2Control> find(std::uint32_t id) const;
  /// By the driver's name in small letters with _ for what is neither letter nor digit ("exposure_auto"), or by number
  /// ("0x009a0901"). Error: the names that there are.
  rt::Result<V4l2Control> find(const std::string& name) const;
  std::optional<std::int64_t> get(const V4l2Control& control) const;
  /// False: refused, see errno.
  bool set(const V4l2Control& control, std::int64_t value) const;
  /// Each by name, or as a control of a vendor's own in a UVC extension unit by "uvc:UNIT:SELECTOR" (UVC 1.5, 4.2.2.4),
  /// little-endian in as many bytes as the device says, 8 at most, and read back. Error: which was refused and why.
  rt::Result<void> set_all(const std::vector<std::pair<std::string, std::int64_t>>& wanted) const;
  const std::string& path() const { return path_; }

 private:
  bool call(unsigned long request, void* argument) const { return system_->ioctl(fd_, request, argument) == 0; }
  bool ask_unit(std::uint8_t unit, std::uint8_t selector, std::uint8_t request, std::span<std::uint8_t> bytes) const;
  rt::Result<void> set_in_unit(const std::string& name, std::int64_t value) const;

  VideoSystem* system_;
  int fd_;
  std::string path_;
};

}  // namespace godwit::hal
