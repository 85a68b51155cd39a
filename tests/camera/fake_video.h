// A V4L2 device that a test plays: it answers as told, truthfully or not, and its clock goes when the test says so.
#pragma once

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <deque>
#include <functional>
#include <linux/usb/video.h>
#include <linux/uvcvideo.h>
#include <linux/videodev2.h>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "hal/camera/v4l2/video_system.h"

namespace godwit::test {

/// Held for a few instructions; a mutex would count as a lock of the thread under test.
class Spin {
 public:
  void lock() {
    while (flag_.test_and_set(std::memory_order_acquire)) {
    }
  }
  void unlock() { flag_.clear(std::memory_order_release); }

 private:
  std::atomic_flag flag_ = ATOMIC_FLAG_INIT;
};

/// The device's side: what it is, and the pictures it has taken.
struct FakeDevice {
  // What it says of itself.
  std::uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  std::vector<std::uint32_t> formats{V4L2_PIX_FMT_GREY};
  std::uint32_t width = 0, height = 0;  ///< of what it gives; 0: as asked
  std::uint32_t stride = 0;             ///< 0: no padding
  std::uint32_t buffer_bytes = 0;       ///< 0: as many as needed
  std::uint32_t field = V4L2_FIELD_NONE;
  std::uint32_t fps = 30;
  bool takes_fps = false, tells_fps = true;
  v4l2_fract asked_interval{};  ///< by VIDIOC_S_PARM, by the camera's own thread before it streams
  int stream_on_error = 0, request_error = 0;
  std::map<std::uint32_t, std::pair<std::string, std::int32_t>> controls;
  std::map<std::uint32_t, std::pair<std::string, std::int64_t>> controls64;
  /// By unit and selector: a control's bytes. Whether it keeps what it had.
  std::map<std::pair<int, int>, std::vector<std::uint8_t>> extension_units;
  bool stubborn = false;
  godwit::hal::ClockOffsets offsets;
  std::vector<godwit::hal::VideoNode> listed;

  // What happens to it.
  std::atomic<bool> there{true};
  std::atomic<godwit::rt::TimeNs> now_ns{100 * godwit::rt::kNsPerSecond};
  std::atomic<int> tried{0}, opened{0}, closed{0}, mapped{0};
  std::atomic<bool> streaming{false};
  std::atomic<godwit::rt::TimeNs> longest_wait_ns{0};
  bool real_waits = false;  ///< the clock goes only when the test says so
  /// Whoever sets a control waits as long as this is true.
  std::atomic<bool> holds_settings{false};
  std::atomic<int> held{0};

  struct Shot {
    std::uint8_t value;
    godwit::rt::TimeNs stamp_ns;
    std::uint32_t sequence;
    std::uint32_t flags;
    std::int64_t bytes;  ///< -1: as many as it has
  };

  std::int32_t control(std::uint32_t id) {
    spin.lock();
    const std::int32_t out = controls.at(id).second;
    spin.unlock();
    return out;
  }

  /// A picture whose bytes are all `value` is there from now on. False: no buffer is free (the driver would lose it).
  bool shoot(std::uint8_t value, godwit::rt::TimeNs stamp_ns, std::uint32_t sequence, std::uint32_t flags = 0,
             std::int64_t bytes = -1) {
    spin.lock();
    const bool room = streaming && queued > 0;
    if (room) {
      const std::uint32_t index = queue[queue_head++ % 32];
      --queued;
      std::memset(memory[index].get(), value, sizes[index]);
      if (!jpeg.empty()) std::memcpy(memory[index].get(), jpeg.data(), std::min(jpeg.size(), sizes[index]));
      if (fill) fill(memory[index].get());
      shots[(shot_head + shot_count++) % 32] = {Shot{value, stamp_ns, sequence, flags, bytes}, index};
    }
    spin.unlock();
    return room;
  }

  std::vector<std::uint8_t> jpeg;
  std::function<void(std::uint8_t*)> fill;
  Spin spin;
  std::unique_ptr<std::uint8_t[]> memory[32];
  std::size_t sizes[32] = {};
  std::uint32_t queue[32] = {};
  unsigned queue_head = 0, queued = 0;
  std::pair<Shot, std::uint32_t> shots[32];
  unsigned shot_head = 0, shot_count = 0;
  std::uint32_t image_bytes = 0;
};

class FakeVideo final : public godwit::hal::VideoSystem {
 public:
  explicit FakeVideo(FakeDevice* device) : d_(*device) {}

