#include <algorithm>

#include "hal/camera/v4l2/video_system.h"

namespace godwit::hal {
namespace {

std::string list_of(const std::vector<VideoNode>& nodes) {
  std::string out;
  for (const VideoNode& node : nodes) {
    out += (out.empty() ? "" : ", ") + node.path;
    if (!node.names.empty()) out += " (" + node.names.front() + ")";
  }
  return out.empty() ? "no video device is there" : "there are " + out;
}

}  // namespace

VideoChoice choose_video_node(const std::string& device, const std::vector<VideoNode>& nodes) {
  const auto after = [&](const char* prefix) -> std::string {
    const std::string p = prefix;
    return device.compare(0, p.size(), p) == 0 ? device.substr(p.size()) : std::string();
  };
  if (const std::string serial = after("serial:"); !serial.empty()) {
    for (const VideoNode& node : nodes) {
      if (node.serial == serial) return {node.path, ""};
    }
    return {"", "no video device has the serial number " + serial + "; " + list_of(nodes)};
  }
  if (const std::string name = after("by-id:"); !name.empty()) {
    std::vector<std::string> found;
    for (const VideoNode& node : nodes) {
      const auto is = [&](const std::string& n) { return n == name; };
      if (std::any_of(node.names.begin(), node.names.end(), is)) return {node.path, ""};
      const auto has = [&](const std::string& n) { return n.find(name) != std::string::npos; };
      if (std::any_of(node.names.begin(), node.names.end(), has)) found.push_back(node.path);
    }
    if (found.size() == 1) return {found.front(), ""};
    if (found.empty()) return {"", "no video device is named " + name + "; " + list_of(nodes)};
    return {"", "the name " + name + " fits " + std::to_string(found.size()) + " video devices; " + list_of(nodes)};
  }
  return {device, ""};
}

}  // namespace godwit::hal
