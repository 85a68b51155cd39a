// Spreads features over the picture with a quadtree (the paper, section 2.3.2; Mur-Artal, Montiel and Tardos, TRO
// 2015).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace godwit::vo {

/// A tree over the picture that is split until the wanted number of leaves holds a candidate. Fixed pools: only the
/// constructor allocates. One thread at a time. The result depends on the entries and their order alone.
class Quadtree {
 public:
  /// A leaf is not split below this side length.
  static constexpr float kMinLeafPx = 8.0f;

  /// For a picture of width x height pixels and up to `capacity` entries.
  Quadtree(int width, int height, int capacity);

  /// Forgets all entries.
  void clear();
  /// A feature that may be taken; `id` >= 0 is the caller's. False if the pools are full or (x, y) is not in the
  /// picture.
  bool add_candidate(float x, float y, float score, std::int32_t id);
  /// A feature that exists already: the leaf holding it is served. False as above.
  bool add_occupied(float x, float y);

  /// Splits, larger leaves first and of equal ones the fuller first, until `wanted` leaves hold a candidate and no
  /// occupied entry, or nothing is left to split. Writes the id of the best candidate of each such leaf to `ids` (at
  /// least `wanted` long; where the last split gave more leaves, the smallest are left out) and returns how many. No
  /// allocation.
  int select(int wanted, std::span<std::int32_t> ids);

 private:
  struct Entry {
    float x, y, score;
    std::int32_t id;  // < 0: occupied
  };
  struct Node {
    float x0, y0, x1, y1;
    std::int32_t begin, end;  // its entries
    std::int32_t candidates;  // how many of them are not occupied ones

    bool served() const { return end - begin > candidates; }
    bool counts() const { return candidates > 0 && !served(); }
  };

  bool add(const Entry& entry);
  bool splittable(const Node& node) const;
  /// Sorts the node's entries into its four quarters, appends the quarters that hold candidates to next_, and returns
  /// by how much the number of leaves that count grew.
  int split(const Node& node);

  float width_, height_;
  std::int32_t capacity_;
  std::vector<Entry> entries_, scratch_;
  std::vector<Node> current_, next_, leaves_;
  struct Choice {
    float leaf_px, score;
    std::int32_t id;
  };
  std::vector<Choice> best_;
};

}  // namespace godwit::vo