  int open(const char* path) override {
    ++d_.tried;
    if (!d_.there || std::string(path).find("/dev/video") != 0) return errno = ENOENT, -1;
    return 100 + d_.opened++;
  }
  void close(int) override { ++d_.closed; }
  void* map(int, std::size_t bytes, std::int64_t offset) override {
    ++d_.mapped;
    d_.memory[offset] = std::make_unique<std::uint8_t[]>(bytes);
    d_.sizes[offset] = bytes;
    return d_.memory[offset].get();
  }
  void unmap(void*, std::size_t) override { --d_.mapped; }
  Wait wait_readable(int, godwit::rt::TimeNs timeout_ns) override {
    if (!d_.there) return Wait::kGone;
    d_.longest_wait_ns = std::max<godwit::rt::TimeNs>(d_.longest_wait_ns, timeout_ns);
    if (d_.shot_count > 0) return Wait::kReady;
    if (d_.real_waits) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    } else {
      d_.now_ns += timeout_ns;
    }
    return Wait::kTimeout;
  }
  godwit::rt::TimeNs now_ns() override { return d_.now_ns; }
  godwit::hal::ClockOffsets clock_offsets() override {
    godwit::hal::ClockOffsets out;
    d_.spin.lock();
    out = d_.offsets;
    d_.spin.unlock();
    return out;
  }
  void read_clocks(godwit::hal::ClockOffsets* offsets) override {
    const godwit::hal::ClockOffsets now = clock_offsets();
    offsets->boottime_ns = now.boottime_ns;
    offsets->realtime_ns = now.realtime_ns;
  }
  std::vector<godwit::hal::VideoNode> nodes() override { return d_.listed; }

  int ioctl(int, unsigned long request, void* argument) override {
    if (!d_.there) return fail(ENODEV);
    switch (request) {
      case VIDIOC_QUERYCAP: {
        static_cast<v4l2_capability*>(argument)->capabilities = d_.capabilities;
        return 0;
      }
      case VIDIOC_ENUM_FMT: {
        auto* f = static_cast<v4l2_fmtdesc*>(argument);
        if (f->index >= d_.formats.size()) return fail(EINVAL);
        f->pixelformat = d_.formats[f->index];
        return 0;
      }
      case VIDIOC_S_FMT:
        return set_format(&static_cast<v4l2_format*>(argument)->fmt.pix);
      case VIDIOC_G_PARM: {
        if (!d_.tells_fps) return fail(ENOTTY);
        static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe = {1, d_.fps};
        return 0;
      }
      case VIDIOC_S_PARM: {
        d_.asked_interval = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
        if (d_.takes_fps) d_.fps = d_.asked_interval.denominator / d_.asked_interval.numerator;
        return 0;
      }
      case VIDIOC_QUERYCTRL:
        return query(static_cast<v4l2_queryctrl*>(argument));
      case VIDIOC_G_CTRL:
      case VIDIOC_S_CTRL: {
        auto* c = static_cast<v4l2_control*>(argument);
        const auto known = d_.controls.find(c->id);
        if (known == d_.controls.end()) return fail(EINVAL);
        d_.spin.lock();
        (request == VIDIOC_G_CTRL ? c->value : known->second.second) =
            request == VIDIOC_G_CTRL ? known->second.second : c->value;
        d_.spin.unlock();
        if (request == VIDIOC_S_CTRL && d_.holds_settings) ++d_.held;
        while (request == VIDIOC_S_CTRL && d_.holds_settings) std::this_thread::sleep_for(std::chrono::milliseconds(1));
        return 0;
      }
      case VIDIOC_QUERY_EXT_CTRL: {
        auto* q = static_cast<v4l2_query_ext_ctrl*>(argument);
        if (d_.controls64.count(q->id) == 0) return fail(EINVAL);
        q->minimum = 10;
        q->maximum = 100'000'000'000;
        q->step = 1;
        return 0;
      }
      case VIDIOC_G_EXT_CTRLS: {
        auto* all = static_cast<v4l2_ext_controls*>(argument);
        const auto known = d_.controls64.find(all->controls[0].id);
        if (all->count != 1 || known == d_.controls64.end()) return fail(EINVAL);
        all->controls[0].value64 = known->second.second;
        return 0;
      }
      case VIDIOC_S_EXT_CTRLS: {
        auto* all = static_cast<v4l2_ext_controls*>(argument);
        const auto known = d_.controls64.find(all->controls[0].id);
        if (all->count != 1 || known == d_.controls64.end()) return fail(EINVAL);
        known->second.second = all->controls[0].value64;
        return 0;
      }
      case UVCIOC_CTRL_QUERY:
        return d_.extension_units.empty() ? fail(ENOTTY) : ask_unit(*static_cast<uvc_xu_control_query*>(argument));
      case VIDIOC_REQBUFS:
        return d_.request_error != 0 ? fail(d_.request_error) : 0;
      case VIDIOC_QUERYBUF: {
        auto* b = static_cast<v4l2_buffer*>(argument);
        b->length = d_.image_bytes;
        b->m.offset = b->index;
        return 0;
      }
      case VIDIOC_QBUF:
        d_.spin.lock();
        d_.queue[(d_.queue_head + d_.queued++) % 32] = static_cast<v4l2_buffer*>(argument)->index;
        d_.spin.unlock();
        return 0;
      case VIDIOC_DQBUF:
        return take(static_cast<v4l2_buffer*>(argument));
      case VIDIOC_STREAMON:
        if (d_.stream_on_error != 0) return fail(d_.stream_on_error);
        d_.streaming = true;
        return 0;
      case VIDIOC_STREAMOFF:
        d_.streaming = false;
        return 0;
      default:
        return fail(ENOTTY);
    }
  }

