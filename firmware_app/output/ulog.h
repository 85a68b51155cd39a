// ULog, the format of PX4's flight logs, as PlotJuggler, Foxglove, Flight Review and pyulog read it
// (https://docs.px4.io/main/en/dev_log/ulog_file_format.html, version 1): messages as bytes. Pure; no file, no clock.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>

#include "hal/rt/time.h"

namespace godwit::app::ulog {

/// A topic's field: "float[21]", "covariance". Every topic begins with {"uint64_t", "timestamp"} [us].
struct Field {
  const char* type;
  const char* name;
};

/// Bytes of one field's type; 0: there is no such type.
std::size_t field_bytes(std::string_view type);

// Each appends one whole message, or what a file begins with. What does not fit into a message (65,535 bytes; names:
// 255) is cut.
void append_header(rt::TimeNs t_start_ns, std::string* out);
void append_flags(std::string* out);
void append_info(std::string_view key, std::string_view value, std::string* out);
/// Under a name of at most 200 bytes.
void append_parameter(std::string_view key, float value, std::string* out);
void append_format(std::string_view topic, std::span<const Field> fields, std::string* out);
void append_subscription(std::uint16_t id, std::string_view topic, std::string* out);
void append_sample(std::uint16_t id, std::string_view sample, std::string* out);
/// Level as syslog has it: 3 error, 4 warning, 6 information.
void append_text(int level, rt::TimeNs t_ns, std::string_view text, std::string* out);
/// So long nothing was written.
void append_dropout(rt::TimeNs duration_ns, std::string* out);

/// A sample's bytes, field by field in the order of its format: little-endian, without padding.
class Sample {
 public:
  explicit Sample(rt::TimeNs t_ns) { put(static_cast<std::uint64_t>(t_ns / 1000)); }
  template <typename T>
  Sample& put(T value) {
    static_assert(std::is_arithmetic_v<T>);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  /// All values of a container, as T.
  template <typename T, typename Values>
  Sample& put_all(const Values& values) {
    for (const auto& v : values) put(static_cast<T>(v));
    return *this;
  }
  std::string_view bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

}  // namespace godwit::app::ulog
