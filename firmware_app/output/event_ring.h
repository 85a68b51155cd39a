// The last seconds of pictures and readings, in memory that is taken and touched before the flight, and locked with the
// rest (rt::lock_memory).
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "hal/imu/imu.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Pictures have numbers that count on without end; those of first() to next() - 1 are held. No allocation after
/// create(). Nothing here locks: its owner does. Only place() and pixels() may be used beyond that: a place is the
/// caller's until added(), pixels stand until their number is below keep_from().
class EventRing {
 public:
  struct Size {
    int width = 0, height = 0;  ///< of the pictures
    std::size_t pictures = 0;   ///< held at most
    std::size_t samples = 0;    ///< readings held at most
    std::size_t bytes() const;
  };
  /// Error: no memory.
  static rt::Result<std::unique_ptr<EventRing>> create(const Size& size);

  const Size& size() const { return size_; }

  /// Where the next picture is to be copied, rows without gaps: the oldest's place where all are taken. Null: that one
  /// is kept.
  std::uint8_t* place();
  /// The picture is there.
  void added(const rt::FrameMeta& meta);
  /// Pictures from this number on are kept until another is named; next() or more: none is.
  void keep_from(std::uint64_t number) { keep_from_ = number; }

  std::uint64_t first() const { return first_; }
  std::uint64_t next() const { return next_; }
  const rt::FrameMeta& meta(std::uint64_t number) const { return meta_[index(number)]; }
  rt::ImageView pixels(std::uint64_t number) const;
  /// The first picture at or after this time, but none before `first`; next(): there is none.
  std::uint64_t at(rt::TimeNs t_capture_ns, std::uint64_t first) const;

  /// In the order of their times; the oldest make way.
  void add(const hal::ImuSample& sample);
  /// Those of [from, to] into *out, whose memory is used again.
  void copy_samples(rt::TimeNs from_ns, rt::TimeNs to_ns, std::vector<hal::ImuSample>* out) const;

 private:
  explicit EventRing(const Size& size) : size_(size) {}
  std::size_t index(std::uint64_t number) const { return number % size_.pictures; }
  std::size_t picture_bytes() const;

  const Size size_;
  std::vector<std::uint8_t> memory_;  ///< pictures one behind the other
  std::vector<rt::FrameMeta> meta_;
  std::vector<hal::ImuSample> samples_;
  std::uint64_t first_ = 0, next_ = 0, keep_from_ = ~0ULL;
  std::uint64_t samples_seen_ = 0;
};

}  // namespace godwit::app
