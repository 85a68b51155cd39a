#include "hal/camera/v4l2/v4l2_controls.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <linux/usb/video.h>
#include <linux/uvcvideo.h>
#include <linux/videodev2.h>

namespace godwit::hal {
namespace {

/// As v4l2-ctl names controls: "Exposure, Auto" -> "exposure_auto".
std::string plain_name(const char* text) {
  std::string out;
  bool gap = false;
  for (const char* c = text; *c != '\0'; ++c) {
    if (std::isalnum(static_cast<unsigned char>(*c)) == 0) {
      gap = !out.empty();
      continue;
    }
    if (gap) out += '_';
    gap = false;
    out += static_cast<char>(std::tolower(static_cast<unsigned char>(*c)));
  }
  return out;
}

/// A request about one control of 64 bits; VIDIOC_G_CTRL and S_CTRL refuse such.
struct Wide {
  v4l2_ext_control one{};
  v4l2_ext_controls all{};
  explicit Wide(std::uint32_t id) {
    one.id = id;
    all.which = V4L2_CTRL_WHICH_CUR_VAL;
    all.count = 1;
    all.controls = &one;
  }
};

}  // namespace

std::optional<V4l2Control> V4l2Controls::find(std::uint32_t id) const {
  v4l2_queryctrl q{};
  q.id = id;
  if (!call(VIDIOC_QUERYCTRL, &q) || (q.flags & V4L2_CTRL_FLAG_DISABLED) != 0) return std::nullopt;
  V4l2Control out{id, q.type == V4L2_CTRL_TYPE_INTEGER64, q.minimum, q.maximum, std::max(1, q.step)};
  if (!out.wide) return out;
  v4l2_query_ext_ctrl wide{};
  wide.id = id;
  if (!call(VIDIOC_QUERY_EXT_CTRL, &wide)) return out;  // set as it is given
  out.low = wide.minimum;
  out.high = wide.maximum;
  out.step = static_cast<std::int64_t>(std::max<std::uint64_t>(1, wide.step));
  return out;
}

rt::Result<V4l2Control> V4l2Controls::find(const std::string& name) const {
  char* end = nullptr;
  const auto number = static_cast<std::uint32_t>(std::strtoul(name.c_str(), &end, 0));
  if (end != name.c_str() && *end == '\0') {
    if (const auto found = find(number)) return *found;
    return rt::Error{path_ + ": has no control " + name};
  }
  std::string known;
  v4l2_queryctrl q{};
  q.id = V4L2_CTRL_FLAG_NEXT_CTRL;
  for (int i = 0; i < 1024 && call(VIDIOC_QUERYCTRL, &q); ++i) {  // a device that lists without end
    q.name[sizeof q.name - 1] = 0;
    const std::string here = plain_name(reinterpret_cast<const char*>(q.name));
    if (here == name) {
      if (const auto found = find(q.id)) return *found;
    }
    if (!known.empty()) known += ", ";
    known += here;
    q.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
  }
  return rt::Error{path_ + ": has no control " + name + "; it has " + (known.empty() ? "none" : known)};
}

std::optional<std::int64_t> V4l2Controls::get(const V4l2Control& control) const {
  if (control.wide) {
    Wide w(control.id);
    if (!call(VIDIOC_G_EXT_CTRLS, &w.all)) return std::nullopt;
    return static_cast<std::int64_t>(w.one.value64);  // a packed field: no reference
  }
  v4l2_control c{control.id, 0};
  if (!call(VIDIOC_G_CTRL, &c)) return std::nullopt;
  return c.value;
}

bool V4l2Controls::set(const V4l2Control& control, std::int64_t value) const {
  if (control.wide) {
    Wide w(control.id);
    w.one.value64 = value;
    return call(VIDIOC_S_EXT_CTRLS, &w.all);
  }
  v4l2_control c{control.id, static_cast<std::int32_t>(value)};
  if (c.value != value) return errno = ERANGE, false;
  return call(VIDIOC_S_CTRL, &c);
}

bool V4l2Controls::ask_unit(std::uint8_t unit, std::uint8_t selector, std::uint8_t request,
                            std::span<std::uint8_t> bytes) const {
  uvc_xu_control_query q{};
  q.unit = unit;
  q.selector = selector;
  q.query = request;
  q.size = static_cast<std::uint16_t>(bytes.size());
  q.data = bytes.data();
  return call(UVCIOC_CTRL_QUERY, &q);
}

rt::Result<void> V4l2Controls::set_in_unit(const std::string& name, std::int64_t value) const {
  const auto refused = [&](const std::string& why) {
    return rt::Error{path_ + ": control " + name + " = " + std::to_string(value) + ": " + why};
  };
  unsigned unit = 0, selector = 0;
  char more = 0;
  if (std::sscanf(name.c_str(), "uvc:%3u:%3u%c", &unit, &selector, &more) != 2 || unit > 255 || selector > 255) {
    return refused("uvc:UNIT:SELECTOR is allowed, each 0 to 255");
  }
  const auto u = static_cast<std::uint8_t>(unit), s = static_cast<std::uint8_t>(selector);
  std::array<std::uint8_t, 2> length{};
  if (!ask_unit(u, s, UVC_GET_LEN, length)) {
    return refused(errno == ENOENT   ? "the device has no such extension unit, or its node does not lead to it"
                   : errno == ENOTTY ? "this is no UVC device"
                                     : std::strerror(errno));
  }
  const std::size_t size = length[0] + 256u * length[1];
  std::array<std::uint8_t, sizeof value> bytes{}, now{};
  if (size == 0 || size > bytes.size()) return refused("it has " + std::to_string(size) + " bytes, not 1 to 8");
  if (size < bytes.size() && (value < 0 || value >> (8 * size) != 0)) {
    return refused("more than its " + std::to_string(size) + " bytes hold");
  }
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(value >> (8 * i));
  if (!ask_unit(u, s, UVC_SET_CUR, std::span(bytes).first(size))) return refused(std::strerror(errno));
  if (!ask_unit(u, s, UVC_GET_CUR, std::span(now).first(size))) return refused(std::strerror(errno));
  if (now != bytes) return refused("the device did not take it");
  return {};
}

rt::Result<void> V4l2Controls::set_all(const std::vector<std::pair<std::string, std::int64_t>>& wanted) const {
  for (const auto& [name, value] : wanted) {
    if (name.compare(0, 4, "uvc:") == 0) {
      if (const auto done = set_in_unit(name, value); !done) return done.error();
      continue;
    }
    const auto control = find(name);
    if (!control) return control.error();
    if (!set(control.value(), value)) {
      return rt::Error{path_ + ": control " + name + " = " + std::to_string(value) + ": " + std::strerror(errno)};
    }
  }
  return {};
}

}  // namespace godwit::hal
