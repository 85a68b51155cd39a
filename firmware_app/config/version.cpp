#include "firmware_app/config/version.h"

#include <charconv>

namespace godwit::app {
namespace {

/// What the text begins with as a number; 0: none, or one that does not fit.
template <typename Number>
Number number_at(std::string_view text, int base) {
  Number out = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out, base);
  return error == std::errc() ? out : Number{0};
}

}  // namespace

std::string commit_words(const Version& v) {
  return std::string(v.commit) + (v.dirty ? "-dirty" : "");
}

std::string version_words(const Version& v) {
  return std::string(v.number) + " (commit " + commit_words(v) + ")";
}

std::uint32_t vcs_commit(const Version& v) {
  return number_at<std::uint32_t>(v.commit.substr(0, 8), 16);
}

std::uint8_t major_of(const Version& v) {
  return number_at<std::uint8_t>(v.number, 10);
}

std::uint8_t minor_of(const Version& v) {
  const std::size_t dot = v.number.find('.');
  return dot == std::string_view::npos ? std::uint8_t{0} : number_at<std::uint8_t>(v.number.substr(dot + 1), 10);
}

}  // namespace godwit::app
