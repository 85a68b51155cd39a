#include "benchmarks/latency/thread_watch.h"

#include <algorithm>
#include <filesystem>
#include <fstream>

namespace godwit::bench {

void ThreadWatch::look(rt::TimeNs now_ns) {
  std::error_code error;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task", error)) {
    const std::filesystem::path& folder = task.path();
    Reading r;
    r.t_ns = now_ns;
    std::getline(std::ifstream(folder / "comm") >> std::ws, r.name);
    // schedstat: nanoseconds on a processor, nanoseconds waiting for one, time slices.
    if (!(std::ifstream(folder / "schedstat") >> r.cpu_ns)) continue;
    std::ifstream status(folder / "status");
    for (std::string word; status >> word;) {
      if (word == "voluntary_ctxt_switches:") status >> r.waits;
      if (word == "nonvoluntary_ctxt_switches:") status >> r.preemptions;
    }
    const auto [place, is_new] = threads_.try_emplace(folder.filename().string(), Thread{r, r});
    if (!is_new) place->second.last = r;
  }
}

std::vector<ThreadUse> ThreadWatch::uses() const {
  std::map<std::string, ThreadUse> by_name;
  for (const auto& [id, thread] : threads_) {
    ThreadUse& use = by_name[thread.last.name];
    use.name = thread.last.name;
    const auto span_ns = static_cast<double>(thread.last.t_ns - thread.first.t_ns);
    if (span_ns > 0) use.cpu_percent += 100 * (thread.last.cpu_ns - thread.first.cpu_ns) / span_ns;
    use.waits += thread.last.waits - thread.first.waits;
    use.preemptions += thread.last.preemptions - thread.first.preemptions;
  }
  std::vector<ThreadUse> out;
  out.reserve(by_name.size());
  for (auto& [name, use] : by_name) out.push_back(use);
  std::sort(out.begin(), out.end(),
            [](const ThreadUse& a, const ThreadUse& b) { return a.cpu_percent > b.cpu_percent; });
  return out;
}

}  // namespace godwit::bench
