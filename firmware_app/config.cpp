#include "firmware_app/config.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <functional>
#include <memory>
#include <toml++/toml.h>

#include "hal/rt/frame_pool.h"

namespace godwit::app {
namespace {

/// One key: its full name, what it may be, and where it goes. apply returns false if the value is not allowed.
struct Key {
  std::string name;
  std::string allowed;
  std::function<bool(const toml::node&, Config*)> apply;
};

Key whole(const std::string& name, int low, int high, int Config::Pipeline::*member) {
  return {name, "a whole number from " + std::to_string(low) + " to " + std::to_string(high),
          [=](const toml::node& node, Config* config) {
            if (!node.is_integer()) return false;
            const std::int64_t value = node.as_integer()->get();
            if (value < low || value > high) return false;
            config->pipeline.*member = static_cast<int>(value);
            return true;
          }};
}

/// The whole configuration, key by key.
std::vector<Key> all_keys() {
  return {
      whole("pipeline.frame_slots", 0, rt::kMaxFrameSlots, &Config::Pipeline::frame_slots),
      whole("pipeline.mapper_delay_frames", 1, 30, &Config::Pipeline::mapper_delay_frames),
  };
}

std::string at(const std::string& name, const toml::node& node) {
  return name + ":" + std::to_string(node.source().begin.line) + ": ";
}

/// Fewest single-letter changes from one name to the other (Levenshtein), to guess what an unknown key was meant to be.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({replaced, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

std::string suggestion(const std::string& unknown, const std::vector<Key>& keys) {
  const std::string head = unknown.substr(0, 64);  // the file's author chooses its length
  const auto nearest = std::min_element(keys.begin(), keys.end(), [&](const Key& a, const Key& b) {
    return edit_distance(head, a.name) < edit_distance(head, b.name);
  });
  return "; the nearest known key is " + nearest->name + ", config/godwit.toml lists all";
}

void read_table(const toml::table& table, const std::string& prefix, const std::string& name,
                const std::vector<Key>& keys, ConfigReport* report) {
  for (const auto& [key_node, node] : table) {
    const std::string full = prefix + std::string(key_node.str());
    const auto known = std::find_if(keys.begin(), keys.end(), [&](const Key& k) { return k.name == full; });
    if (known != keys.end()) {
      if (!known->apply(node, &report->config)) {
        report->mistakes.push_back(at(name, node) + full + ": " + known->allowed + " is allowed");
      }
      continue;
    }
    const bool is_section = std::any_of(
        keys.begin(), keys.end(), [&](const Key& k) { return k.name.compare(0, full.size() + 1, full + ".") == 0; });
    if (is_section && node.is_table()) {
      read_table(*node.as_table(), full + ".", name, keys, report);
    } else if (is_section) {
      report->mistakes.push_back(at(name, node) + full + ": a section, [" + full + "], is allowed");
    } else {
      report->mistakes.push_back(at(name, node) + full + ": unknown key" + suggestion(full, keys));
    }
  }
}

}  // namespace

ConfigReport parse_config(std::string_view text, const std::string& name) {
  ConfigReport report;
  try {
    read_table(toml::parse(text), "", name, all_keys(), &report);
  } catch (const toml::parse_error& e) {
    report.mistakes.push_back(name + ":" + std::to_string(e.source().begin.line) +
                              ": not TOML: " + std::string(e.description()));
  }
  // The table keeps its keys sorted by name; mistakes are told in the order of the file.
  std::stable_sort(report.mistakes.begin(), report.mistakes.end(), [&](const std::string& a, const std::string& b) {
    return std::atol(a.c_str() + name.size() + 1) < std::atol(b.c_str() + name.size() + 1);
  });
  return report;
}

ConfigReport load_config(const std::string& file) {
  const auto close = [](std::FILE* f) { std::fclose(f); };
  const std::unique_ptr<std::FILE, decltype(close)> in(std::fopen(file.c_str(), "rb"), close);
  ConfigReport report;
  std::string text;
  char block[4096];
  std::size_t n = 0;
  while (in != nullptr && (n = std::fread(block, 1, sizeof(block), in.get())) > 0) text.append(block, n);
  if (in == nullptr || std::ferror(in.get()) != 0) {
    report.mistakes.push_back(file + ": " + std::strerror(errno));
    return report;
  }
  return parse_config(text, file);
}

}  // namespace godwit::app
