#include <algorithm>
#include <charconv>

#include "hal/camera/libcamera/libcamera_system.h"

namespace godwit::hal {

LibcameraChoice choose_libcamera(const std::string& device, const std::vector<std::string>& cameras) {
  std::string there;
  for (const std::string& id : cameras) there += (there.empty() ? "there are " : ", ") + id;
  if (there.empty()) there = "libcamera finds no camera";
  constexpr std::string_view kIndex = "index:";
  if (device.starts_with(kIndex)) {
    std::size_t index = 0;
    const char* const end = device.data() + device.size();
    const auto [stopped, failed] = std::from_chars(device.data() + kIndex.size(), end, index);
    if (failed != std::errc() || stopped != end) return {"", "\"" + device + "\": a number must follow index:"};
    if (index < cameras.size()) return {cameras[index], ""};
    return {"", "libcamera has no camera of number " + std::to_string(index) + "; " + there};
  }
  if (std::find(cameras.begin(), cameras.end(), device) != cameras.end()) return {device, ""};
  std::vector<std::string> found;
  for (const std::string& id : cameras) {
    if (id.find(device) != std::string::npos) found.push_back(id);
  }
  if (found.size() == 1) return {found.front(), ""};
  if (found.empty()) return {"", "no camera of libcamera's is named " + device + "; " + there};
  return {"", "the name " + device + " fits " + std::to_string(found.size()) + " cameras; " + there};
}

}  // namespace godwit::hal
