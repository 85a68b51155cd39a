#include "hal/imu/iio/iio_imu.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace godwit::hal {
namespace {
constexpr rt::TimeNs kFirstOpeningNs = 2 * rt::kNsPerSecond;
}  // namespace

std::unique_ptr<IioImu> IioImu::open(std::unique_ptr<IioPort> gyro, std::unique_ptr<IioPort> accel,
                                     const IioSettings& settings) {
  std::unique_ptr<IioImu> out(new IioImu(settings));
  out->lines_[0].port = std::move(gyro);
  out->lines_[1].port = std::move(accel);
  const rt::TimeNs give_up_ns = out->lines_[0].port->now_ns() + kFirstOpeningNs;
  while (!out->running_ && out->trouble().empty() && out->lines_[0].port->now_ns() < give_up_ns) {
    out->come_up(give_up_ns);
  }
  return out;
}

std::string IioImu::trouble() const {
  if (running_) return "";
  if (trouble_ != nullptr) return trouble_;
  for (const Line& line : lines_) {
    if (line.port == nullptr) continue;
    std::string error = line.port->error();
    if (!error.empty()) return error;
  }
  return "";
}

const char* IioImu::start() {
  for (Line& line : lines_) {
    if (line.port == nullptr) continue;
    line.is = line.port->description();
    line.count = line.next = 0;
    line.heard_ns = line.port->now_ns();
    line.last_ns = 0;
    line.offset_ns = line.port->clock_offset_ns();
    line.clock.resume();
    if (line.is.rate_hz > 0 && std::abs(line.is.rate_hz - settings_.rate_hz) > 0.05 * settings_.rate_hz) {
      events_.say({.t_ns = line.heard_ns,
                   .level = rt::LogLevel::kWarning,
                   .what = "IMU does not take the rate",
                   .why = "gives [Hz], wanted",
                   .value = line.is.rate_hz,
                   .limit = settings_.rate_hz});
    }
  }
  if (!lines_[0].is.has_gyro) return "imu.device measures no rates";
  if (!accel_is().has_accel) {
    return two() ? "imu.accel_device measures no acceleration"
                 : "imu.device measures no acceleration; imu.accel_device names the device that does";
  }
  check_.reset();
  around_ = {};
  waiting_ = false;
  return nullptr;
}

ImuStatus IioImu::come_up(rt::TimeNs give_up_ns) {
  IioPort& port = *lines_[0].port;
  if (!opening_) {
    port.sleep_until(std::min(give_up_ns, retry_ns_));
    if (port.now_ns() < retry_ns_) return ImuStatus::kTimeout;
    for (Line& line : lines_) {
      if (line.port != nullptr) line.port->begin_open();
    }
    opening_ = true;
  }
  while (true) {
    bool busy = false, failed = false;
    for (const Line& line : lines_) {
      if (line.port == nullptr) continue;
      const IioPort::State state = line.port->state();
      busy = busy || state == IioPort::State::kBusy;
      failed = failed || state == IioPort::State::kFailed;
    }
    if (!busy) {
      opening_ = false;
      if (failed) return fail(nullptr);
      if (const char* const why = start()) return fail(why);
      break;
    }
    if (port.now_ns() >= give_up_ns) return ImuStatus::kTimeout;
    port.sleep_until(std::min(give_up_ns, port.now_ns() + kLookNs));
  }
  trouble_ = nullptr;
  running_ = true;
  if (gap_) {
    ++counters_.restarts;
    events_.say({.t_ns = port.now_ns(), .what = "IMU is back"});
  }
  return ImuStatus::kSample;
}

ImuStatus IioImu::fail(const char* why) {
  if (running_ || !gap_) {
    events_.say({.t_ns = lines_[0].port->now_ns(),
                 .level = rt::LogLevel::kWarning,
                 .what = "IMU fails",
                 .which = why != nullptr ? why : "it cannot be opened"});
  }
  trouble_ = why;
  running_ = false;
  gap_ = true;
  for (Line& line : lines_) {
    if (line.port != nullptr) line.port->begin_close();
  }
  retry_ns_ = lines_[0].port->now_ns() + kRetryNs;
  return ImuStatus::kFault;
}

