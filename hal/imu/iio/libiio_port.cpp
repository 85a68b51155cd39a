#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <ctime>
#include <iio.h>
#include <mutex>
#include <poll.h>

#include "hal/imu/iio/iio_port.h"
#include "hal/rt/process_end.h"
#include "hal/rt/thread.h"
#include "hal/rt/wake_up.h"

namespace godwit::hal {
namespace {

/// Scans that the driver gathers before it wakes us: two steps of delay at most, with a wake-up for every other sample.
constexpr std::size_t kGather = 2;

class LibiioPort final : public IioPort {
 public:
  LibiioPort(std::string device, double rate_hz, std::function<void(const std::string&)> tell)
      : name_(std::move(device)), rate_hz_(rate_hz), tell_(std::move(tell)) {
    // Without a thread it stays busy for ever; the reader waits in vain, and says so.
    if (auto started = opener_.start("gw-iio", {}, [this] { work(); }); !started) note(started.error().message);
  }
  ~LibiioPort() override {
    if (opener_.running()) {
      order(Order::kEnd);
      rt::join_in_time(&opener_);
    }
    close();
  }
  LibiioPort(const LibiioPort&) = delete;
  LibiioPort& operator=(const LibiioPort&) = delete;

  void begin_open() override { order(Order::kOpen); }
  void begin_close() override { order(Order::kClose); }
  State state() override {
    // Acquire, partner: the release store in work(). What the opener wrote is seen before kOpen.
    const std::uint32_t done = done_.load(std::memory_order_acquire);
    return done >> 2 == ordered_ ? static_cast<State>(done & 3) : State::kBusy;
  }
  const IioDescription& description() override { return description_; }
  std::string error() override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return error_;
  }

  Read read(IioScan* scans, int capacity, rt::TimeNs timeout_ns, int* count) override {
    *count = 0;
    if (next_ == filled_) {
      pollfd p{iio_buffer_get_poll_fd(buffer_), POLLIN, 0};
      const timespec t{static_cast<time_t>(timeout_ns / rt::kNsPerSecond),
                       static_cast<long>(timeout_ns % rt::kNsPerSecond)};
      if (ppoll(&p, 1, &t, nullptr) <= 0) return Read::kNothing;
      if ((p.revents & POLLIN) == 0) return Read::kGone;
      const ssize_t bytes = iio_buffer_refill(buffer_);
      if (bytes == -EAGAIN || bytes == -EINTR || bytes == -ETIMEDOUT) return Read::kNothing;
      if (bytes <= 0) return Read::kGone;
      next_ = static_cast<const char*>(iio_buffer_start(buffer_));
      filled_ = static_cast<const char*>(iio_buffer_end(buffer_));
    }
    const std::ptrdiff_t step = iio_buffer_step(buffer_);
    const char* const start = static_cast<const char*>(iio_buffer_start(buffer_));
    for (; *count < capacity && filled_ - next_ >= step; next_ += step) {
      IioScan& scan = scans[(*count)++];
      const auto place = [&](const iio_channel* c) {
        return next_ + (static_cast<const char*>(iio_buffer_first(buffer_, c)) - start);
      };
      iio_channel_convert(time_, &scan.t_ns, place(time_));
      for (std::size_t i = 0; i < 6; ++i) {
        scan.raw[i] = channel_[i] == nullptr ? 0 : value(channel_[i], place(channel_[i]));
      }
    }
    if (filled_ - next_ < step) next_ = filled_;
    return *count > 0 ? Read::kScans : Read::kNothing;
  }

  rt::TimeNs clock_offset_ns() override { return realtime_ ? -realtime() : 0; }
  rt::TimeNs now_ns() override { return rt::monotonic_now_ns(); }
  void sleep_until(rt::TimeNs t_ns) override { rt::sleep_until_ns(t_ns); }

 private:
  enum class Order : std::uint8_t { kClose, kOpen, kEnd };

  /// The reader's last use of the buffer comes before the opener's closing: release, partner: the acquire in work().
  void order(Order what) {
    ++ordered_;
    order_.store(ordered_ << 2 | static_cast<std::uint32_t>(what), std::memory_order_release);
    wake_.post();
  }

