// What rangefinder, barometer, satellites and an autopilot's attitude said during a recording: range.csv, baro.csv,
// gnss.csv and attitude.csv, as `godwit sim` and `godwit fly` write them. Pure functions over text.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "hal/aid/aid.h"
#include "hal/rt/result.h"

namespace godwit::hal {

/// In the order of their times.
using AidRecord = std::vector<AidSample>;

/// The columns that a file must begin with (docs/formats.md); its first line names them. Satellites': one more may
/// follow, speed_sigma_m_s, above 0.
const char* aid_columns(AidKind kind);
/// Lines without an echo or a fix are left out. Error: names the file, line and reason; a line that cannot be read
/// refuses the whole file, but the last one of a file that breaks off there: *cut_off says so.
rt::Result<AidRecord> parse_aid(AidKind kind, std::string_view text, const std::string& name,
                                std::string* cut_off = nullptr);

/// Reads FOLDER/range.csv, baro.csv, gnss.csv or attitude.csv for each kind wanted. Error: one is not there, or as
/// above. *cut_off: a line for each that breaks off. Blocks.
rt::Result<AidRecord> read_aid_record(const std::string& folder, const std::vector<AidKind>& kinds,
                                      std::vector<std::string>* cut_off = nullptr);

/// "range,baro,gnss,attitude", or some of them. Error: another word, or one twice.
rt::Result<std::vector<AidKind>> parse_aid_kinds(std::string_view list);

}  // namespace godwit::hal
