#include "hal/camera/v4l2/v4l2_stream.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <linux/videodev2.h>

namespace godwit::hal {
namespace {

constexpr std::uint32_t kCapture = V4L2_BUF_TYPE_VIDEO_CAPTURE;

std::string size_text(std::uint32_t width, std::uint32_t height) {
  return std::to_string(width) + "x" + std::to_string(height);
}

std::string code_text(std::uint32_t code) {
  std::string out;
  for (int i = 0; i < 4; ++i) {
    const auto c = static_cast<unsigned char>(code >> (8 * i));
    out += std::isprint(c) != 0 ? static_cast<char>(c) : '?';
  }
  return out;
}

}  // namespace

rt::Error V4l2Stream::error(const char* what) const {
  return rt::Error{path_ + ": " + what + ": " + std::strerror(errno)};
}

rt::Result<void> V4l2Stream::check_device() {
  v4l2_capability caps{};
  if (!call(VIDIOC_QUERYCAP, &caps)) return rt::Error{path_ + ": not a V4L2 device: " + std::strerror(errno)};
  const std::uint32_t can = (caps.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? caps.device_caps : caps.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0) {
    return rt::Error{path_ + ((can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0
                                  ? ": gives pictures in several planes only, which are not read here"
                                  : ": gives no pictures (another node of the same camera may)")};
  }
  if ((can & V4L2_CAP_STREAMING) == 0) return rt::Error{path_ + ": cannot stream into mapped buffers"};
  return {};
}

rt::Result<void> V4l2Stream::choose_format(const V4l2Settings& settings) {
  std::vector<std::uint32_t> offered;
  for (std::uint32_t i = 0; i < 256; ++i) {  // a device that lists without end
    v4l2_fmtdesc d{};
    d.index = i;
    d.type = kCapture;
    if (!call(VIDIOC_ENUM_FMT, &d)) break;
    offered.push_back(d.pixelformat);
  }
  const auto offers = [&](PixelFormat f) {
    return std::find(offered.begin(), offered.end(), fourcc(f)) != offered.end();
  };
  const auto* const first = std::find_if(std::begin(kPixelFormats), std::end(kPixelFormats), offers);
  const bool found = settings.format ? offers(*settings.format) : first != std::end(kPixelFormats);
  if (!found) {
    std::string list;
    for (const std::uint32_t code : offered) list.append(" ").append(code_text(code));
    return rt::Error{
        path_ + ": does not offer " +
        (settings.format ? std::string(name(*settings.format)) : std::string("a format that is read here")) +
        "; it offers" + (list.empty() ? " none" : list)};
  }
  format_ = settings.format.value_or(*first);

  const auto width = static_cast<std::uint32_t>(settings.width), height = static_cast<std::uint32_t>(settings.height);
  v4l2_format f{};
  f.type = kCapture;
  f.fmt.pix.width = width;
  f.fmt.pix.height = height;
  f.fmt.pix.pixelformat = fourcc(format_);
  f.fmt.pix.field = V4L2_FIELD_NONE;
  if (!call(VIDIOC_S_FMT, &f)) return error("the format is refused");
  // A device with a scaler may go on writing the old part of the larger buffer.
  v4l2_selection s{};
  s.type = kCapture;
  s.target = V4L2_SEL_TGT_COMPOSE;
  if (call(VIDIOC_G_SELECTION, &s) && (s.r.width != width || s.r.height != height || s.r.left != 0 || s.r.top != 0)) {
    s.r = {0, 0, width, height};
    s.flags = 0;
    if (!call(VIDIOC_S_SELECTION, &s) || s.r.width != width || s.r.height != height) {
      return rt::Error{path_ + ": its scaler does not fill a picture of " + size_text(width, height)};
    }
    if (!call(VIDIOC_G_FMT, &f)) return error("the format cannot be read back");
  }
  if (f.fmt.pix.width != width || f.fmt.pix.height != height) {
    return rt::Error{path_ + ": gives pictures of " + size_text(f.fmt.pix.width, f.fmt.pix.height) + ", not the " +
                     size_text(width, height) + " of the calibration"};
  }
  if (f.fmt.pix.pixelformat != fourcc(format_)) {
    return rt::Error{path_ + ": gives " + code_text(f.fmt.pix.pixelformat) + " instead of " + name(format_)};
  }
  if (f.fmt.pix.field != V4L2_FIELD_NONE && f.fmt.pix.field != V4L2_FIELD_ANY) {
    return rt::Error{path_ + ": gives interlaced pictures, which are two moments in one"};
  }
  width_ = settings.width;
  const int least = row_bytes(format_, width_);
  stride_ = static_cast<int>(f.fmt.pix.bytesperline);
  if (stride_ == 0) stride_ = least;  // old drivers leave it out where there is no padding
  if (format_ != PixelFormat::kMjpeg && (stride_ < least || stride_ > 16 * least)) {
    return rt::Error{path_ + ": says its rows take " + std::to_string(stride_) + " bytes; " + std::to_string(least) +
                     " at least are needed"};
  }
  return {};
}

void V4l2Stream::set_rate(double fps) {
  v4l2_streamparm p{};
  p.type = kCapture;
  if (fps > 0) {
    p.parm.capture.timeperframe = {1000, static_cast<std::uint32_t>(std::lround(fps * 1000))};
    call(VIDIOC_S_PARM, &p);  // what became of it is read below
  }
  p = {};
  p.type = kCapture;
  if (!call(VIDIOC_G_PARM, &p)) {
    if (fps > 0) notes_.push_back(path_ + ": its frame rate cannot be set");
    return;
  }
  const v4l2_fract t = p.parm.capture.timeperframe;
  if (t.numerator > 0) fps_ = static_cast<double>(t.denominator) / t.numerator;
  if (fps > 0 && std::abs(fps_ - fps) > 0.01 * fps) {
    char text[96];
    std::snprintf(text, sizeof text, ": gives %.2f pictures a second, not %.2f", fps_, fps);
    notes_.push_back(path_ + text);
  }
}

rt::Result<void> V4l2Stream::map_buffers() {
  v4l2_requestbuffers r{};
  r.count = kBuffers;
  r.type = kCapture;
  r.memory = V4L2_MEMORY_MMAP;
  if (!call(VIDIOC_REQBUFS, &r)) return error(errno == EBUSY ? "another program uses it" : "gives no buffers");
  if (r.count < 2) return rt::Error{path_ + ": gives " + std::to_string(r.count) + " buffers; two are needed"};
  count_ = std::min(r.count, kBuffers);
  for (std::uint32_t i = 0; i < count_; ++i) {
    v4l2_buffer b{};
    b.index = i;
    b.type = kCapture;
    b.memory = V4L2_MEMORY_MMAP;
    if (!call(VIDIOC_QUERYBUF, &b)) return error("a buffer cannot be asked for");
    buffers_[i].memory = system_->map(fd_, b.length, b.m.offset);
    if (buffers_[i].memory == nullptr) return error("a buffer cannot be mapped");
    buffers_[i].bytes = b.length;
    if (!call(VIDIOC_QBUF, &b)) return error("a buffer is refused");
  }
  return {};
}

rt::Result<std::unique_ptr<V4l2Stream>> V4l2Stream::open(VideoSystem* system, const V4l2Settings& settings) {
  const bool path_given = settings.device.find('/') == 0;
  const VideoChoice choice =
      choose_video_node(settings.device, path_given ? std::vector<VideoNode>() : system->nodes());
  if (!choice.error.empty()) return rt::Error{choice.error};
  std::unique_ptr<V4l2Stream> out(new V4l2Stream(system, choice.path));
  out->fd_ = system->open(choice.path.c_str());
  if (out->fd_ < 0) return out->error("cannot be opened");
  if (auto r = out->check_device(); !r) return r.error();
  if (auto r = out->choose_format(settings); !r) return r.error();
  out->set_rate(settings.fps);
  out->controls_.emplace(system, out->fd_, choice.path);
  if (auto r = out->controls_->set_all(settings.controls); !r) return r.error();
  if (auto r = out->map_buffers(); !r) return r.error();
  const std::size_t need = picture_bytes(out->format_, settings.width, settings.height, out->stride_);
  for (std::uint32_t i = 0; i < out->count_; ++i) {
    if (out->buffers_[i].bytes >= need) continue;
    return rt::Error{out->path_ + ": its buffers hold " + std::to_string(out->buffers_[i].bytes) +
                     " bytes; a picture has " + std::to_string(need)};
  }
  int type = kCapture;
  if (!out->call(VIDIOC_STREAMON, &type)) return out->error("does not begin to stream");
  out->streaming_ = true;
  return out;
}

V4l2Stream::~V4l2Stream() {
  int type = kCapture;
  if (streaming_) call(VIDIOC_STREAMOFF, &type);
  for (const Mapping& m : buffers_) {
    if (m.memory != nullptr) system_->unmap(m.memory, m.bytes);
  }
  if (fd_ >= 0) system_->close(fd_);
}

V4l2Stream::Take V4l2Stream::take(rt::TimeNs timeout_ns, Buffer* buffer) {
  const VideoSystem::Wait wait = system_->wait_readable(fd_, timeout_ns);
  if (wait == VideoSystem::Wait::kTimeout) return Take::kNothing;
  if (wait == VideoSystem::Wait::kGone) return Take::kGone;
  v4l2_buffer b{};
  b.type = kCapture;
  b.memory = V4L2_MEMORY_MMAP;
  if (!call(VIDIOC_DQBUF, &b)) return errno == EAGAIN ? Take::kNothing : Take::kGone;
  if (b.index >= count_) return Take::kGone;  // a driver that counts wrongly: nothing it says can be believed
  const Mapping& m = buffers_[b.index];
  *buffer = {.index = b.index,
             .data = static_cast<const std::uint8_t*>(m.memory),
             .bytes = b.bytesused,
             .capacity = m.bytes,
             .stamp_ns = static_cast<rt::TimeNs>(b.timestamp.tv_sec) * rt::kNsPerSecond + b.timestamp.tv_usec * 1000,
             .sequence = b.sequence,
             .start_of_exposure = (b.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE};
  return (b.flags & V4L2_BUF_FLAG_ERROR) != 0 ? Take::kBroken : Take::kPicture;
}

bool V4l2Stream::give_back(std::uint32_t index) {
  v4l2_buffer b{};
  b.index = index;
  b.type = kCapture;
  b.memory = V4L2_MEMORY_MMAP;
  return call(VIDIOC_QBUF, &b);
}

}  // namespace godwit::hal
