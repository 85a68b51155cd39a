#include "firmware_app/link/frame_bits.h"

namespace godwit::link {
namespace {

// Feeds the stuffed part of a classic frame bit by bit, counting stuff bits and keeping the CRC-15.
class StuffCounter {
 public:
  void bits(std::uint32_t value, int count) {
    for (int i = count - 1; i >= 0; --i) bit((value >> i & 1U) != 0);
  }
  void crc() {
    const unsigned sum = crc_;
    bits(sum, 15);
  }
  int total() const { return total_; }

 private:
  void bit(bool value) {
    const bool feedback = value != ((crc_ >> 14 & 1U) != 0);
    crc_ = (crc_ << 1 & 0x7FFFU) ^ (feedback ? 0x4599U : 0U);
    push(value);
    if (run_ == 5) push(!value);  // the stuff bit counts in the next run
  }
  void push(bool value) {
    run_ = total_ > 0 && value == last_ ? run_ + 1 : 1;
    last_ = value;
    ++total_;
  }
  unsigned crc_ = 0;
  int run_ = 0;
  int total_ = 0;
  bool last_ = false;
};

// CRC delimiter, acknowledge slot and delimiter, end of frame, interframe space.
constexpr int kUnstuffedEnd = 1 + 2 + 7 + 3;

double classic_bits(const hal::CanFrame& f) {
  StuffCounter s;
  s.bits(0, 1);  // start of frame
  if (f.extended) {
    s.bits(f.id >> 18 & 0x7FFU, 11);
    s.bits(3, 2);  // substitute remote request, identifier extension
    s.bits(f.id & 0x3FFFFU, 18);
    s.bits(0, 3);  // remote request, two reserved
  } else {
    s.bits(f.id & 0x7FFU, 11);
    s.bits(0, 3);  // remote request, identifier extension, reserved
  }
  s.bits(f.length, 4);
  for (std::size_t i = 0; i < f.length; ++i) s.bits(f.data[i], 8);
  s.crc();
  return s.total() + kUnstuffedEnd;
}

}  // namespace

double frame_bits(const hal::CanFrame& f, double data_rate_factor) {
  if (!f.fd) return classic_bits(f);
  const double arbitration = f.extended ? 35 : 17;             // start to the bit-rate switch
  const double crc = f.length > 16 ? 21 + 4 + 6 : 17 + 4 + 5;  // CRC, stuff count, fixed stuff bits
  const double data = 1 + 4 + 8.0 * f.length + crc;
  constexpr double kMeanStuffing = 1.06;
  return arbitration * kMeanStuffing + data * kMeanStuffing / data_rate_factor + kUnstuffedEnd;
}

}  // namespace godwit::link
