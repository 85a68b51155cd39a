#include "hal/imu/replay/imu_record.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <system_error>

#include "hal/imu/reading_check.h"
#include "hal/record_file.h"

namespace godwit::hal {
namespace {

namespace fs = std::filesystem;

/// No sensor that flies measures more: who stands beyond has other units, or other columns.
constexpr double kMostRate = 100;
constexpr double kMostForce = 1000;
/// More than any pause of a sensor that goes on: a gap as long, and a time that goes back right after it, is one wrong
/// stamp.
constexpr rt::TimeNs kAheadNs = rt::kNsPerSecond;

bool read_number(std::string_view text, double most, double* value) {
  const char* const end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, *value);
  return read.ec == std::errc() && read.ptr == end && std::abs(*value) <= most;  // false for a NaN, too
}

/// What is wrong with the six numbers of a line; empty: nothing.
std::string read_readings(std::string_view line, char separator, ImuSample* sample) {
  for (std::size_t i = 0; i < 6; ++i) {
    const std::string_view field = take_field(&line, separator);
    double* const value = i < 3 ? &sample->gyro_rad_s[i] : &sample->accel_m_s2[i - 3];
    const double most = i < 3 ? kMostRate : kMostForce;
    if (read_number(field, most, value)) continue;
    return quoted(field) + " is not " + (i < 3 ? "a rate in rad/s" : "an acceleration in m/s^2") + " (at most " +
           std::to_string(static_cast<int>(most)) + "); a line is time, three rates, three accelerations";
  }
  return line.empty() ? std::string() : "more than six readings: " + quoted(line);
}

double rate_of(const std::vector<ImuSample>& samples) {
  std::vector<rt::TimeNs> steps;
  for (std::size_t i = 1; i < samples.size(); ++i) steps.push_back(samples[i].t_ns - samples[i - 1].t_ns);
  if (steps.empty()) return 0;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  return 1e9 / static_cast<double>(*middle);
}

/// The last of them is stamped far ahead of both its neighbours, of which t_ns is the later one's: of two that
/// contradict each other it is the one that is wrong.
bool last_is_ahead(const std::vector<ImuSample>& samples, rt::TimeNs t_ns) {
  if (samples.empty() || t_ns > samples.back().t_ns) return false;
  if (samples.size() == 1) return samples.back().t_ns - t_ns > kAheadNs;
  const rt::TimeNs before_ns = samples[samples.size() - 2].t_ns;
  return t_ns > before_ns && samples.back().t_ns - before_ns > kAheadNs;
}

rt::Result<ImuRecord> parse(std::string_view text, const std::string& name, char separator,
                            bool (*read_time)(std::string_view, rt::TimeNs*), const char* time_words) {
  ImuRecord record;
  int same = 0, last_line = 0;
  const auto read = for_each_record(text, name, [&](std::string_view line, int number) -> std::string {
    ImuSample sample;
    const std::string_view time = take_field(&line, separator);
    if (!read_time(time, &sample.t_ns)) return quoted(time) + " is not a time in " + time_words;
    std::string reason = read_readings(line, separator, &sample);
    if (!reason.empty()) return reason;
    if (last_is_ahead(record.samples, sample.t_ns)) {
      if (record.time_ahead++ == 0) record.ahead_line = last_line;
      record.samples.pop_back();
    }
    if (!record.samples.empty() && sample.t_ns <= record.samples.back().t_ns) {
      if (record.time_repeated++ == 0) record.repeated_line = number;
    } else {
      const ImuSample* const last = record.samples.empty() ? nullptr : &record.samples.back();
      const bool again =
          last != nullptr && sample.gyro_rad_s == last->gyro_rad_s && sample.accel_m_s2 == last->accel_m_s2;
      same = again ? same + 1 : 1;
      if (same >= ReadingCheck::kStuckSamples) ++record.stuck;
      record.samples.push_back(sample);
      last_line = number;
    }
    return {};
  });
  if (!read) return read.error();
  record.cut_off = read.value();
  if (record.samples.empty()) return rt::Error{name + ": holds no samples"};
  record.rate_hz = rate_of(record.samples);
  return record;
}

struct Layout {
  fs::path readings, errors;
  rt::Result<ImuRecord> (*parse)(std::string_view, const std::string&);
};

rt::Result<Layout> find_layout(const std::string& folder) {
  const fs::path root(folder);
  std::vector<Layout> layouts = {{root / "imu.txt", root / "imu.yaml", parse_tum_imu}};
  for (const fs::path& imu0 : {root / "mav0" / "imu0", root / "imu0", root / ".." / "imu0"})
    layouts.push_back({imu0 / "data.csv", imu0 / "sensor.yaml", parse_euroc_imu});
  std::error_code ignored;
  for (const Layout& layout : layouts) {
    if (fs::is_regular_file(layout.readings, ignored)) return layout;
  }
  return rt::Error{folder + ": no IMU: neither imu.txt nor mav0/imu0/data.csv is there"};
}

rt::Result<ImuErrorModel> errors_of(const Layout& layout) {
  std::error_code ignored;
  if (!fs::is_regular_file(layout.errors, ignored)) return ImuErrorModel{};
  const auto text = read_text_file(layout.errors);
  if (!text) return text.error();
  return parse_imu_error_model(text.value(), layout.errors);
}

}  // namespace

