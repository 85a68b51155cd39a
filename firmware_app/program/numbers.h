// What numbers on the command line may be, and the words when they are not.
#pragma once

#include <CLI/App.hpp>
#include <CLI/Validators.hpp>
#include <charconv>
#include <cstdint>
#include <fmt/format.h>
#include <string>

namespace godwit::app {

/// Accepts whole numbers from least to most.
inline CLI::Validator whole_number(std::int64_t least, std::int64_t most) {
  return CLI::Validator(
      [least, most](const std::string& text) -> std::string {
        std::int64_t value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error == std::errc() && end == text.data() + text.size() && value >= least && value <= most) return {};
        return fmt::format("'{}': whole numbers from {} to {} are allowed", text, least, most);
      },
      "");
}

/// Accepts numbers from least to most. CLI::Range and CLI::PositiveNumber let "nan" pass.
inline CLI::Validator number(double least, double most) {
  return CLI::Validator(
      [least, most](const std::string& text) -> std::string {
        double value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        const bool whole = error == std::errc() && end == text.data() + text.size();
        if (whole && value >= least && value <= most) return {};
        return fmt::format("'{}': numbers from {} to {} are allowed", text, least, most);
      },
      "");
}

/// Pictures, passes and the like.
constexpr std::int64_t kManyPictures = 1'000'000'000;
/// Which pictures: --start and --frames.
template <typename Number>
void add_range_options(CLI::App* command, Number* start, Number* frames) {
  command->add_option("--start", *start, "Leave out the first N pictures")
      ->type_name("N")
      ->check(whole_number(0, kManyPictures))
      ->capture_default_str();
  command->add_option("--frames", *frames, "Stop after N pictures (default: all)")
      ->type_name("N")
      ->check(whole_number(1, kManyPictures));
}

/// Of a simulated world.
constexpr std::int64_t kLastSeed = 1'000'000'000;
/// A day: as long as anything runs that ends by itself [s].
constexpr double kLongSeconds = 86'400;
/// Cameras' [1/s].
constexpr double kMostFps = 1000;

}  // namespace godwit::app
