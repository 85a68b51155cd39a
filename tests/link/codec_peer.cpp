// Reads frames that another implementation made, one transfer or message a line, and prints what we understood and what
// we would have sent in its place. Lines in:
//   D 0|1 ID:HEX ID:HEX ...   the CAN frames of one DroneCAN transfer (1: CAN FD)
//   M HEX                     one MAVLink frame
// Lines out: "field=value ..." (floats as 8 hex digits of their bits), " | ", our frames in the same form;
// "-" where nothing was understood. With --types it prints the table of data types and ends.
#include <cstdio>
#include <iostream>
#include <sstream>
#include <string>

#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/mavlink/codec.h"
#include "firmware_app/link/mavlink/messages.h"
#include "tests/link/hex.h"

namespace {
using namespace godwit::link;

struct Printer {
  std::string out;
  void put(const char* name, const std::string& value) { out += std::string(name) + "=" + value + " "; }
  void put_float(const char* name, float value) {
    std::array<char, 16> text{};
    std::snprintf(text.data(), text.size(), "%08x", std::bit_cast<std::uint32_t>(value));
    put(name, text.data());
  }
  // DroneCAN
  template <typename T>
  void number(const char* name, const T& value, unsigned, dronecan::Cast = dronecan::Cast::kSaturated) {
    put(name, std::to_string(+value));
  }
  void boolean(const char* name, const bool& value) { put(name, value ? "1" : "0"); }
  void half(const char* name, const float& value) { put_float(name, value); }
  void single(const char* name, const float& value) { put_float(name, value); }
  void padding(unsigned) {}
  template <typename T, std::size_t N, typename Item>
  void list(const char* name, const dronecan::List<T, N>& value, dronecan::Tail, unsigned, Item item) {
    put((std::string(name) + "#").c_str(), std::to_string(value.size));
    for (std::size_t i = 0; i < value.size; ++i) item(*this, value.item[i]);
  }
  template <std::size_t N>
  void bytes(const char* name, const dronecan::Bytes<N>& value, dronecan::Tail) {
    put((std::string(name) + "#").c_str(), std::to_string(value.size));
    for (const std::uint8_t byte : value.view()) put(name, std::to_string(byte));
  }
  template <typename T>
  void nested(const char*, const T& value) {
    T::visit(*this, value);
  }
  // MAVLink
  template <typename T>
  requires std::is_integral_v<T>
  void field(const char* name, const T& value) { put(name, std::to_string(+value)); }
  void field(const char* name, const float& value) { put_float(name, value); }
  template <typename T, std::size_t N>
  void field(const char* name, const std::array<T, N>& values) {
    for (const T& value : values) field(name, value);
  }
};

std::vector<dronecan::TypeInfo> all_types() {
  std::vector<dronecan::TypeInfo> types;
  dronecan::for_each_type([&]<typename T>() { types.push_back(T::kType); });
  return types;
}

std::string answer_dronecan(std::istringstream& line, godwit::rt::TimeNs now) {
  static dronecan::Reassembler reassembler(all_types());
  static dronecan::FrameBuffer frames;
  int fd = 0;
  line >> fd;
  dronecan::Transfer transfer;
  bool complete = false;
  std::string word;
  while (line >> word) {
    dronecan::CanFrame frame;
    frame.fd = fd != 0;
    frame.id = static_cast<std::uint32_t>(std::stoul(word.substr(0, 8), nullptr, 16));
    const auto data = from_hex(word.substr(9));
    frame.length = static_cast<std::uint8_t>(data.size());
    std::copy_n(data.begin(), std::min(data.size(), frame.data.size()), frame.data.begin());
    reassembler.set_node_id(static_cast<std::uint8_t>(frame.id >> 8 & 0x7F));
    complete = reassembler.accept(frame, now, &transfer);
  }
  if (!complete) return "-";
  std::string out = "-";
  dronecan::for_each_type([&]<typename T>() {
    if (T::kType.kind != transfer.kind || T::kType.id != transfer.type_id) return;
    T value;
    if (!dronecan::decode(transfer.payload, transfer.fd, &value)) return;
    Printer printer;
    T::visit(printer, value);
    std::array<std::uint8_t, dronecan::kMaxPayload> payload;
    dronecan::Transfer ours = transfer;
    ours.payload = {payload.data(), dronecan::encode(value, payload, transfer.fd)};
    const std::size_t count = dronecan::to_frames(ours, T::kType.signature, &frames);
    out = std::string(T::kType.name) + " " + printer.out + "|";
    for (std::size_t i = 0; i < count; ++i) {
      std::array<char, 16> id{};
      std::snprintf(id.data(), id.size(), " %08x:", frames[i].id);
      out += id.data() + to_hex({frames[i].data.data(), frames[i].length});
    }
  });
  return out;
}

std::string answer_mavlink(std::istringstream& line) {
  static mavlink::Parser parser;
  std::string word;
  line >> word;
  std::string out = "-";
  parser.feed(from_hex(word), [&](const mavlink::RawMessage& raw) {
    mavlink::for_each_message([&]<typename M>() {
      if (M::kId != raw.id) return;
      M message;
      mavlink::decode(raw, &message);
      Printer printer;
      M::visit(printer, message);
      mavlink::Sender sender{raw.system, raw.component, raw.sequence};
      mavlink::MessageBytes ours;
      const std::size_t length = mavlink::encode(message, &sender, &ours);
      out = std::string(M::kName) + " " + printer.out + "| " + to_hex({ours.data(), length});
    });
  });
  return out;
}
}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && std::string(argv[1]) == "--types") {
    for (const dronecan::TypeInfo& t : all_types()) {
      std::printf("%s %d %u %016llX %zu\n", t.name, static_cast<int>(t.kind), t.id,
                  static_cast<unsigned long long>(t.signature), t.max_bytes);
    }
    return 0;
  }
  std::ios::sync_with_stdio(false);
  std::string text;
  godwit::rt::TimeNs now = 0;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::string kind;
    line >> kind;
    now += 3 * godwit::rt::kNsPerSecond;  // each transfer stands for itself
    std::cout << (kind == "D" ? answer_dronecan(line, now) : answer_mavlink(line)) << '\n';
  }
  return 0;
}
