// The part that is linked with libcamera: a camera of its, acquired.
#pragma once

#include <atomic>
#include <libcamera/camera.h>
#include <libcamera/framebuffer_allocator.h>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "hal/camera/libcamera/libcamera_system.h"

namespace godwit::hal {

class LinkedSession final : public LibcameraSession {
 public:
  /// camera is acquired; the destructor releases it.
  explicit LinkedSession(std::shared_ptr<libcamera::Camera> camera) : camera_(std::move(camera)) {}
  ~LinkedSession() override;
  std::vector<PixelFormat> formats(std::string* others) override;
  rt::Result<LibcameraGiven> configure(const LibcameraPlan& plan) override;
  rt::Result<void> start(RequestListener* listener) override;
  bool queue(std::uint32_t index) override;

 private:
  struct Mapping {
    void* memory = nullptr;
    std::size_t bytes = 0;
    int descriptor = -1;
  };

  rt::Result<void> map_buffers(int height, LibcameraGiven* given);
  void plan_controls(const LibcameraPlan& plan, LibcameraGiven* given);
  void sync(std::size_t index, bool begin);
  /// libcamera 0.0.3 ends the process (an assertion in PipelineHandler::stop) when a camera is stopped whose device has
  /// gone and which it still takes to be there; after its own word that it is gone, stopping is safe. Seen with vimc
  /// unbound, whose pipeline, as all but UVC's, never gives that word.
  bool device_left() const;
  bool told_so() const;  ///< waits for that word
  // libcamera's thread.
  void completed(libcamera::Request* request);
  void disconnected();

  std::shared_ptr<libcamera::Camera> camera_;
  std::unique_ptr<libcamera::CameraConfiguration> configuration_;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator_;
  std::vector<std::unique_ptr<libcamera::Request>> requests_;
  std::vector<Mapping> mappings_;  ///< of the buffers, one each
  libcamera::ControlList controls_;
  std::map<PixelFormat, libcamera::StreamRole> roles_;  ///< by which each format is had
  RequestListener* listener_ = nullptr;
  bool started_ = false;
  std::atomic<bool> cancelled_{false};     ///< a request came back so, unasked; alone
  std::atomic<bool> disconnected_{false};  ///< libcamera's word; alone
};

}  // namespace godwit::hal