std::vector<std::string> ImuRecord::warnings(const std::string& name) const {
  std::vector<std::string> out;
  if (!cut_off.empty()) out.push_back(cut_off);
  if (time_repeated > 0) {
    out.push_back(name + ": " + std::to_string(time_repeated) + " of " +
                  std::to_string(samples.size() + time_repeated) +
                  " inertial readings are no later than the one before: left out; the first is line " +
                  std::to_string(repeated_line));
  }
  if (time_ahead > 0) {
    out.push_back(
        name + ": " + std::to_string(time_ahead) +
        " inertial readings are stamped more than a second ahead of those around: left out; the first is line " +
        std::to_string(ahead_line));
  }
  if (stuck > 0)
    out.push_back(name + ": the inertial sensor is stuck in " + std::to_string(stuck) + " of " +
                  std::to_string(samples.size()) + " readings");
  if (saturated > 0)
    out.push_back(name + ": the inertial sensor is at the end of its range in " + std::to_string(saturated) + " of " +
                  std::to_string(samples.size()) + " readings");
  return out;
}

rt::Result<ImuRecord> parse_euroc_imu(std::string_view text, const std::string& name) {
  return parse(text, name, ',', parse_nanoseconds, "whole nanoseconds");
}

rt::Result<ImuRecord> parse_tum_imu(std::string_view text, const std::string& name) {
  return parse(text, name, ' ', parse_decimal_seconds, "decimal seconds");
}

rt::Result<ImuRecord> read_imu_record(const std::string& folder) {
  const auto layout = find_layout(folder);
  if (!layout) return layout.error();
  const auto text = read_text_file(layout.value().readings);
  if (!text) return text.error();
  auto record = layout.value().parse(text.value(), layout.value().readings);
  if (!record) return record;
  auto errors = errors_of(layout.value());
  if (!errors) return errors.error();
  record.value().errors = errors.value();
  const ImuErrorModel& known = record.value().errors;
  for (ImuSample& s : record.value().samples) {
    s.flags |= saturated_flags(s, known.gyroscope_range.value_or(0), known.accelerometer_range.value_or(0));
    if (s.flags != 0) ++record.value().saturated;
  }
  return record;
}

rt::Result<ImuErrorModel> read_imu_record_errors(const std::string& folder) {
  const auto layout = find_layout(folder);
  if (!layout) return layout.error();
  return errors_of(layout.value());
}

}  // namespace godwit::hal
