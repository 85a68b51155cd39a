// The kinds of keys a configuration has: what each may hold, in code and in words. A key is one line in
// config_schema.cpp.
//
// One parser, toml++, and three that read its tables: this, hal/sim/flight/scenario_section.h and
// detector/model_info.cpp. What they could share would have to lie in hal/rt, the only folder that hal, detector and
// this one all may include, and hal/rt knows no library. They differ, too: all mistakes at once here, the first one
// there.
#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <toml++/toml.h>
#include <utility>
#include <vector>

namespace godwit::app {

/// One key: its full name ("section.key"), what it may be, and where it goes. It holds a pointer to its value, so it
/// lives no longer than the configuration it was made for.
struct Key {
  std::string name;
  std::string allowed;                           ///< in words, for "... is allowed"
  std::function<bool(const toml::node&)> apply;  ///< false: not allowed; the value is then untouched
  std::function<std::string()> show;             ///< the present value, as TOML
};

namespace keys {

/// As TOML: in quotes, with what would break out of them escaped.
std::string quoted(std::string_view text);
/// The shortest decimal that reads back to the same number.
std::string decimal(double value);

/// A whole number from low to high.
template <std::integral Int>
Key whole(std::string name, Int low, Int high, Int* to) {
  return {std::move(name), "a whole number from " + std::to_string(low) + " to " + std::to_string(high),
          [=](const toml::node& node) {
            if (!node.is_integer()) return false;
            const std::int64_t value = node.as_integer()->get();
            if (std::cmp_less(value, low) || std::cmp_greater(value, high)) return false;
            *to = static_cast<Int>(value);
            return true;
          },
          [=] { return std::to_string(*to); }};
}

/// A finite number from low to high, written with or without a decimal point. unit: what it counts, for the words.
Key number(std::string name, double low, double high, std::string_view unit, double* to);

/// true or false.
Key flag(std::string name, bool* to);

/// Text of at most most_bytes without control characters; what: what it names ("a folder").
Key text(std::string name, std::size_t most_bytes, std::string_view what, std::string* to);

/// One of several words, each standing for a value: choice("camera.source", {{"sim", Source::kSim}, ..}, &to).
template <typename Value>
Key choice(std::string name, std::vector<std::pair<const char*, Value>> words, Value* to) {
  std::string allowed;
  for (std::size_t i = 0; i < words.size(); ++i) {
    allowed += (i == 0 ? "" : i + 1 == words.size() ? " or " : ", ") + quoted(words[i].first);
  }
  return {std::move(name), std::move(allowed),
          [=](const toml::node& node) {
            if (!node.is_string()) return false;
            for (const auto& [word, value] : words) {
              if (node.as_string()->get() != word) continue;
              *to = value;
              return true;
            }
            return false;
          },
          [=] {
            for (const auto& [word, value] : words) {
              if (*to == value) return quoted(word);
            }
            return std::string("?");
          }};
}

/// A list of at most `most` different whole numbers from low to high; it may be empty.
Key whole_list(std::string name, int low, int high, std::size_t most, std::vector<int>* to);

/// An empty list, or one of `count` numbers from low to high.
Key number_list(std::string name, std::size_t count, double low, double high, std::vector<double>* to);

}  // namespace keys
}  // namespace godwit::app
