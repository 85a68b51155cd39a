// A byte stream that claims to be MAVLink. The first byte says in which pieces it comes.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "firmware_app/link/inputs.h"
#include "firmware_app/link/mavlink/codec.h"
#include "firmware_app/link/mavlink/messages.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace godwit::link;
  if (size == 0) return 0;
  const std::size_t piece = data[0] + std::size_t{1};
  std::span<const std::uint8_t> stream(data + 1, size - 1);
  mavlink::Parser parser;
  while (!stream.empty()) {
    const std::size_t take = std::min(piece, stream.size());
    parser.feed(stream.first(take), [](const mavlink::RawMessage& raw) {
      AutopilotInput input;
      if (input_from_mavlink(raw, &input)) {
        for (const double v : input.value) {
          if (!(v - v == 0)) std::abort();  // neither infinite nor not a number
        }
      }
      mavlink::for_each_message([&]<typename Message>() {
        if (Message::kId != raw.id) return;
        Message message;
        mavlink::decode(raw, &message);
        mavlink::Sender sender{raw.system, raw.component, raw.sequence};
        mavlink::MessageBytes bytes;
        if (mavlink::encode(message, &sender, &bytes) > 12 + Message::kLength) std::abort();
      });
    });
    stream = stream.subspan(take);
  }
  return 0;
}
