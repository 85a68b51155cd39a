// One camera of libcamera's, opened and streaming: its requests between three threads.
#pragma once

#include <array>
#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hal/camera/device/picture_stream.h"
#include "hal/camera/libcamera/libcamera_system.h"
#include "hal/rt/result.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::hal {

/// libcamera's thread says which request came back, the reading thread converts its buffer straight from libcamera's
/// memory, and the keeper's queues it again, since that allocates and locks inside libcamera.
class LibcameraStream final : public PictureStream, private RequestListener {
 public:
  /// Opens the camera that settings.device means (choose_libcamera). Error: what failed on which camera, in words.
  static rt::Result<std::unique_ptr<LibcameraStream>> open(LibcameraSystem* system, const DeviceSettings& settings);

  Take take(rt::TimeNs timeout_ns, Buffer* buffer) override;
  bool give_back(std::uint32_t index) override;
  bool kept() const override { return true; }
  void keep() override;
  PixelFormat format() const override { return format_; }
  int stride() const override { return stride_; }
  const std::vector<std::string>& notes() const override { return notes_; }

 private:
  static constexpr std::uint32_t kBuffers = 6;       ///< a fifth of a second at 30 Hz
  static constexpr std::uint32_t kMostBuffers = 16;  ///< a pipeline may want more than it is asked for

  explicit LibcameraStream(std::string id) : id_(std::move(id)) {}
  rt::Error error(const std::string& what) const { return rt::Error{"libcamera, " + id_ + ": " + what}; }
  rt::Result<void> set_up(const DeviceSettings& settings);
  bool queue(std::uint32_t index);

  // libcamera's thread.
  void completed(const CompletedRequest& request) override;
  void disconnected() override;

  const std::string id_;
  PixelFormat format_ = PixelFormat::kGrey;
  int stride_ = 0;
  std::vector<std::string> notes_;
  std::array<LibcameraGiven::Buffer, kMostBuffers> buffers_{};
  std::uint32_t count_ = 0;
  std::uint32_t cancelled_ = 0;  ///< the reader's: in a row
  std::uint32_t sequence_ = 0;   ///< the reader's: newest

  /// Each request that is libcamera's. The keeper sets it before it queues, libcamera's thread takes it away: a request
  /// that comes back twice must not be read while it is being filled. Release and acquire: its picture comes between.
  std::array<std::atomic<bool>, kMostBuffers> out_{};
  rt::SpscRing<CompletedRequest, kMostBuffers>
      done_;                                        ///< libcamera to reader; no more can be out than there are places
  rt::SpscRing<std::uint32_t, kMostBuffers> back_;  ///< reader to keeper
  /// libcamera or the keeper to the reader: nothing comes any more. Relaxed: what came before lies in done_, which is
  /// looked at first.
  std::atomic<bool> gone_{false};
  rt::WakeUp wake_;
  /// Last, so that it goes first: until it has stopped, libcamera uses all that stands above.
  std::unique_ptr<LibcameraSession> session_;
};

}  // namespace godwit::hal
