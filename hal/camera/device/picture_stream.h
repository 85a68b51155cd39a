// One opened device that fills buffers with pictures: what V4L2 and libcamera have in common.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hal/camera/device/exposure_device.h"
#include "hal/camera/pixels/pixel_format.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// What a camera's stamps mark, where its own word is not to be believed.
enum class StampAt : std::uint8_t { kAsFlagged, kStartOfExposure, kEndOfReadout };

/// What any device is asked for.
struct DeviceSettings {
  std::string device;                 ///< which: choose_video_node, choose_libcamera
  int width = 0, height = 0;          ///< the calibration's
  std::optional<PixelFormat> format;  ///< nothing: the first of kPixelFormats that the device has
  double fps = 0;                     ///< wanted; 0: as the device is set
  int shift = -1;                     ///< see RawPicture; -1: usual_shift
  StampAt stamp_at = StampAt::kAsFlagged;
  rt::TimeNs exposure_ns = 0;              ///< where the device does not say
  ExposurePlan exposure;                   ///< who sets it
  rt::TimeNs readout_ns = 0;               ///< first to last row
  bool rolling = false;                    ///< rolling shutter: rows are exposed one after the other
  rt::TimeNs stall_ns = rt::kNsPerSecond;  ///< a stream that gives nothing for longer is started anew
};

/// Opened and streaming. take() and give_back() belong to the thread that reads pictures: no allocation, no lock. The
/// rest, the destructor too, to the one that opened it, which may block.
class PictureStream {
 public:
  enum class Take : std::uint8_t {
    kPicture,
    kBroken,   ///< the driver marks it as damaged
    kNothing,  ///< none in time
    kGone      ///< the device is gone, or refuses: this stream is at its end
  };
  struct Buffer {
    std::uint32_t index = 0;
    const std::uint8_t* data = nullptr;
    std::size_t bytes = 0;     ///< that the device says it wrote
    std::size_t capacity = 0;  ///< of the buffer
    rt::TimeNs stamp_ns = 0;
    std::uint32_t sequence = 0;
    bool start_of_exposure = false;  ///< stamped there, not at the end
    rt::TimeNs exposure_ns = 0;      ///< this picture's; 0: the device does not say with each
  };

  virtual ~PictureStream() = default;
  /// The oldest filled buffer, unless nothing or an end is returned. Give it back. Waits at most timeout_ns.
  virtual Take take(rt::TimeNs timeout_ns, Buffer* buffer) = 0;
  /// False: the driver does not want it any more; the stream is at its end.
  virtual bool give_back(std::uint32_t index) = 0;

  /// Buffers go back by way of keep(), which is to be called soon after give_back().
  virtual bool kept() const { return false; }
  /// What the reading thread may not do.
  virtual void keep() {}
  virtual PixelFormat format() const = 0;
  virtual int stride() const = 0;
  /// By which exposure and gain are set as the plan says; lives no longer than the stream. What cannot be done is told
  /// in notes, in words. Null: they are not set under way.
  virtual std::unique_ptr<ExposureDevice> exposure(const ExposurePlan& /*plan*/, std::vector<std::string>* /*notes*/) {
    return nullptr;
  }
  /// What is odd but no reason not to fly, in words.
  virtual const std::vector<std::string>& notes() const = 0;
};

}  // namespace godwit::hal
