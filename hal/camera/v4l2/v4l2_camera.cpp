#include "hal/camera/v4l2/v4l2_camera.h"

#include <algorithm>
#include <utility>

namespace godwit::hal {
namespace {
/// A driver's sequence number that leaps further was counted anew.
constexpr std::uint32_t kMostLost = 1000;
}  // namespace

rt::TimeNs middle_of_exposure(rt::TimeNs stamp_ns, bool at_start, rt::TimeNs exposure_ns, rt::TimeNs readout_ns,
                              bool rolling) {
  if (at_start) return stamp_ns + exposure_ns / 2 + (rolling ? readout_ns / 2 : 0);
  return stamp_ns - exposure_ns / 2 - (rolling ? readout_ns / 2 : readout_ns);
}

rt::Result<std::unique_ptr<V4l2Camera>> V4l2Camera::open(std::unique_ptr<VideoSystem> system,
                                                         const V4l2Settings& settings, Tell tell) {
  std::unique_ptr<V4l2Camera> out(new V4l2Camera(std::move(system), settings, std::move(tell)));
  out->try_open();
  V4l2Camera* const self = out.get();
  if (auto started = self->keeper_.start("gw-v4l2", {}, [self] { self->keep(); }); !started) return started.error();
  return out;
}

V4l2Camera::~V4l2Camera() {
  // Relaxed: it only ends the loop; join() orders the rest.
  stop_.store(true, std::memory_order_relaxed);
  keeper_wake_.post();
  keeper_.join();
}

int V4l2Camera::channels() const {
  const int format = format_.load(std::memory_order_relaxed);
  return format < 0 ? 3 : hal::channels(static_cast<PixelFormat>(format));
}

bool V4l2Camera::real_time() const {
  const int format = format_.load(std::memory_order_relaxed);
  return format >= 0 && static_cast<PixelFormat>(format) != PixelFormat::kMjpeg;
}

bool V4l2Camera::try_open() {
  auto opened = V4l2Stream::open(system_.get(), settings_);
  std::string trouble = opened ? std::string() : opened.error().message;
  if (trouble != trouble_ && tell_) tell_(trouble);
  trouble_ = std::move(trouble);
  if (!opened) return false;
  live_ = std::move(opened).value();
  const V4l2Stream& s = *live_;
  // Whether the thread of next() may be real-time was decided by the first format.
  settings_.format = s.format();
  for (const auto& notes : {s.notes(), exposure_.begin(&s.controls(), settings_.width)}) {
    for (const std::string& note : notes) {
      if (tell_) tell_(note);
    }
  }
  exposure_ns_.store(exposure_.exposure_ns().value_or(settings_.exposure_ns), std::memory_order_relaxed);
  clocks_.write(system_->clock_offsets());
  format_.store(static_cast<int>(s.format()), std::memory_order_relaxed);
  wanted_ = false;
  fresh_.store(live_.get(), std::memory_order_release);
  caller_wake_.post();
  return true;
}

void V4l2Camera::ask() {
  // A device that sets its exposure itself is asked what it chose.
  if (const auto exposure = exposure_.exposure_ns()) exposure_ns_.store(*exposure, std::memory_order_relaxed);
  // Clocks drift, and somebody may set them.
  clocks_.write(system_->clock_offsets());
}

void V4l2Camera::keep() {
  rt::TimeNs due_ns = 0;
  while (!stop_.load(std::memory_order_relaxed)) {
    keeper_wake_.wait_for(kRetryNs);
    if (dead_.exchange(nullptr, std::memory_order_acquire) != nullptr) {
      exposure_.end();
      live_.reset();
      wanted_ = true;
      due_ns = 0;
    }
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    if (live_ != nullptr && exposure_.steer(now_ns)) {
      exposure_ns_.store(exposure_.current().exposure_ns, std::memory_order_relaxed);
    }
    if (now_ns < due_ns) continue;
    due_ns = now_ns + kRetryNs;
    if (wanted_) {
      try_open();
    } else {
      ask();
    }
  }
}

void V4l2Camera::say(rt::LogLevel level, const char* what, const char* which, const char* why, double value) {
  events_.say({.t_ns = system_->now_ns(), .level = level, .what = what, .which = which, .why = why, .value = value});
}

bool V4l2Camera::adopt(rt::TimeNs timeout_ns) {
  V4l2Stream* fresh = fresh_.exchange(nullptr, std::memory_order_acquire);
  if (fresh == nullptr) {
    caller_wake_.wait_for(timeout_ns);
    fresh = fresh_.exchange(nullptr, std::memory_order_acquire);
  }
  if (fresh == nullptr) return false;
  stream_ = fresh;
  clock_.start();
  any_sequence_ = false;
  heard_ns_ = system_->now_ns();
  if (ever_) {
    ++counters_.back;
    say(rt::LogLevel::kInfo, "camera device is back", "", "after [s]", rt::to_seconds(heard_ns_ - lost_ns_));
  }
  ever_ = true;
  return true;
}

void V4l2Camera::lose(const char* why) {
  lost_ns_ = system_->now_ns();
  say(rt::LogLevel::kWarning, "camera device lost", why, "", 0);
  dead_.store(std::exchange(stream_, nullptr), std::memory_order_release);
  keeper_wake_.post();
}

CameraStatus V4l2Camera::next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                              CapturedFrame* frame, std::string* why) {
  if (stream_ == nullptr) {
    const rt::TimeNs began_ns = rt::monotonic_now_ns();
    if (!adopt(timeout_ns)) return CameraStatus::kTimeout;
    timeout_ns -= rt::monotonic_now_ns() - began_ns;
  }
  V4l2Stream::Buffer b;
  V4l2Stream* const stream = stream_;
  const V4l2Stream::Take take = stream->take(std::max<rt::TimeNs>(timeout_ns, 0), &b);
  if (take == V4l2Stream::Take::kNothing) {
    if (system_->now_ns() - heard_ns_ > settings_.stall_ns) {
      ++counters_.stalls;
      lose("it is there, but sends nothing");
    }
    return CameraStatus::kTimeout;
  }
  if (take == V4l2Stream::Take::kGone) {
    ++counters_.gone;
    lose("unplugged, or it refuses");
    return CameraStatus::kTimeout;
  }
  heard_ns_ = system_->now_ns();
  count_due(b.sequence);
  frame->sequence = due_++;
  CameraStatus status = CameraStatus::kBadFrame;
  if (take == V4l2Stream::Take::kBroken) {
    ++counters_.damaged;
    frame->t_source_ns = b.stamp_ns;
    frame->t_capture_ns = heard_ns_;
    if (why != nullptr) why->assign("camera: the driver marks the picture as damaged");
  } else {
    status = deliver(b, grey, bgr, frame, why);
  }
  if (!stream->give_back(b.index)) {
    ++counters_.gone;
    lose("it takes no buffer back");
  }
  return status;
}

