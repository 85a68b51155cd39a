#include "detector/model_info.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <optional>
#include <toml++/toml.h>

#include "detector/sha256.h"
#include "hal/rt/small_file.h"

namespace godwit::detector {
namespace {

constexpr std::size_t kMostMetadataBytes = 1 << 20;

constexpr std::array<std::string_view, 10> kKeys = {"layout",  "input_width", "input_height", "channel_order",
                                                    "scale",   "letterbox",   "fill",         "classes",
                                                    "movable", "sha256"};
constexpr std::size_t kMaxFileBytes = 64 * 1024;

/// Reads keys one by one and keeps the first complaint.
class Reader {
 public:
  Reader(const toml::table& table, std::string_view name) : table_(table), name_(name) {}

  int whole(std::string_view key, int low, int high, int step) {
    const auto value = table_[key].value_exact<std::int64_t>();
    if (value && *value >= low && *value <= high && *value % step == 0) return static_cast<int>(*value);
    std::string allowed = "a whole number from " + std::to_string(low) + " to " + std::to_string(high);
    if (step > 1) allowed += ", a multiple of " + std::to_string(step);
    complain(key, allowed);
    return low;
  }

  float positive(std::string_view key) {
    const auto value = table_[key].value<double>();
    if (value && std::isfinite(*value) && *value >= 1e-6 && *value <= 1e6) return static_cast<float>(*value);
    complain(key, "a number from 1e-6 to 1e6");
    return 1.F;
  }

  bool first_of(std::string_view key, std::string_view first, std::string_view second) {
    const auto value = table_[key].value_exact<std::string_view>();
    if (value && (*value == first || *value == second)) return *value == first;
    std::string allowed = "\"";
    allowed.append(first).append("\" or \"").append(second).append("\"");
    complain(key, allowed);
    return true;
  }

  std::vector<std::string> names(std::string_view key, std::size_t fewest) {
    std::vector<std::string> out;
    const toml::array* list = table_[key].as_array();
    bool good = list != nullptr && list->size() >= fewest && list->size() <= kMaxClasses;
    for (std::size_t i = 0; good && i < list->size(); ++i) {
      const auto text = list->get(i)->value_exact<std::string>();
      good = text && !text->empty() && std::find(out.begin(), out.end(), *text) == out.end();
      if (good) out.push_back(*text);
    }
    if (!good) {
      complain(key, "a list of " + std::to_string(fewest) + " to " + std::to_string(kMaxClasses) + " different names");
    }
    return out;
  }

  std::string sha256(std::string_view key) {
    const auto text = table_[key].value_exact<std::string>();
    const auto digit = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
    if (text && text->size() == 64 && std::all_of(text->begin(), text->end(), digit)) return *text;
    complain(key, "the SHA-256 of the network's file, as sha256sum prints it");
    return {};
  }

  void complain(std::string_view key, const std::string& allowed) {
    if (error_) return;
    error_ = std::string(name_) + ": " + std::string(key) +
             (table_.contains(key) ? ": must be " : " is missing; must be ") + allowed;
  }
  const std::optional<std::string>& error() const { return error_; }

 private:
  const toml::table& table_;
  std::string_view name_;
  std::optional<std::string> error_;
};

}  // namespace

int ModelInfo::square_px() const {
  return static_cast<int>(std::lround(std::sqrt(static_cast<double>(input_width) * input_height)));
}

int ModelInfo::output_rows() const {
  int cells = 0;
  for (const int stride : {8, 16, 32}) cells += (input_width / stride) * (input_height / stride);
  return layout == Layout::kYolov5 ? 3 * cells : cells;
}

rt::Result<ModelInfo> parse_model_info(std::string_view text, std::string_view name) {
  if (text.size() > kMaxFileBytes) return rt::Error{std::string(name) + ": larger than 64 KiB, not a metadata file"};
  // toml++ 3.3 takes letters outside ASCII to an unreachable branch of its tables; nothing here needs them.
  const auto foreign = [](char c) { return static_cast<unsigned char>(c) >= 0x80; };
  if (std::any_of(text.begin(), text.end(), foreign)) {
    return rt::Error{std::string(name) + ": holds bytes outside ASCII, not a metadata file"};
  }
  toml::table table;
  // With exceptions, which are caught here: toml++ 3.3 without them runs into an assertion on broken input.
  try {
    table = toml::parse(text, name);
  } catch (const toml::parse_error& e) {
    return rt::Error{std::string(name) + ":" + std::to_string(e.source().begin.line) + ": " +
                     std::string(e.description())};
  }
  for (const auto& [key, node] : table) {
    if (std::find(kKeys.begin(), kKeys.end(), key.str()) == kKeys.end()) {
      return rt::Error{std::string(name) + ":" + std::to_string(node.source().begin.line) + ": unknown key " +
                       std::string(key.str())};
    }
  }
  Reader reader(table, name);
  ModelInfo info;
  info.layout = reader.first_of("layout", "yolov5", "yolox") ? Layout::kYolov5 : Layout::kYolox;
  info.input_width = reader.whole("input_width", 32, kMaxInputSize, 32);
  info.input_height = reader.whole("input_height", 32, kMaxInputSize, 32);
  info.channel_order = reader.first_of("channel_order", "rgb", "bgr") ? ChannelOrder::kRgb : ChannelOrder::kBgr;
  info.scale = reader.positive("scale");
  info.placement = reader.first_of("letterbox", "centre", "top_left") ? Placement::kCentre : Placement::kTopLeft;
  info.fill = reader.whole("fill", 0, 255, 1);
  info.classes = reader.names("classes", 1);
  info.movable.assign(info.classes.size(), false);
  for (const std::string& moves : reader.names("movable", 0)) {
    const auto at = std::find(info.classes.begin(), info.classes.end(), moves);
    if (at == info.classes.end()) {
      reader.complain("movable", "names out of classes, \"" + moves + "\" is none");
    } else {
      info.movable[at - info.classes.begin()] = true;
    }
  }
  info.sha256 = reader.sha256("sha256");
  if (reader.error()) return rt::Error{*reader.error()};
  return info;
}

rt::Result<ModelInfo> read_model_info(const std::string& model_path) {
  const std::string path = std::filesystem::path(model_path).replace_extension(".toml").string();
  const auto text = rt::read_small_file(path, kMostMetadataBytes);
  if (!text) {
    if (std::filesystem::exists(path)) return text.error();
    return rt::Error{path + ": cannot be opened; a model needs its metadata file beside it"};
  }
  auto info = parse_model_info(text.value(), path);
  if (!info) return info.error();
  const auto sum = sha256_of_file(model_path);
  if (!sum) return sum.error();
  if (sum.value() != info.value().sha256) {
    return rt::Error{model_path + ": not the network that " + path + " describes: its SHA-256 is " + sum.value()};
  }
  return info;
}

}  // namespace godwit::detector
