#include "firmware_app/output/ulog.h"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>

namespace godwit::app::ulog {
namespace {
static_assert(std::endian::native == std::endian::little, "values are written as they lie in memory");

constexpr std::size_t kLongest = 65535;
constexpr std::size_t kLongestName = 255;
constexpr std::array<unsigned char, 8> kMagic = {'U', 'L', 'o', 'g', 0x01, 0x12, 0x35, 0x01};

template <typename T>
void put(T value, std::string* out) {
  out->append(reinterpret_cast<const char*>(&value), sizeof value);
}

void begin(char type, std::size_t size, std::string* out) {
  put(static_cast<std::uint16_t>(size), out);
  *out += type;
}

std::string_view cut(std::string_view text, std::size_t longest) {
  return text.substr(0, std::min(text.size(), longest));
}
}  // namespace

std::size_t field_bytes(std::string_view type) {
  std::size_t count = 1;
  if (const auto bracket = type.find('['); bracket != std::string_view::npos) {
    const auto [end, error] = std::from_chars(type.data() + bracket + 1, type.data() + type.size(), count);
    if (error != std::errc() || end + 1 != type.data() + type.size() || *end != ']') return 0;
    type = type.substr(0, bracket);
  }
  struct Type {
    std::string_view name;
    std::size_t bytes;
  };
  constexpr std::array<Type, 12> kTypes = {{{"int8_t", 1},
                                            {"uint8_t", 1},
                                            {"int16_t", 2},
                                            {"uint16_t", 2},
                                            {"int32_t", 4},
                                            {"uint32_t", 4},
                                            {"int64_t", 8},
                                            {"uint64_t", 8},
                                            {"float", 4},
                                            {"double", 8},
                                            {"bool", 1},
                                            {"char", 1}}};
  const auto* const found = std::find_if(kTypes.begin(), kTypes.end(), [&](const Type& t) { return t.name == type; });
  return found != kTypes.end() ? found->bytes * count : 0;
}

void append_header(rt::TimeNs t_start_ns, std::string* out) {
  out->append(reinterpret_cast<const char*>(kMagic.data()), kMagic.size());
  put(static_cast<std::uint64_t>(t_start_ns / 1000), out);
}

void append_flags(std::string* out) {
  constexpr std::size_t kSize = 8 + 8 + 3 * 8;
  begin('B', kSize, out);
  out->append(kSize, '\0');
}

void append_info(std::string_view key, std::string_view value, std::string* out) {
  value = cut(value, 60000);
  const std::string name = "char[" + std::to_string(value.size()) + "] " + std::string(cut(key, 200));
  begin('I', 1 + name.size() + value.size(), out);
  *out += static_cast<char>(name.size());
  out->append(name).append(value);
}

void append_parameter(std::string_view key, float value, std::string* out) {
  const std::string name = "float " + std::string(cut(key, 200));
  begin('P', 1 + name.size() + sizeof value, out);
  *out += static_cast<char>(name.size());
  out->append(name);
  put(value, out);
}

void append_format(std::string_view topic, std::span<const Field> fields, std::string* out) {
  std::string text = std::string(cut(topic, kLongestName)) + ":";
  for (const Field& f : fields) text += std::string(f.type) + " " + f.name + ";";
  begin('F', text.size(), out);
  *out += text;
}

void append_subscription(std::uint16_t id, std::string_view topic, std::string* out) {
  topic = cut(topic, kLongestName);
  begin('A', 1 + 2 + topic.size(), out);
  *out += '\0';  // the only instance of its topic
  put(id, out);
  out->append(topic);
}

void append_sample(std::uint16_t id, std::string_view sample, std::string* out) {
  begin('D', 2 + sample.size(), out);
  put(id, out);
  out->append(sample);
}

void append_text(int level, rt::TimeNs t_ns, std::string_view text, std::string* out) {
  text = cut(text, kLongest - 9);
  begin('L', 1 + 8 + text.size(), out);
  *out += static_cast<char>('0' + std::clamp(level, 0, 7));
  put(static_cast<std::uint64_t>(t_ns / 1000), out);
  out->append(text);
}

void append_dropout(rt::TimeNs duration_ns, std::string* out) {
  begin('O', 2, out);
  put(static_cast<std::uint16_t>(std::clamp<rt::TimeNs>(duration_ns / rt::kNsPerMs, 0, kLongest)), out);
}

}  // namespace godwit::app::ulog
