// One table of a scenario file, read key by key; what is wrong with it is collected, not thrown.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <sstream>
#include <string>
#include <string_view>
#include <toml++/toml.h>
#include <utility>
#include <vector>

namespace godwit::sim {

inline std::string number(double v) {
  std::ostringstream s;
  s << v;
  return s.str();
}

/// Collects what is wrong with a file.
struct Complaints {
  std::string file, text;

  void add(const toml::node* at, const std::string& key, const std::string& reason) {
    if (!text.empty()) text += '\n';
    text += file;
    if (at != nullptr && at->source().begin.line > 0) text += ':' + std::to_string(at->source().begin.line);
    text += ": " + key + ": " + reason;
  }
};

/// One table of the file. Every key that is asked for is known; finish() complains of the others.
class Section {
 public:
  Section(const toml::table* table, std::string path, Complaints* complaints)
      : table_(table), path_(std::move(path)), complaints_(*complaints) {}

  bool present() const { return table_ != nullptr; }
  std::string key(std::string_view name) const {
    return path_.empty() ? std::string(name) : path_ + '.' + std::string(name);
  }
  void complain(std::string_view name, const std::string& reason) {
    const toml::node* at = table_ == nullptr ? nullptr : table_->get(name);
    complaints_.add(at != nullptr ? at : table_, key(name), reason);
  }

  const toml::node* get(std::string_view name) {
    known_.emplace_back(name);
    return table_ == nullptr ? nullptr : table_->get(name);
  }

  /// Leaves *out alone where the key is absent.
  void real(std::string_view name, double low, double high, double* out) {
    if (const toml::node* node = get(name)) real(*node, key(name), low, high, out);
  }
  void integer(std::string_view name, int low, int high, int* out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    const auto value = node->value_exact<std::int64_t>();
    if (!value || *value < low || *value > high) {
      complaints_.add(node, key(name),
                      "must be a whole number from " + std::to_string(low) + " to " + std::to_string(high));
      return;
    }
    *out = static_cast<int>(*value);
  }
  void flag(std::string_view name, bool* out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    if (const auto value = node->value_exact<bool>()) {
      *out = *value;
    } else {
      complaints_.add(node, key(name), "must be true or false");
    }
  }
  void text(std::string_view name, std::string* out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    if (const auto value = node->value_exact<std::string>()) {
      *out = *value;
    } else {
      complaints_.add(node, key(name), "must be a text in quotes");
    }
  }
  template <typename Enum, std::size_t N>
  void choice(std::string_view name, const std::array<std::pair<std::string_view, Enum>, N>& choices, Enum* out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    const auto value = node->value_exact<std::string_view>();
    std::string allowed;
    for (const auto& [word, meaning] : choices) {
      if (value && *value == word) {
        *out = meaning;
        return;
      }
      allowed += (allowed.empty() ? "" : ", ") + std::string(word);
    }
    complaints_.add(
        node, key(name),
        (value ? "'" + std::string(*value) + "' is unknown" : std::string("must be a text")) + "; allowed: " + allowed);
  }
  /// A list of exactly out.size() numbers.
  void reals(std::string_view name, double low, double high, std::span<double> out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    const toml::array* list = node->as_array();
    if (list == nullptr || list->size() != out.size()) {
      complaints_.add(node, key(name), "must be a list of " + std::to_string(out.size()) + " numbers");
      return;
    }
    for (std::size_t i = 0; i < out.size(); ++i) real((*list)[i], key(name), low, high, &out[i]);
  }
  void points(std::string_view name, std::vector<Eigen::Vector2d>* out) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    const toml::array* list = node->as_array();
    if (list == nullptr || list->empty()) {
      complaints_.add(node, key(name), "must be a list of [x, y]");
      return;
    }
    for (const toml::node& entry : *list) {
      const toml::array* pair = entry.as_array();
      if (pair == nullptr || pair->size() != 2) {
        complaints_.add(&entry, key(name), "each point must be [x, y]");
        continue;
      }
      Eigen::Vector2d p = Eigen::Vector2d::Zero();
      for (std::size_t i = 0; i < 2; ++i) real((*pair)[i], key(name), -2000, 2000, &p[static_cast<Eigen::Index>(i)]);
      out->push_back(p);
    }
  }
  Section table(std::string_view name) {
    const toml::node* node = get(name);
    if (node != nullptr && !node->is_table()) complaints_.add(node, key(name), "must be a table");
    return Section(node == nullptr ? nullptr : node->as_table(), key(name), &complaints_);
  }
  /// Calls f(Section&) for each table of an array of tables.
  template <typename F>
  void each(std::string_view name, F f) {
    const toml::node* node = get(name);
    if (node == nullptr) return;
    const toml::array* list = node->as_array();
    if (list == nullptr) {
      complaints_.add(node, key(name), "must be an array of tables ([[" + key(name) + "]])");
      return;
    }
    for (std::size_t i = 0; i < list->size(); ++i) {
      const std::string path = key(name) + '[' + std::to_string(i) + ']';
      const toml::table* entry = (*list)[i].as_table();
      if (entry == nullptr) {
        complaints_.add(&(*list)[i], path, "must be a table");
        continue;
      }
      Section section(entry, path, &complaints_);
      f(section);
      section.finish();
    }
  }
  void finish() {
    if (table_ == nullptr) return;
    for (const auto& [name, node] : *table_) {
      if (std::find(known_.begin(), known_.end(), name.str()) != known_.end()) continue;
      std::string allowed;
      for (const std::string& k : known_) allowed += (allowed.empty() ? "" : ", ") + k;
      complaints_.add(&node, key(name.str()), "is unknown; allowed here: " + allowed);
    }
  }

 private:
  void real(const toml::node& node, const std::string& what, double low, double high, double* out) {
    const auto value = node.is_number() ? node.value<double>() : std::nullopt;
    if (!value) {
      complaints_.add(&node, what, "must be a number");
    } else if (!(*value >= low && *value <= high)) {
      complaints_.add(&node, what,
                      number(*value) + " is out of range; allowed: " + number(low) + " to " + number(high));
    } else {
      *out = *value;
    }
  }

  const toml::table* table_;
  std::string path_;
  Complaints& complaints_;
  std::vector<std::string> known_;
};

}  // namespace godwit::sim