 private:
  static int fail(int error) { return errno = error, -1; }

  int ask_unit(const uvc_xu_control_query& q) {
    const auto known = d_.extension_units.find({q.unit, q.selector});
    if (known == d_.extension_units.end()) return fail(ENOENT);
    std::vector<std::uint8_t>& bytes = known->second;
    if (q.query == UVC_GET_LEN) {
      if (q.size != 2) return fail(ENOBUFS);
      q.data[0] = static_cast<std::uint8_t>(bytes.size());
      q.data[1] = 0;
      return 0;
    }
    if (q.size != bytes.size()) return fail(ENOBUFS);
    if (q.query == UVC_GET_CUR) return std::copy(bytes.begin(), bytes.end(), q.data), 0;
    if (q.query != UVC_SET_CUR) return fail(EINVAL);
    if (!d_.stubborn) bytes.assign(q.data, q.data + q.size);
    return 0;
  }

  int set_format(v4l2_pix_format* f) {
    if (d_.width != 0) f->width = d_.width;
    if (d_.height != 0) f->height = d_.height;
    const std::uint32_t pixel = f->pixelformat == V4L2_PIX_FMT_GREY || f->pixelformat == V4L2_PIX_FMT_NV12 ? 1 : 2;
    f->bytesperline = d_.stride != 0 ? d_.stride : f->width * pixel;
    f->field = d_.field;
    f->sizeimage = f->bytesperline * f->height * (f->pixelformat == V4L2_PIX_FMT_NV12 ? 3 : 2) / 2;
    if (d_.buffer_bytes != 0) f->sizeimage = d_.buffer_bytes;
    d_.spin.lock();
    d_.image_bytes = f->sizeimage;
    d_.queued = d_.shot_count = 0;
    d_.spin.unlock();
    return 0;
  }
  int query(v4l2_queryctrl* q) {
    const bool next = (q->id & V4L2_CTRL_FLAG_NEXT_CTRL) != 0;
    const std::uint32_t id = q->id & ~V4L2_CTRL_FLAG_NEXT_CTRL;
    const auto found = next ? d_.controls.upper_bound(id) : d_.controls.find(id);
    if (found == d_.controls.end()) {  // those of 64 bits have the higher numbers, as a driver's own have
      const auto wide = next ? d_.controls64.upper_bound(id) : d_.controls64.find(id);
      if (wide == d_.controls64.end()) return fail(EINVAL);
      q->id = wide->first;
      q->type = V4L2_CTRL_TYPE_INTEGER64;
      std::strncpy(reinterpret_cast<char*>(q->name), wide->second.first.c_str(), sizeof q->name - 1);
      return 0;
    }
    q->type = V4L2_CTRL_TYPE_INTEGER;
    q->id = found->first;
    std::strncpy(reinterpret_cast<char*>(q->name), found->second.first.c_str(), sizeof q->name - 1);
    q->minimum = 1;
    q->maximum = 1000;
    q->flags = 0;
    return 0;
  }
  int take(v4l2_buffer* b) {
    d_.spin.lock();
    const bool any = d_.shot_count > 0;
    std::pair<FakeDevice::Shot, std::uint32_t> shot{};
    if (any) {
      shot = d_.shots[d_.shot_head++ % 32];
      --d_.shot_count;
    }
    d_.spin.unlock();
    if (!any) return fail(EAGAIN);
    const FakeDevice::Shot& s = shot.first;
    b->index = shot.second;
    b->bytesused = s.bytes >= 0       ? static_cast<std::uint32_t>(s.bytes)
                   : !d_.jpeg.empty() ? static_cast<std::uint32_t>(d_.jpeg.size())
                                      : static_cast<std::uint32_t>(d_.sizes[shot.second]);
    b->timestamp.tv_sec = s.stamp_ns / godwit::rt::kNsPerSecond;
    b->timestamp.tv_usec = s.stamp_ns % godwit::rt::kNsPerSecond / 1000;
    b->sequence = s.sequence;
    b->flags = s.flags;
    return 0;
  }

  FakeDevice& d_;
};

}  // namespace godwit::test