  /// The opener's. Told before error() says it: who has read that need not wait for the words.
  void note(const std::string& error) {
    if (error != error_ && tell_) tell_(error);  // nobody else writes error_
    const std::lock_guard<std::mutex> lock(mutex_);
    error_ = error;
  }

  void work() {
    std::uint32_t seen = 0;
    while (true) {
      wake_.wait_for(rt::kNsPerSecond);
      const std::uint32_t order = order_.load(std::memory_order_acquire);
      if (order == seen) continue;
      seen = order;
      if (static_cast<Order>(order & 3) == Order::kEnd) return;
      State reached = State::kClosed;
      if (static_cast<Order>(order & 3) == Order::kOpen) {
        const auto opened = open();
        if (opened) description_ = opened.value();
        note(opened ? std::string() : opened.error().message);
        reached = opened ? State::kOpen : State::kFailed;
      } else {
        close();
      }
      // Of an order that is no longer the last one the result is not looked at.
      done_.store((order & ~3U) | static_cast<std::uint32_t>(reached), std::memory_order_release);
    }
  }

  rt::Result<IioDescription> open() {
    close();
    context_ = iio_create_local_context();
    if (context_ == nullptr)
      return rt::Error{"iio: this machine has no IIO devices (" + std::string(std::strerror(errno)) + ")"};
    device_ = iio_context_find_device(context_, name_.c_str());
    if (device_ == nullptr) return refuse("iio: no device " + name_ + "; " + listed());
    IioDescription out;
    static constexpr const char* kNames[6] = {"accel_x", "accel_y", "accel_z", "anglvel_x", "anglvel_y", "anglvel_z"};
    for (std::size_t i = 0; i < 6; ++i) {
      channel_[i] = iio_device_find_channel(device_, kNames[i], false);
      if (channel_[i] == nullptr) continue;
      iio_channel_enable(channel_[i]);
      const iio_data_format* const format = iio_channel_get_data_format(channel_[i]);
      // iio_channel_convert writes as many bytes as the format has.
      if (format->length > 32) return refuse("iio: " + name_ + ": readings of more than 32 bits are not read here");
      double scale = 0;
      if (iio_channel_attr_read_double(channel_[i], "scale", &scale) != 0) {
        return refuse("iio: " + name_ + ": channel " + kNames[i] + " has no scale");
      }
      (i < 3 ? out.has_accel : out.has_gyro) = true;
      (i < 3 ? out.accel_scale : out.gyro_scale) = scale;
      (i < 3 ? out.accel_bits : out.gyro_bits) = static_cast<int>(format->bits);
    }
    if (!out.has_accel && !out.has_gyro) return refuse("iio: " + name_ + " measures neither rate nor acceleration");
    time_ = iio_device_find_channel(device_, "timestamp", false);
    if (time_ == nullptr) return refuse("iio: " + name_ + " gives no times: its driver has no buffer");
    iio_channel_enable(time_);
    // The default is CLOCK_REALTIME, which may be set at any moment.
    realtime_ = iio_device_attr_write(device_, "current_timestamp_clock", "monotonic") < 0;
    set_rate(&out);
    choose_trigger();
    buffer_ = iio_device_create_buffer(device_, kGather, false);
    if (buffer_ == nullptr) {
      return refuse("iio: " + name_ + ": its buffer cannot be switched on (no trigger?): " + std::strerror(errno));
    }
    iio_buffer_set_blocking_mode(buffer_, false);
    return out;
  }

  void close() {
    if (buffer_ != nullptr) iio_buffer_destroy(buffer_);
    if (context_ != nullptr) iio_context_destroy(context_);
    buffer_ = nullptr;
    context_ = nullptr;
    device_ = nullptr;
    channel_ = {};
    filled_ = next_ = nullptr;
  }

  rt::Error refuse(const std::string& message) {
    close();
    return rt::Error{message};
  }

  std::string listed() const {
    std::string out;
    for (unsigned i = 0; i < iio_context_get_devices_count(context_); ++i) {
      if (!out.empty()) out.append(", ");
      out.append(name_of(iio_context_get_device(context_, i)));
    }
    return out.empty() ? "there are none" : "there are " + out;
  }

