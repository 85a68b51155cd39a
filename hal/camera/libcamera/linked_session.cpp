#include "hal/camera/libcamera/linked_session.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <libcamera/control_ids.h>
#include <linux/dma-buf.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <thread>

namespace godwit::hal {
namespace {

constexpr std::uint32_t drm_code(char a, char b, char c, char d) {
  return static_cast<std::uint32_t>(a) | static_cast<std::uint32_t>(b) << 8 | static_cast<std::uint32_t>(c) << 16 |
         static_cast<std::uint32_t>(d) << 24;
}

/// DRM's codes: its "RGB" is named from the highest byte down, V4L2's from the first in memory on.
constexpr std::pair<PixelFormat, std::uint32_t> kCodes[] = {
    {PixelFormat::kGrey, drm_code('R', '8', ' ', ' ')},  {PixelFormat::kY10, drm_code('R', '1', '0', ' ')},
    {PixelFormat::kYuyv, drm_code('Y', 'U', 'Y', 'V')},  {PixelFormat::kNv12, drm_code('N', 'V', '1', '2')},
    {PixelFormat::kRg10, drm_code('R', 'G', '1', '0')},  {PixelFormat::kBa10, drm_code('B', 'A', '1', '0')},
    {PixelFormat::kBgr3, drm_code('R', 'G', '2', '4')},  {PixelFormat::kRgb3, drm_code('B', 'G', '2', '4')},
    {PixelFormat::kMjpeg, drm_code('M', 'J', 'P', 'G')},
};

libcamera::PixelFormat theirs(PixelFormat format) {
  const auto* const found =
      std::find_if(std::begin(kCodes), std::end(kCodes), [&](const auto& c) { return c.first == format; });
  return found == std::end(kCodes) ? libcamera::PixelFormat() : libcamera::PixelFormat(found->second, 0);
}

rt::Error failed(const char* what, int error) {
  return rt::Error{std::string(what) + ": " + std::strerror(error < 0 ? -error : error)};
}

/// Both of libcamera's ways to answer: a number alone in the first releases, one that may be missing since.
template <typename T>
T value_or(const std::optional<T>& value, T other) {
  return value.value_or(other);
}

}  // namespace

LinkedSession::~LinkedSession() {
  if (started_ && device_left() && !told_so()) {
    // It would not come back from stop(). What it may still use stays; the camera is taken until libcamera notices.
    camera_->requestCompleted.disconnect(this);
    camera_->disconnected.disconnect(this);
    for (auto& request : requests_) static_cast<void>(request.release());
    static_cast<void>(allocator_.release());
    static_cast<void>(configuration_.release());
    return;
  }
  if (started_) camera_->stop();  // all requests have come back when it returns
  if (listener_ != nullptr) {
    camera_->requestCompleted.disconnect(this);
    camera_->disconnected.disconnect(this);
  }
  requests_.clear();
  for (const Mapping& m : mappings_) munmap(m.memory, m.bytes);
  allocator_.reset();
  configuration_.reset();
  camera_->release();
}

bool LinkedSession::device_left() const {
  if (cancelled_.load(std::memory_order_relaxed)) return true;
  // A node that the kernel has taken away while it is open.
  std::error_code failed;
  for (std::filesystem::directory_iterator file("/proc/self/fd", failed), end; !failed && file != end;
       file.increment(failed)) {
    std::error_code gone;
    const std::string path = std::filesystem::read_symlink(file->path(), gone);
    const bool device =
        path.starts_with("/dev/video") || path.starts_with("/dev/media") || path.starts_with("/dev/v4l");
    if (device && path.ends_with(" (deleted)")) return true;
  }
  return false;
}

bool LinkedSession::told_so() const {
  // udev's word comes in milliseconds, and on a machine that is busy later.
  constexpr int kLooks = 500;
  for (int i = 0; i < kLooks && !disconnected_.load(std::memory_order_relaxed); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return disconnected_.load(std::memory_order_relaxed);
}

std::vector<PixelFormat> LinkedSession::formats(std::string* others) {
  std::vector<PixelFormat> out;
  for (const libcamera::StreamRole role : {libcamera::StreamRole::VideoRecording, libcamera::StreamRole::Raw}) {
    const auto configuration = camera_->generateConfiguration({role});
    if (configuration == nullptr || configuration->empty()) continue;
    for (const libcamera::PixelFormat& format : configuration->at(0).formats().pixelformats()) {
      const auto* const known =
          std::find_if(std::begin(kCodes), std::end(kCodes), [&](const auto& c) { return theirs(c.first) == format; });
      if (known == std::end(kCodes)) {
        others->append(others->empty() ? "" : " ").append(format.toString());
      } else if (roles_.emplace(known->first, role).second) {
        out.push_back(known->first);
      }
    }
  }
  return out;
}

rt::Result<LibcameraGiven> LinkedSession::configure(const LibcameraPlan& plan) {
  const auto role = roles_.find(plan.format);
  configuration_ =
      camera_->generateConfiguration({role != roles_.end() ? role->second : libcamera::StreamRole::VideoRecording});
  if (configuration_ == nullptr || configuration_->empty()) return rt::Error{"has no stream"};
  libcamera::StreamConfiguration& stream = configuration_->at(0);
  stream.pixelFormat = theirs(plan.format);
  stream.size = libcamera::Size(static_cast<unsigned>(plan.width), static_cast<unsigned>(plan.height));
  stream.bufferCount = plan.buffers;
  if (configuration_->validate() == libcamera::CameraConfiguration::Invalid) {
    return rt::Error{"the format is refused"};
  }
  LibcameraGiven out;
  out.width = static_cast<int>(stream.size.width);
  out.height = static_cast<int>(stream.size.height);
  if (stream.pixelFormat != theirs(plan.format)) out.format = stream.pixelFormat.toString();
  if (out.width != plan.width || out.height != plan.height || !out.format.empty()) return out;
  if (const int error = camera_->configure(configuration_.get()); error != 0) {
    return failed("the format is refused", error);
  }
  out.stride = static_cast<int>(stream.stride);
  allocator_ = std::make_unique<libcamera::FrameBufferAllocator>(camera_);
  if (const int error = allocator_->allocate(stream.stream()); error < 0) return failed("gives no buffers", error);
  if (auto r = map_buffers(out.height, &out); !r) return r.error();
  plan_controls(plan, &out);
  return out;
}

rt::Result<void> LinkedSession::map_buffers(int height, LibcameraGiven* given) {
  libcamera::Stream* const stream = configuration_->at(0).stream();
  for (const auto& buffer : allocator_->buffers(stream)) {
    const auto& planes = buffer->planes();
    const int descriptor = planes[0].fd.get();
    const std::size_t begin = planes[0].offset;
    std::size_t end = begin;
    for (const auto& plane : planes) {
      if (plane.fd.get() != descriptor || plane.offset < end) {
        return rt::Error{"its pictures lie in several pieces of memory, which are not read here"};
      }
      end = plane.offset + plane.length;
    }
    if (planes.size() > 1 && planes[1].offset - begin != static_cast<std::size_t>(given->stride) * height) {
      return rt::Error{"the planes of its pictures do not follow one another"};
    }
    void* const memory = mmap(nullptr, end, PROT_READ, MAP_SHARED, descriptor, 0);
    if (memory == MAP_FAILED) return failed("a buffer cannot be mapped", errno);
    mappings_.push_back({memory, end, descriptor});
    given->buffers.push_back({static_cast<const std::uint8_t*>(memory) + begin, end - begin});
    // The cookie is the buffer's place.
    auto request = camera_->createRequest(requests_.size());
    if (request == nullptr) return rt::Error{"gives no requests"};
    if (const int error = request->addBuffer(stream, buffer.get()); error != 0) {
      return failed("a buffer is refused", error);
    }
    requests_.push_back(std::move(request));
  }
  return {};
}

void LinkedSession::plan_controls(const LibcameraPlan& plan, LibcameraGiven* given) {
  namespace controls = libcamera::controls;
  const libcamera::ControlInfoMap& there = camera_->controls();
  controls_ = libcamera::ControlList(there);
  const auto has = [&](const auto& control) { return there.find(control.id()) != there.end(); };
  if (plan.fps > 0) {
    const auto interval_us = static_cast<std::int64_t>(1e6 / plan.fps + 0.5);
    if (has(controls::FrameDurationLimits)) {
      controls_.set(controls::FrameDurationLimits, {interval_us, interval_us});
    } else {
      given->notes.emplace_back("libcamera: this camera's frame rate cannot be set");
    }
  }
  if (!plan.fixed) return;
  if (has(controls::AeEnable)) controls_.set(controls::AeEnable, false);
  if (plan.fixed->exposure_ns > 0 && has(controls::ExposureTime)) {
    controls_.set(controls::ExposureTime, static_cast<std::int32_t>(plan.fixed->exposure_ns / 1000));
  } else if (plan.fixed->exposure_ns > 0) {
    given->notes.emplace_back("libcamera: this camera's exposure cannot be set");
  }
  if (has(controls::AnalogueGain)) {
    controls_.set(controls::AnalogueGain, static_cast<float>(plan.fixed->gain));
  } else if (plan.fixed->gain != 1) {
    given->notes.emplace_back("libcamera: this camera's gain cannot be set");
  }
}

rt::Result<void> LinkedSession::start(RequestListener* listener) {
  listener_ = listener;
  camera_->requestCompleted.connect(this, &LinkedSession::completed);
  camera_->disconnected.connect(this, &LinkedSession::disconnected);
  if (const int error = camera_->start(&controls_); error != 0) return failed("does not begin to stream", error);
  started_ = true;
  return {};
}

void LinkedSession::sync(std::size_t index, bool begin) {
  // Where caches are not the camera's, too, the kernel must be told who looks. Memory that is no dma-buf refuses: fine.
  dma_buf_sync flags{};
  flags.flags = DMA_BUF_SYNC_READ | (begin ? DMA_BUF_SYNC_START : DMA_BUF_SYNC_END);
  ioctl(mappings_[index].descriptor, DMA_BUF_IOCTL_SYNC, &flags);
}

bool LinkedSession::queue(std::uint32_t index) {
  libcamera::Request* const request = requests_[index].get();
  if (request->status() != libcamera::Request::RequestPending) {
    sync(index, false);
    request->reuse(libcamera::Request::ReuseBuffers);
  }
  return camera_->queueRequest(request) == 0;
}

void LinkedSession::completed(libcamera::Request* request) {
  namespace controls = libcamera::controls;
  const libcamera::FrameMetadata& picture = request->buffers().begin()->second->metadata();
  CompletedRequest out;
  out.index = static_cast<std::uint32_t>(request->cookie());
  const bool cancelled = request->status() == libcamera::Request::RequestCancelled ||
                         picture.status == libcamera::FrameMetadata::FrameCancelled;
  out.state = cancelled                                                  ? CompletedRequest::State::kCancelled
              : picture.status == libcamera::FrameMetadata::FrameSuccess ? CompletedRequest::State::kGood
                                                                         : CompletedRequest::State::kDamaged;
  const std::int64_t stamp_ns = value_or<std::int64_t>(request->metadata().get(controls::SensorTimestamp), 0);
  out.sensor_stamp = stamp_ns != 0;
  out.stamp_ns = stamp_ns != 0 ? stamp_ns : static_cast<rt::TimeNs>(picture.timestamp);
  out.sequence = picture.sequence;
  for (const auto& plane : picture.planes()) out.bytes += plane.bytesused;
  out.exposure_ns = rt::TimeNs{value_or<std::int32_t>(request->metadata().get(controls::ExposureTime), 0)} * 1000;
  sync(out.index, true);
  if (cancelled) cancelled_.store(true, std::memory_order_relaxed);
  listener_->completed(out);
}

void LinkedSession::disconnected() {
  disconnected_.store(true, std::memory_order_relaxed);
  listener_->disconnected();
}

}  // namespace godwit::hal
