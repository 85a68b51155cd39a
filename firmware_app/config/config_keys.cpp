#include "firmware_app/config/config_keys.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

namespace godwit::app::keys {
namespace {
/// False, and *to untouched: not a number from low to high.
bool read_number(const toml::node& node, double low, double high, double* to) {
  double value = 0;
  if (node.is_floating_point()) {
    value = node.as_floating_point()->get();
  } else if (node.is_integer()) {
    value = static_cast<double>(node.as_integer()->get());
  } else {
    return false;
  }
  if (!(value >= low && value <= high)) return false;  // not-a-number is in no range
  *to = value;
  return true;
}
}  // namespace

std::string quoted(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      char escape[8];
      std::snprintf(escape, sizeof(escape), "\\u%04X", static_cast<unsigned>(c));
      out += escape;
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string decimal(double value) {
  char digits[32];
  // Minus nothing would be "-0", which is read as a whole number and comes back as 0.
  const auto end = std::to_chars(digits, digits + sizeof(digits), value == 0.0 ? 0.0 : value);
  return {digits, end.ptr};
}

Key number(std::string name, double low, double high, std::string_view unit, double* to) {
  std::string allowed = "a number from " + decimal(low) + " to " + decimal(high);
  if (!unit.empty()) allowed += " [" + std::string(unit) + "]";
  return {std::move(name), std::move(allowed), [=](const toml::node& node) { return read_number(node, low, high, to); },
          [=] { return decimal(*to); }};
}

Key number_list(std::string name, std::size_t count, double low, double high, std::vector<double>* to) {
  return {
      std::move(name),
      "an empty list [], or one of " + std::to_string(count) + " numbers from " + decimal(low) + " to " + decimal(high),
      [=](const toml::node& node) {
        if (!node.is_array()) return false;
        std::vector<double> values;
        for (const toml::node& item : *node.as_array()) {
          double value = 0;
          if (!read_number(item, low, high, &value)) return false;
          values.push_back(value);
        }
        if (!values.empty() && values.size() != count) return false;
        *to = std::move(values);
        return true;
      },
      [=] {
        std::string out = "[";
        for (const double value : *to) out += (out.size() > 1 ? ", " : "") + decimal(value);
        return out + "]";
      }};
}

Key flag(std::string name, bool* to) {
  return {std::move(name), "true or false",
          [=](const toml::node& node) {
            if (!node.is_boolean()) return false;
            *to = node.as_boolean()->get();
            return true;
          },
          [=] { return std::string(*to ? "true" : "false"); }};
}

Key text(std::string name, std::size_t most_bytes, std::string_view what, std::string* to) {
  return {
      std::move(name),
      std::string(what) + " in quotes, at most " + std::to_string(most_bytes) + " bytes, without control characters",
      [=](const toml::node& node) {
        if (!node.is_string()) return false;
        const std::string& value = node.as_string()->get();
        const auto control = [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7f; };
        if (value.size() > most_bytes || std::any_of(value.begin(), value.end(), control)) return false;
        *to = value;
        return true;
      },
      [=] { return quoted(*to); }};
}

Key whole_list(std::string name, int low, int high, std::size_t most, std::vector<int>* to) {
  return {std::move(name),
          "a list [..] of at most " + std::to_string(most) + " different whole numbers from " + std::to_string(low) +
              " to " + std::to_string(high),
          [=](const toml::node& node) {
            if (!node.is_array() || node.as_array()->size() > most) return false;
            std::vector<int> values;
            for (const toml::node& item : *node.as_array()) {
              if (!item.is_integer()) return false;
              const std::int64_t value = item.as_integer()->get();
              if (value < low || value > high) return false;
              if (std::find(values.begin(), values.end(), static_cast<int>(value)) != values.end()) return false;
              values.push_back(static_cast<int>(value));
            }
            *to = std::move(values);
            return true;
          },
          [=] {
            std::string out = "[";
            for (const int value : *to) out += (out.size() > 1 ? ", " : "") + std::to_string(value);
            return out + "]";
          }};
}

}  // namespace godwit::app::keys
