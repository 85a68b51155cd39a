// What the libcamera camera asks of libcamera: so little that a test can play it, devices that lie among them. No
// header of libcamera's is included here; what speaks to it is a library of its own, loaded when a camera is wanted.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "hal/camera/device/exposure_control.h"
#include "hal/camera/pixels/pixel_format.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// A request that came back, with what libcamera says of its picture.
struct CompletedRequest {
  enum class State : std::uint8_t {
    kGood,
    kDamaged,   ///< libcamera marks the picture
    kCancelled  ///< not filled: the camera stops, goes, or failed at it
  };
  std::uint32_t index = 0;  ///< of its buffer
  State state = State::kGood;
  rt::TimeNs stamp_ns = 0;    ///< SensorTimestamp, or else the buffer's
  bool sensor_stamp = false;  ///< the former: the start of the first row's exposure
  std::uint32_t sequence = 0;
  std::size_t bytes = 0;       ///< of all planes
  rt::TimeNs exposure_ns = 0;  ///< 0: it does not say
};

/// Hears of requests on libcamera's own thread; neither call may wait.
class RequestListener {
 public:
  virtual ~RequestListener() = default;
  virtual void completed(const CompletedRequest& request) = 0;
  virtual void disconnected() = 0;
};

/// How a camera is to be set up.
struct LibcameraPlan {
  PixelFormat format = PixelFormat::kGrey;
  int width = 0, height = 0;
  double fps = 0;                 ///< 0: as it is set
  std::optional<Exposure> fixed;  ///< exposure_ns 0: as it is set; nothing: libcamera's own automatic exposure
  std::uint32_t buffers = 0;
};

/// What became of the plan.
struct LibcameraGiven {
  std::string format;  ///< libcamera's name, where it is another one; empty: as wanted
  int width = 0, height = 0, stride = 0;
  struct Buffer {
    const std::uint8_t* data = nullptr;
    std::size_t bytes = 0;
  };
  std::vector<Buffer> buffers;     ///< mapped as long as the session lives
  std::vector<std::string> notes;  ///< what could not be set
};

/// One camera that is ours. All but queue() may block; the destructor stops it, and after it the listener hears
/// nothing.
class LibcameraSession {
 public:
  virtual ~LibcameraSession() = default;
  /// Those of ours that it offers; *others: names of those it offers beside, for an error.
  virtual std::vector<PixelFormat> formats(std::string* others) = 0;
  /// Makes and maps the buffers if format and size are those of the plan. Error: what was refused, without the camera.
  virtual rt::Result<LibcameraGiven> configure(const LibcameraPlan& plan) = 0;
  virtual rt::Result<void> start(RequestListener* listener) = 0;
  /// The request of this buffer, (again) to be filled. False: it is refused. Allocates and locks inside libcamera.
  virtual bool queue(std::uint32_t index) = 0;
};

class LibcameraSystem {
 public:
  virtual ~LibcameraSystem() = default;
  /// The ids of all cameras that are there now, in libcamera's order.
  virtual std::vector<std::string> cameras() = 0;
  /// Error: gone, or another program's; without the camera's name.
  virtual rt::Result<std::unique_ptr<LibcameraSession>> acquire(const std::string& id) = 0;
};

/// libcamera itself, from ../lib/godwit/godwit-libcamera.so beside the folder of the running program. Error: this
/// godwit was built without it, or the machine's libcamera is not the one it was built for; in words. One at a time.
rt::Result<std::unique_ptr<LibcameraSystem>> load_libcamera();
/// Where load_libcamera() looks.
std::string libcamera_library();

/// Which camera is meant: "index:N" in libcamera's order, an id, or a part of one that fits one camera only.
struct LibcameraChoice {
  std::string id;
  std::string error;  ///< empty: id is good
};
LibcameraChoice choose_libcamera(const std::string& device, const std::vector<std::string>& cameras);

}  // namespace godwit::hal
