#include "firmware_app/config/config.h"

#include <algorithm>
#include <toml++/toml.h>

#include "firmware_app/config/config_schema.h"
#include "hal/record_file.h"

namespace godwit::app {
namespace {

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

/// The names of the sections directly below prefix ("" or "section."), each once.
std::vector<std::string> sections_below(const std::string& prefix, const std::vector<Key>& keys) {
  std::vector<std::string> out;
  for (const Key& key : keys) {
    const std::size_t dot = key.name.find('.', prefix.size());
    if (key.name.compare(0, prefix.size(), prefix) != 0 || dot == std::string::npos) continue;
    std::string section = key.name.substr(0, dot);
    if (std::find(out.begin(), out.end(), section) == out.end()) out.push_back(std::move(section));
  }
  return out;
}

std::string unknown_section(const std::string& prefix, const std::vector<Key>& keys) {
  const std::vector<std::string> known = sections_below(prefix, keys);
  if (known.empty()) return "a section is not allowed here";
  std::string out = "unknown section; allowed are";
  for (const std::string& section : known) out += (section == known.front() ? " [" : ", [") + section + "]";
  return out;
}

std::string unknown_key(const std::string& unknown, const std::vector<Key>& keys) {
  const std::string head = unknown.substr(0, 64);  // the file's author chooses its length
  const auto distance = [&](const Key& key) { return edit_distance(head, key.name); };
  const auto nearest =
      std::min_element(keys.begin(), keys.end(), [&](const Key& a, const Key& b) { return distance(a) < distance(b); });
  // A slip of the pen, or the right key in the wrong section; what is further off would only mislead.
  const std::string leaf = head.substr(head.rfind('.') + 1);
  const auto same_leaf = std::find_if(keys.begin(), keys.end(),
                                      [&](const Key& key) { return key.name.substr(key.name.rfind('.') + 1) == leaf; });
  std::string hint;
  if (distance(*nearest) <= std::max<std::size_t>(2, nearest->name.size() / 4)) {
    hint = "did you mean " + nearest->name + "? ";
  } else if (same_leaf != keys.end()) {
    hint = "did you mean " + same_leaf->name + "? ";
  }
  return "unknown key; " + hint + "config/godwit.toml lists all";
}

void read_table(const toml::table& table, const std::string& prefix, const std::vector<Key>& keys,
                ConfigReport* report) {
  const std::vector<std::string> sections = sections_below(prefix, keys);
  for (const auto& [key_node, node] : table) {
    const std::string full = prefix + std::string(key_node.str());
    const auto known = std::find_if(keys.begin(), keys.end(), [&](const Key& k) { return k.name == full; });
    if (known != keys.end()) {
      report->lines[full] = static_cast<int>(node.source().begin.line);
      if (!known->apply(node)) report->mistake(full, known->allowed + " is allowed");
      continue;
    }
    const bool is_section = std::find(sections.begin(), sections.end(), full) != sections.end();
    if (is_section && node.is_table()) {
      read_table(*node.as_table(), full + ".", keys, report);
    } else if (is_section) {
      report->mistakes.push_back(
          at(report->file, node).append(full).append(": a section, [").append(full).append("], is allowed"));
    } else {
      const std::string what = node.is_table() ? unknown_section(prefix, keys) : unknown_key(full, keys);
      report->mistakes.push_back(at(report->file, node).append(full).append(": ").append(what));
    }
  }
}

}  // namespace

void ConfigReport::mistake(const std::string& key, const std::string& message) {
  const auto line = lines.find(key);
  mistakes.push_back(file + ":" + (line == lines.end() ? " " : std::to_string(line->second) + ": ") + key + ": " +
                     message);
}

void ConfigReport::sort() {
  // The table keeps its keys sorted by name; mistakes are told in the order of the file, those without a line first.
  std::stable_sort(mistakes.begin(), mistakes.end(), [&](const std::string& a, const std::string& b) {
    return std::atol(a.c_str() + file.size() + 1) < std::atol(b.c_str() + file.size() + 1);
  });
}

ConfigReport parse_config(std::string_view text, const std::string& name) {
  ConfigReport report;
  report.file = name;
  try {
    read_table(toml::parse(text), "", config_keys(&report.config), &report);
  } catch (const toml::parse_error& e) {
    report.mistakes.push_back(name + ":" + std::to_string(e.source().begin.line) +
                              ": not TOML: " + std::string(e.description()));
    return report;
  }
  check_contradictions(&report);
  report.sort();
  return report;
}

ConfigReport load_config(const std::string& file) {
  const auto text = hal::read_text_file(file);
  if (text) return parse_config(text.value(), file);
  ConfigReport report;
  report.file = file;
  report.mistakes.push_back(text.error().message);
  return report;
}

std::vector<std::string> describe_config() {
  Config defaults;
  std::vector<std::string> out;
  for (const Key& key : config_keys(&defaults)) out.push_back(key.name + " = " + key.show() + "  # " + key.allowed);
  return out;
}

std::vector<std::string> show_config(const Config& config) {
  Config copy = config;
  std::vector<std::string> out;
  for (const Key& key : config_keys(&copy)) out.push_back(key.name + " = " + key.show());
  return out;
}

}  // namespace godwit::app
