// Recordings in text files: what every reader of one has in common.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// The whole file. Error: names the file and the reason.
rt::Result<std::vector<std::uint8_t>> read_whole_file(const std::string& file);
/// The same as text.
rt::Result<std::string> read_text_file(const std::string& file);

/// Calls read_line(line, number) for each line, without blanks around it, that is neither empty nor a comment ('#');
/// number counts all lines from 1. It returns what is wrong with the line; empty: nothing. Error: the first such
/// reason, with name and line. A last line that ends without its line break, after others, is where a recording was cut
/// off: what is wrong with that one is no error but returned, in words with name and line; empty: nothing was.
rt::Result<std::string> for_each_record(std::string_view text, const std::string& name,
                                        const std::function<std::string(std::string_view line, int number)>& read_line);

/// Takes what stands before the first separator off *text, without blanks around either. ' ' stands for any blanks.
std::string_view take_field(std::string_view* text, char separator);

/// "1305031102.175304" -> nanoseconds, without a detour through floating point; digits behind the ninth decimal are cut
/// off. False: not a plain decimal number, or too large (9e9 seconds and more).
bool parse_decimal_seconds(std::string_view text, rt::TimeNs* t_ns);
/// "1403636579763555584" -> nanoseconds. False: not a whole number, or too large.
bool parse_nanoseconds(std::string_view text, rt::TimeNs* t_ns);
/// Seconds with 9 decimals, exact. Precondition: t_ns >= 0.
std::string format_seconds(rt::TimeNs t_ns);

/// For error messages: what stands there, short and printable, in quotes.
std::string quoted(std::string_view text);

}  // namespace godwit::hal
