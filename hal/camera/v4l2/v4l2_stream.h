// One V4L2 device, opened and streaming: format, buffers, controls.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "hal/camera/device/picture_stream.h"
#include "hal/camera/v4l2/v4l2_controls.h"
#include "hal/camera/v4l2/v4l2_exposure.h"
#include "hal/camera/v4l2/video_system.h"
#include "hal/rt/result.h"

struct v4l2_buffer;

namespace godwit::hal {

struct V4l2Settings : DeviceSettings {
  /// Set at each start, by the driver's name in small letters with _ for what is neither letter nor digit
  /// ("exposure_auto", "trigger_mode"), or by number ("0x009a0901").
  std::vector<std::pair<std::string, std::int64_t>> controls;
};

/// Opened, streaming, with kBuffers buffers in the driver's hands. Blocks and allocates in open() and the destructor
/// only.
class V4l2Stream final : public PictureStream {
 public:
  static constexpr std::uint32_t kBuffers = 6;  ///< a fifth of a second at 30 Hz

  /// Error: which call failed on which device and why, in words.
  static rt::Result<std::unique_ptr<V4l2Stream>> open(VideoSystem* system, const V4l2Settings& settings);
  /// Stops and closes.
  ~V4l2Stream() override;
  V4l2Stream(const V4l2Stream&) = delete;
  V4l2Stream& operator=(const V4l2Stream&) = delete;

  Take take(rt::TimeNs timeout_ns, Buffer* buffer) override;
  bool give_back(std::uint32_t index) override;

  PixelFormat format() const override { return format_; }
  int stride() const override { return stride_; }
  double fps() const { return fps_; }  ///< the device's word; 0: it says nothing
  std::unique_ptr<ExposureDevice> exposure(const ExposurePlan& plan, std::vector<std::string>* notes) override {
    return std::make_unique<V4l2Exposure>(*controls_, plan, width_, notes);
  }
  const std::vector<std::string>& notes() const override { return notes_; }
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
  int width_ = 0, stride_ = 0;
  double fps_ = 0;
  std::array<Mapping, kBuffers> buffers_{};
  std::uint32_t count_ = 0;
  std::optional<V4l2Controls> controls_;
  std::vector<std::string> notes_;
};

}  // namespace godwit::hal