void V4l2Camera::count_due(std::uint32_t driver_sequence) {
  const std::uint32_t step = driver_sequence - last_sequence_;
  if (any_sequence_ && step > 1 && step <= kMostLost) {
    counters_.lost += step - 1;
    due_ += step - 1;
  }
  any_sequence_ = true;
  last_sequence_ = driver_sequence;
}

bool V4l2Camera::stamped_at_start(const V4l2Stream::Buffer& b) const {
  return settings_.stamp_at == StampAt::kAsFlagged ? b.start_of_exposure
                                                   : settings_.stamp_at == StampAt::kStartOfExposure;
}

const char* V4l2Camera::read_clock(const V4l2Stream::Buffer& b, rt::TimeNs* t_ns) {
  const bool at_start = stamped_at_start(b);
  const rt::TimeNs exposure = exposure_ns_.load(std::memory_order_relaxed);
  clocks_.read(&offsets_);
  const DeviceClock::Source source = clock_.source();
  if (source == DeviceClock::Source::kBoottime || source == DeviceClock::Source::kRealtime) {
    system_->read_clocks(&offsets_);
  }
  const DeviceClock::Reading r =
      clock_.take(b.stamp_ns, heard_ns_, offsets_, at_start ? exposure + settings_.readout_ns : 0);
  if (r.late) {
    say(rt::LogLevel::kWarning, "camera clock: no picture comes soon after its time by",
        DeviceClock::name(clock_.source()), "soonest [s]", rt::to_seconds(r.off_ns));
  }
  if (r.source_changed && clock_.source() != DeviceClock::Source::kMonotonic) {
    say(rt::LogLevel::kWarning, "camera clock is not CLOCK_MONOTONIC but", DeviceClock::name(clock_.source()),
        "offset [s]", rt::to_seconds(clock_.offset_ns()));
  }
  *t_ns = middle_of_exposure(r.t_ns, at_start, exposure, settings_.readout_ns, settings_.rolling);
  switch (r.verdict) {
    case DeviceClock::Verdict::kGood:
      return nullptr;
    case DeviceClock::Verdict::kRepeats:
      return "camera clock: the device's time stands still";
    case DeviceClock::Verdict::kWentBack:
      return "camera clock: the device's time went back";
    case DeviceClock::Verdict::kJumped:
      say(rt::LogLevel::kWarning, "camera clock jumped", DeviceClock::name(clock_.source()), "by [s]",
          rt::to_seconds(r.off_ns));
      return "camera clock: the device's time jumped; it is followed anew";
  }
  return nullptr;
}

const char* V4l2Camera::unpack(const V4l2Stream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  const V4l2Stream& s = *stream_;
  if (b.bytes > b.capacity) return "camera: the device says it wrote more than the buffer holds";
  if (s.format() == PixelFormat::kMjpeg) return jpeg_.decode(b.data, b.bytes, grey, bgr);
  if (b.bytes < picture_bytes(s.format(), settings_.width, settings_.height, s.stride())) {
    return "camera: the buffer is short, the picture is cut off";
  }
  const int shift = settings_.shift >= 0 ? settings_.shift : usual_shift(s.format());
  convert({.data = b.data, .stride = s.stride(), .format = s.format(), .shift = shift}, grey, bgr);
  return nullptr;
}

CameraStatus V4l2Camera::deliver(const V4l2Stream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr,
                                 CapturedFrame* frame, std::string* why) {
  frame->t_source_ns = b.stamp_ns;
  frame->t_capture_ns = heard_ns_;
  const char* wrong = read_clock(b, &frame->t_capture_ns);
  if (wrong != nullptr) {
    ++counters_.clock;
  } else if (grey.data == nullptr) {
    ++counters_.passed_over;
    return CameraStatus::kFrame;
  } else {
    wrong = unpack(b, grey, bgr);
    if (wrong != nullptr) ++counters_.damaged;
    if (wrong == nullptr && exposure_.saw(grey)) keeper_wake_.post();
  }
  if (wrong != nullptr) {
    if (why != nullptr) why->assign(wrong);
    return CameraStatus::kBadFrame;
  }
  ++counters_.delivered;
  return CameraStatus::kFrame;
}

}  // namespace godwit::hal