ImuStatus IioImu::take(Line* line, rt::TimeNs give_up_ns, IioScan* scan) {
  while (true) {
    const rt::TimeNs now = line->port->now_ns();
    if (line->next == line->count) {
      line->next = line->count = 0;
      const auto read =
          line->port->read(line->scans.data(), kBatch, std::max<rt::TimeNs>(0, give_up_ns - now), &line->count);
      if (read == IioPort::Read::kGone) return fail("the device is gone");
      if (read == IioPort::Read::kNothing) {
        const rt::TimeNs silent = line->port->now_ns() - line->heard_ns;
        return silent > kSilentNs ? fail("it is there, but takes no samples") : ImuStatus::kTimeout;
      }
      line->heard_ns = line->port->now_ns();
      const rt::TimeNs offset = line->port->clock_offset_ns(), moved = offset - line->offset_ns;
      line->offset_ns = offset;
      if (std::abs(moved) > OwnClock::kFutureNs) {
        // Somebody set the driver's clock; which of these were stamped before that, nobody knows.
        events_.say({.t_ns = line->heard_ns,
                     .level = rt::LogLevel::kWarning,
                     .what = "IMU clock was set",
                     .why = "by [s]",
                     .value = rt::to_seconds(moved)});
        ++counters_.wrong_time;
        line->count = 0;
        return ImuStatus::kFault;
      }
    }
    *scan = line->scans[line->next++];
    const rt::TimeNs off_ns = scan->t_ns + line->offset_ns - line->heard_ns;
    const OwnClock::Verdict verdict = line->clock.take(scan->t_ns + line->offset_ns, line->heard_ns, &scan->t_ns);
    if (verdict != OwnClock::Verdict::kGood) {
      if (counters_.wrong_time++ == 0) {
        events_.say({.t_ns = now,
                     .level = rt::LogLevel::kWarning,
                     .what = "IMU clock is not CLOCK_MONOTONIC",
                     .why = "off by [s]",
                     .value = rt::to_seconds(off_ns)});
      }
      if (verdict == OwnClock::Verdict::kFollowed) {
        line->last_ns = 0;  // on the clock until now
        events_.say(
            {.t_ns = now, .what = "IMU clock is followed", .why = "off by [s]", .value = rt::to_seconds(off_ns)});
      }
      return ImuStatus::kFault;
    }
    if (scan->t_ns <= line->last_ns) {
      ++counters_.out_of_order;
      continue;
    }
    line->last_ns = scan->t_ns;
    return ImuStatus::kSample;
  }
}

ImuStatus IioImu::accel_at(rt::TimeNs t_ns, rt::TimeNs give_up_ns, std::array<double, 3>* raw) {
  while (around_[1].t_ns < t_ns) {
    IioScan scan;
    const ImuStatus status = take(&lines_[1], give_up_ns, &scan);
    if (status != ImuStatus::kSample) return status;
    around_[0] = around_[1];
    around_[1] = {scan.t_ns, {scan.raw[0], scan.raw[1], scan.raw[2]}};
  }
  const Accel &a = around_[0], &b = around_[1];
  // Before the first: the nearest there is, within a step.
  const double share =
      a.t_ns == 0 || a.t_ns >= t_ns ? 1.0 : static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns);
  for (std::size_t i = 0; i < 3; ++i) (*raw)[i] = a.raw[i] + share * (b.raw[i] - a.raw[i]);
  return ImuStatus::kSample;
}

ImuStatus IioImu::next(ImuSample* sample, rt::TimeNs timeout_ns) {
  IioPort& port = *lines_[0].port;
  const rt::TimeNs give_up = port.now_ns() + timeout_ns;
  if (!running_) {
    const ImuStatus status = come_up(give_up);
    if (status != ImuStatus::kSample) return status;
  }
  if (!waiting_) {
    const ImuStatus status = take(&lines_[0], give_up, &held_);
    if (status != ImuStatus::kSample) return status;
  }
  std::array<double, 3> accel{static_cast<double>(held_.raw[0]), static_cast<double>(held_.raw[1]),
                              static_cast<double>(held_.raw[2])};
  if (two()) {
    waiting_ = true;
    const ImuStatus status = accel_at(held_.t_ns, give_up, &accel);
    if (status != ImuStatus::kSample) return status;
    waiting_ = false;
  }
  return finish(held_, accel, sample);
}

ImuRanges IioImu::ranges() const {
  const auto end = [](int bits, double scale) { return bits > 0 ? std::ldexp(std::abs(scale), bits - 1) : 0; };
  return {end(lines_[0].is.gyro_bits, lines_[0].is.gyro_scale), end(accel_is().accel_bits, accel_is().accel_scale)};
}

ImuStatus IioImu::finish(const IioScan& scan, const std::array<double, 3>& accel, ImuSample* sample) {
  std::array<std::int32_t, 6> raw = scan.raw;
  for (std::size_t i = 0; i < 3; ++i) raw[i] = static_cast<std::int32_t>(std::lround(accel[i]));
  if (const char* const why = check_.look(raw)) {
    ++counters_.nonsense;
    return fail(why);
  }
  *sample = {};
  sample->t_ns = scan.t_ns;
  // HID sensors give 32 bits.
  const std::int64_t accel_end = (std::int64_t{1} << (accel_is().accel_bits - 1)) - 1,
                     gyro_end = (std::int64_t{1} << (lines_[0].is.gyro_bits - 1)) - 1;
  std::array<double, 3> a{}, g{};
  for (std::size_t i = 0; i < 3; ++i) {
    a[i] = accel[i] * accel_is().accel_scale;
    g[i] = scan.raw[3 + i] * lines_[0].is.gyro_scale;
    if (std::abs(std::int64_t{raw[i]}) >= accel_end) sample->flags |= kImuAccelSaturated;
    if (std::abs(std::int64_t{raw[3 + i]}) >= gyro_end) sample->flags |= kImuGyroSaturated;
  }
  if (sample->flags != 0) ++counters_.saturated;
  const bool step_missing =
      last_ns_ != 0 && static_cast<double>(scan.t_ns - last_ns_) * rate_hz() > 1.5 * rt::kNsPerSecond;
  if (step_missing) ++counters_.gaps;
  if (step_missing || gap_) sample->flags |= kImuGap;
  gap_ = false;
  last_ns_ = scan.t_ns;
  sample->accel_m_s2 = settings_.axes.apply(a);
  sample->gyro_rad_s = settings_.axes.apply(g);
  ++counters_.samples;
  return ImuStatus::kSample;
}

}  // namespace godwit::hal
