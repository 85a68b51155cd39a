// One V4L2 device, opened and streaming: format, buffers, controls.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "hal/camera/v4l2/exposure_device.h"
#include "hal/camera/v4l2/pixel_format.h"
#include "hal/camera/v4l2/v4l2_controls.h"
#include "hal/camera/v4l2/video_system.h"
#include "hal/rt/result.h"

struct v4l2_buffer;

namespace godwit::hal {

/// What a camera's stamps mark, where V4L2's flags are not to be believed.
enum class StampAt : std::uint8_t { kAsFlagged, kStartOfExposure, kEndOfReadout };

struct V4l2Settings {
  std::string device;                 ///< see choose_video_node
  int width = 0, height = 0;          ///< the calibration's
  std::optional<PixelFormat> format;  ///< nothing: the first of kPixelFormats that the device has
  double fps = 0;                     ///< wanted; 0: as the device is set
  int shift = -1;                     ///< see RawPicture; -1: usual_shift
  /// Set at each start, by the driver's name in small letters with _ for what is neither letter nor digit
  /// ("exposure_auto", "trigger_mode"), or by number ("0x009a0901").
  std::vector<std::pair<std::string, std::int64_t>> controls;
  StampAt stamp_at = StampAt::kAsFlagged;
  rt::TimeNs exposure_ns = 0;              ///< where the device does not say
  ExposurePlan exposure;                   ///< who sets it
  rt::TimeNs readout_ns = 0;               ///< first to last row
  bool rolling = false;                    ///< rolling shutter: rows are exposed one after the other
  rt::TimeNs stall_ns = rt::kNsPerSecond;  ///< a stream that gives nothing for longer is started anew
};

/// Opened, streaming, with kBuffers buffers in the driver's hands. Blocks and allocates in open() and the destructor
/// only.
class V4l2Stream {
 public:
  static constexpr std::uint32_t kBuffers = 6;  ///< a fifth of a second at 30 Hz

  /// Error: which call failed on which device and why, in words.
  static rt::Result<std::unique_ptr<V4l2Stream>> open(VideoSystem* system, const V4l2Settings& settings);
  /// Stops and closes.
  ~V4l2Stream();
  V4l2Stream(const V4l2Stream&) = delete;
  V4l2Stream& operator=(const V4l2Stream&) = delete;

  enum class Take : std::uint8_t {
    kPicture,
    kBroken,   ///< the driver marks it as damaged (V4L2_BUF_FLAG_ERROR)
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
  };
  /// The oldest filled buffer. Give it back. No allocation, no lock; waits at most timeout_ns.
  Take take(rt::TimeNs timeout_ns, Buffer* buffer);
  /// False: the driver does not want it any more; the stream is at its end. No allocation.
  bool give_back(std::uint32_t index);

  PixelFormat format() const { return format_; }
  int stride() const { return stride_; }
  double fps() const { return fps_; }  ///< the device's word; 0: it says nothing
  /// Of the open device; asking and setting may block.
  const V4l2Controls& controls() const { return *controls_; }
  /// What is odd but no reason not to fly, in words.
  const std::vector<std::string>& notes() const { return notes_; }
  const std::string& path() const { return path_; }

 private:
  V4l2Stream(VideoSystem* system, std::string path) : system_(system), path_(std::move(path)) {}
  rt::Error error(const char* what) const;
  bool call(unsigned long request, void* argument) const { return system_->ioctl(fd_, request, argument) == 0; }
  rt::Result<void> check_device();
  rt::Result<void> choose_format(const V4l2Settings& settings);
  void set_rate(double fps);
  rt::Result<void> map_buffers();

  struct Mapping {
    void* memory = nullptr;
    std::size_t bytes = 0;
  };

  VideoSystem* system_;
  const std::string path_;
  int fd_ = -1;
  bool streaming_ = false;
  PixelFormat format_ = PixelFormat::kGrey;
  int stride_ = 0;
  double fps_ = 0;
  std::array<Mapping, kBuffers> buffers_{};
  std::uint32_t count_ = 0;
  std::optional<V4l2Controls> controls_;
  std::vector<std::string> notes_;
};

}  // namespace godwit::hal
