// ULog back from a file: samples by topic and field (https://docs.px4.io/main/en/dev_log/ulog_file_format.html).
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <type_traits>

#include "hal/rt/result.h"

namespace godwit::app::ulog {

/// A topic's fields as the file declares them.
struct Format {
  struct Place {
    std::string type;  ///< "double[3]"
    std::size_t offset = 0, bytes = 0;
  };
  std::map<std::string, Place, std::less<>> fields;
  std::size_t bytes = 0;  ///< of one sample
};

/// One sample; valid during the call that hands it over.
class ReadSample {
 public:
  ReadSample(const std::string& topic, const Format& format, std::string_view bytes)
      : topic_(topic), format_(format), bytes_(bytes) {}
  const std::string& topic() const { return topic_; }
  /// An arithmetic value, or a std::array of them, of exactly the field's size. False: there is no such field.
  template <typename T>
  bool get(std::string_view field, T* out) const {
    static_assert(std::is_trivially_copyable_v<T>);
    const auto found = format_.fields.find(field);
    if (found == format_.fields.end() || found->second.bytes != sizeof(T)) return false;
    std::memcpy(out, bytes_.data() + found->second.offset, sizeof(T));
    return true;
  }

 private:
  const std::string& topic_;
  const Format& format_;
  const std::string_view bytes_;
};

/// Calls take with each sample, in the order of the file. Returns empty where the file ends after a whole message, else
/// in words where it breaks off or makes no sense; what comes before that was handed over. Error: the file cannot be
/// read, or is no ULog file.
rt::Result<std::string> read_samples(const std::string& file, const std::function<void(const ReadSample&)>& take);

}  // namespace godwit::app::ulog
