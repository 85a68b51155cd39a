// summary.json of a run.
#pragma once

#include <string>
#include <vector>

#include "firmware_app/output/run_writer.h"
#include "hal/rt/log_ring.h"

namespace godwit::app {

/// What besides the summary's figures is told of a run.
struct RunTold {
  std::vector<rt::LogEntry> events;  ///< those kept; their text is static
  std::uint64_t events_not_kept = 0;
  rt::TimeNs first_t_ns = 0;  ///< the events' times count from here
  bool with_age = false;      ///< real pace: the age of poses is known, and the scheduler steered
};

/// By nlohmann-json: text that is none (a file's name may be anything) is shown with replacement characters, numbers
/// that are none as null. Allocates.
std::string summary_json(const RunDescription& description, const RunSummary& summary, const PipelineCounters& pipeline,
                         const RunTold& told);

}  // namespace godwit::app
