#include "firmware_app/output/ulog_reader.h"

#include "firmware_app/output/ulog.h"
#include "hal/record_file.h"

namespace godwit::app::ulog {
namespace {

constexpr std::string_view kMagic = "ULog\x01\x12\x35";
constexpr std::size_t kHeader = 16;

/// The formats and subscriptions of one file.
class Topics {
 public:
  /// "topic:type name;type name;" False: it is no format.
  bool add_format(std::string_view text) {
    const auto colon = text.find(':');
    if (colon == std::string_view::npos) return false;
    Format format;
    std::string_view rest = text.substr(colon + 1);
    while (!rest.empty()) {
      const auto end = rest.find(';');
      const std::string_view field = rest.substr(0, end);
      const auto space = field.find(' ');
      if (end == std::string_view::npos || space == std::string_view::npos) return false;
      const std::size_t bytes = field_bytes(field.substr(0, space));
      if (bytes == 0) return false;
      format.fields[std::string(field.substr(space + 1))] = {std::string(field.substr(0, space)), format.bytes, bytes};
      format.bytes += bytes;
      rest.remove_prefix(end + 1);
    }
    formats_[std::string(text.substr(0, colon))] = std::move(format);
    return true;
  }

  bool subscribe(std::string_view message) {
    if (message.size() < 4) return false;
    const auto found = formats_.find(message.substr(3));
    if (found == formats_.end()) return false;
    subscriptions_[id_of(message.substr(1))] = &*found;
    return true;
  }

  bool hand_over(std::string_view message, const std::function<void(const ReadSample&)>& take) const {
    if (message.size() < 2) return false;
    const auto found = subscriptions_.find(id_of(message));
    if (found == subscriptions_.end()) return false;
    const auto& [topic, format] = *found->second;
    message.remove_prefix(2);
    if (message.size() != format.bytes) return false;
    take({topic, format, message});
    return true;
  }

 private:
  static std::uint16_t id_of(std::string_view bytes) {
    std::uint16_t id = 0;
    std::memcpy(&id, bytes.data(), sizeof id);
    return id;
  }

  std::map<std::string, Format, std::less<>> formats_;
  std::map<std::uint16_t, const std::pair<const std::string, Format>*> subscriptions_;
};

}  // namespace

rt::Result<std::string> read_samples(const std::string& file, const std::function<void(const ReadSample&)>& take) {
  const auto text = hal::read_text_file(file);
  if (!text) return text.error();
  const std::string& bytes = text.value();
  if (bytes.size() < kHeader || bytes.compare(0, kMagic.size(), kMagic) != 0)
    return rt::Error{file + ": is no ULog file"};
  Topics topics;
  std::string_view rest = std::string_view(bytes).substr(kHeader);
  while (!rest.empty()) {
    const std::string at = " at byte " + std::to_string(bytes.size() - rest.size());
    std::uint16_t size = 0;
    if (rest.size() >= 3) std::memcpy(&size, rest.data(), sizeof size);
    if (rest.size() < 3 || rest.size() - 3 < size) return "breaks off within a message" + at;
    const char type = rest[2];
    const std::string_view message = rest.substr(3, size);
    rest.remove_prefix(3 + std::size_t{size});
    bool known = true;
    if (type == 'F') {
      known = topics.add_format(message);
    } else if (type == 'A') {
      known = topics.subscribe(message);
    } else if (type == 'D') {
      known = topics.hand_over(message, take);
    } else {
      known = std::string_view("BIMPQRLCSO").find(type) != std::string_view::npos;
    }
    if (!known) return "makes no sense" + at;
  }
  return std::string();
}

}  // namespace godwit::app::ulog
