// How many, as the type in which this code counts.
#pragma once

#include <iterator>

namespace godwit::rt {

/// Elements of a container. An int: capacities are constants far below 2^31, and differences of indices may be
/// negative.
template <typename Container>
constexpr int count_of(const Container& container) {
  return static_cast<int>(std::size(container));
}

}  // namespace godwit::rt