  static rt::TimeNs realtime() {
    timespec t{};
    clock_gettime(CLOCK_REALTIME, &t);
    return static_cast<rt::TimeNs>(t.tv_sec) * rt::kNsPerSecond + t.tv_nsec - rt::monotonic_now_ns();
  }

  /// Some drivers (bmg160, the gyroscope of a BMI088) have a trigger of their own, for new data, and use none until
  /// they are told. Where that does not help, the buffer cannot be switched on, which is told.
  void choose_trigger() {
    const iio_device* chosen = nullptr;
    // None is an empty text, which libiio takes for an error.
    if (iio_device_get_trigger(device_, &chosen) == 0 && chosen != nullptr) return;
    const std::string id = iio_device_get_id(device_), number = id.substr(id.find_first_of("0123456789"));
    const iio_device* const own = iio_context_find_device(context_, (name_of(device_) + "-dev" + number).c_str());
    if (own != nullptr && iio_device_is_trigger(own)) iio_device_set_trigger(device_, own);
  }

  static std::string name_of(const iio_device* device) {
    const char* const name = iio_device_get_name(device);
    return name != nullptr ? name : iio_device_get_id(device);
  }

  /// Drivers have it at the device or at each channel; one that has it nowhere has one rate.
  void set_rate(IioDescription* out) {
    const std::string text = iio_rate_text(rate_hz_);
    if (rate_hz_ > 0 && iio_device_attr_write(device_, "sampling_frequency", text.c_str()) < 0) {
      for (iio_channel* const c : channel_) {
        if (c != nullptr) iio_channel_attr_write(c, "sampling_frequency", text.c_str());
      }
    }
    if (iio_device_attr_read_double(device_, "sampling_frequency", &out->rate_hz) == 0) return;
    for (iio_channel* const c : channel_) {
      if (c != nullptr && iio_channel_attr_read_double(c, "sampling_frequency", &out->rate_hz) == 0) return;
    }
    out->rate_hz = rate_hz_;
  }

  static std::int32_t value(const iio_channel* channel, const char* place) {
    const unsigned bytes = iio_channel_get_data_format(channel)->length / 8;
    std::int8_t one = 0;
    std::int16_t two = 0;
    std::int32_t four = 0;
    switch (bytes) {
      case 1:
        iio_channel_convert(channel, &one, place);
        return one;
      case 2:
        iio_channel_convert(channel, &two, place);
        return two;
      default:
        iio_channel_convert(channel, &four, place);
        return four;
    }
  }

  const std::string name_;
  const double rate_hz_;
  const std::function<void(const std::string&)> tell_;
  std::uint32_t ordered_ = 0;            ///< the reader's: how many orders it gave
  std::atomic<std::uint32_t> order_{0};  ///< reader to opener: number and Order
  std::atomic<std::uint32_t> done_{static_cast<std::uint32_t>(State::kClosed)};  ///< opener to reader: number and State
  rt::WakeUp wake_;
  std::mutex mutex_;
  std::string error_;  ///< under mutex_
  IioDescription description_;
  rt::Thread opener_;
  // The opener's while kBusy, the reader's while kOpen.
  iio_context* context_ = nullptr;
  iio_device* device_ = nullptr;
  iio_buffer* buffer_ = nullptr;
  iio_channel* time_ = nullptr;
  bool realtime_ = false;  ///< the driver's clock is CLOCK_REALTIME and stays so
  std::array<iio_channel*, 6> channel_{};
  const char *next_ = nullptr, *filled_ = nullptr;
};

}  // namespace

std::string iio_rate_text(double rate_hz) {
  char text[32];
  const auto end = std::to_chars(text, text + sizeof text, rate_hz, std::chars_format::fixed, 6).ptr;
  std::string out(text, end);
  out.erase(out.find_last_not_of('0') + 1);
  if (out.back() == '.') out.pop_back();
  return out;
}

std::unique_ptr<IioPort> libiio_port(const std::string& device, double rate_hz,
                                     std::function<void(const std::string&)> tell) {
  return std::make_unique<LibiioPort>(device, rate_hz, std::move(tell));
}

}  // namespace godwit::hal
