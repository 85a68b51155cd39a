#include "hal/camera/libcamera/libcamera_stream.h"

#include <algorithm>
#include <utility>

namespace godwit::hal {

rt::Result<std::unique_ptr<LibcameraStream>> LibcameraStream::open(LibcameraSystem* system,
                                                                   const DeviceSettings& settings) {
  const LibcameraChoice choice = choose_libcamera(settings.device, system->cameras());
  if (!choice.error.empty()) return rt::Error{choice.error};
  std::unique_ptr<LibcameraStream> out(new LibcameraStream(choice.id));
  auto acquired = system->acquire(choice.id);
  if (!acquired) return out->error(acquired.error().message);
  out->session_ = std::move(acquired).value();
  if (auto r = out->set_up(settings); !r) return r.error();
  if (auto r = out->session_->start(out.get()); !r) return out->error(r.error().message);
  for (std::uint32_t i = 0; i < out->count_; ++i) {
    if (!out->queue(i)) return out->error("it takes no requests");
  }
  return out;
}

rt::Result<void> LibcameraStream::set_up(const DeviceSettings& settings) {
  std::string others;
  const std::vector<PixelFormat> offered = session_->formats(&others);
  const auto offers = [&](PixelFormat f) { return std::find(offered.begin(), offered.end(), f) != offered.end(); };
  const auto* const first = std::find_if(std::begin(kPixelFormats), std::end(kPixelFormats), offers);
  if (settings.format ? !offers(*settings.format) : first == std::end(kPixelFormats)) {
    std::string list = std::move(others);
    for (const PixelFormat f : offered) list.append(list.empty() ? "" : " ").append(name(f));
    return error("does not offer " +
                 (settings.format ? std::string(name(*settings.format)) : std::string("a format that is read here")) +
                 "; it offers " + (list.empty() ? "none" : list));
  }
  LibcameraPlan plan;
  plan.format = settings.format.value_or(*first);
  plan.width = settings.width;
  plan.height = settings.height;
  plan.fps = settings.fps;
  if (settings.exposure.mode == ExposureMode::kFixed) plan.fixed = settings.exposure.fixed;
  plan.buffers = kBuffers;
  auto configured = session_->configure(plan);
  if (!configured) return error(configured.error().message);
  LibcameraGiven given = std::move(configured).value();
  const auto size = [](int width, int height) { return std::to_string(width) + "x" + std::to_string(height); };
  if (given.width != plan.width || given.height != plan.height) {
    return error("gives pictures of " + size(given.width, given.height) + ", not the " + size(plan.width, plan.height) +
                 " of the calibration");
  }
  if (!given.format.empty()) return error("gives " + given.format + " instead of " + name(plan.format));
  format_ = plan.format;
  const int least = row_bytes(format_, plan.width);
  stride_ = given.stride;
  if (format_ != PixelFormat::kMjpeg && (stride_ < least || stride_ > 16 * least)) {
    return error("says its rows take " + std::to_string(stride_) + " bytes; " + std::to_string(least) +
                 " at least are needed");
  }
  if (given.buffers.size() < 2) {
    return error("gives " + std::to_string(given.buffers.size()) + " buffers; two are needed");
  }
  count_ = static_cast<std::uint32_t>(std::min<std::size_t>(given.buffers.size(), kMostBuffers));
  std::copy_n(given.buffers.begin(), count_, buffers_.begin());
  const std::size_t need = picture_bytes(format_, plan.width, plan.height, stride_);
  for (std::uint32_t i = 0; i < count_; ++i) {
    if (buffers_[i].data != nullptr && buffers_[i].bytes >= need) continue;
    return error("its buffers hold " + std::to_string(buffers_[i].bytes) + " bytes; a picture has " +
                 std::to_string(need));
  }
  notes_ = std::move(given.notes);
  return {};
}

bool LibcameraStream::queue(std::uint32_t index) {
  // Partner: the exchange in completed(). The reader is through with the buffer.
  out_[index].store(true, std::memory_order_release);
  return session_->queue(index);
}

void LibcameraStream::keep() {
  std::uint32_t index = 0;
  while (back_.try_pop(&index)) {
    if (queue(index)) continue;
    gone_.store(true, std::memory_order_relaxed);
    wake_.post();
  }
}

void LibcameraStream::completed(const CompletedRequest& request) {
  if (request.index >= count_ || !out_[request.index].exchange(false, std::memory_order_acquire)) {
    return;  // it came back and was not out
  }
  done_.try_push(request);
  wake_.post();
}

void LibcameraStream::disconnected() {
  gone_.store(true, std::memory_order_relaxed);
  wake_.post();
}

PictureStream::Take LibcameraStream::take(rt::TimeNs timeout_ns, Buffer* buffer) {
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + timeout_ns;
  CompletedRequest request;
  // More posts than requests: of those that were taken without a wait.
  while (!done_.try_pop(&request)) {
    if (gone_.load(std::memory_order_relaxed)) return Take::kGone;
    const rt::TimeNs left_ns = give_up_ns - rt::monotonic_now_ns();
    if (left_ns <= 0 || !wake_.wait_for(left_ns)) return Take::kNothing;
  }
  const bool cancelled = request.state == CompletedRequest::State::kCancelled;
  // One that was not filled has no number of its own.
  sequence_ = cancelled ? sequence_ + 1 : request.sequence;
  const LibcameraGiven::Buffer& memory = buffers_[request.index];
  *buffer = {.index = request.index,
             .data = memory.data,
             .bytes = request.bytes,
             .capacity = memory.bytes,
             .stamp_ns = request.stamp_ns,
             .sequence = sequence_,
             .start_of_exposure = request.sensor_stamp,
             .exposure_ns = request.exposure_ns};
  if (!cancelled) {
    cancelled_ = 0;
    return request.state == CompletedRequest::State::kGood ? Take::kPicture : Take::kBroken;
  }
  // One is a picture that failed. As many as there are: it has stopped by itself, and to queue them again would go
  // round without end.
  return ++cancelled_ < count_ ? Take::kBroken : Take::kGone;
}

bool LibcameraStream::give_back(std::uint32_t index) {
  return back_.try_push(index);
}

}  // namespace godwit::hal
