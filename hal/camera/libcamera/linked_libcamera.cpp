// godwit-libcamera.so: libcamera behind LibcameraSystem. A library of its own, loaded when a camera of it is wanted:
// with libcamera come threads and 8 MB stacks of the libraries under it, which a locked memory would hold in every
// flight.
#include <atomic>
#include <cerrno>
#include <cstring>
#include <libcamera/camera_manager.h>

#include "hal/camera/libcamera/libcamera_entry.h"
#include "hal/camera/libcamera/linked_session.h"

namespace godwit::hal {
namespace {

/// libcamera ends the process at a second manager.
std::atomic<bool> in_use{false};

class LinkedLibcamera final : public LibcameraSystem {
 public:
  explicit LinkedLibcamera(std::unique_ptr<libcamera::CameraManager> manager) : manager_(std::move(manager)) {}
  ~LinkedLibcamera() override {
    manager_->stop();
    manager_.reset();
    // Partner: the exchange in godwit_libcamera_1.
    in_use.store(false, std::memory_order_release);
  }

  std::vector<std::string> cameras() override {
    std::vector<std::string> out;
    for (const auto& camera : manager_->cameras()) out.push_back(camera->id());
    return out;
  }

  rt::Result<std::unique_ptr<LibcameraSession>> acquire(const std::string& id) override {
    auto camera = manager_->get(id);
    if (camera == nullptr) return rt::Error{"it is gone"};
    if (const int error = camera->acquire(); error != 0) {
      return rt::Error{error == -EBUSY ? std::string("another program uses it")
                                       : std::string("cannot be had: ") + std::strerror(-error)};
    }
    return std::unique_ptr<LibcameraSession>(std::make_unique<LinkedSession>(std::move(camera)));
  }

 private:
  std::unique_ptr<libcamera::CameraManager> manager_;
};

}  // namespace
}  // namespace godwit::hal

extern "C" godwit::hal::LibcameraSystem* godwit_libcamera_1(const char** why) {
  using namespace godwit::hal;
  // Acquire: a manager before this one is gone.
  if (in_use.exchange(true, std::memory_order_acquire)) {
    *why = "this program uses it already";
    return nullptr;
  }
  auto manager = std::make_unique<libcamera::CameraManager>();
  if (manager->start() != 0) {
    manager.reset();
    in_use.store(false, std::memory_order_release);
    *why = "it does not start";
    return nullptr;
  }
  return new LinkedLibcamera(std::move(manager));
}
