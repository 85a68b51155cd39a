#include "benchmarks/latency/compare.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fmt/format.h>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "firmware_app/config/version.h"
#include "firmware_app/output/statistics.h"

extern char** environ;

namespace godwit::bench {
namespace {

using Json = nlohmann::ordered_json;

std::vector<std::string> command_of(const Options& o, const std::string& side, const std::string& json_file) {
  const bool config = std::filesystem::path(side).extension() == ".toml";
  std::vector<std::string> words = {config ? std::filesystem::read_symlink("/proc/self/exe").string() : side};
  if (!o.live) words.push_back(o.input);
  const auto add = [&](const char* name, const std::string& value) {
    words.emplace_back(name);
    words.push_back(value);
  };
  if (config || !o.config_file.empty()) add(o.live ? "--camera" : "--config", config ? side : o.config_file);
  add("--detector", o.detector);
  add("--seconds", fmt::format("{}", o.seconds));
  if (o.fps > 0) add("--fps", fmt::format("{}", o.fps));
  add("--pictures", std::to_string(o.pictures));
  add("--seed", std::to_string(o.seed));
  if (!o.live) {
    add("--exposure-ms", fmt::format("{}", o.delays.exposure_ms));
    add("--readout-ms", fmt::format("{}", o.delays.readout_ms));
    add("--transfer-ms", fmt::format("{}", o.delays.transfer_ms));
  }
  if (!o.can.empty()) add("--can", o.can);
  add("--json", json_file);
  words.emplace_back("--quiet");
  return words;
}

/// Runs the command to its end. Error: it could not be started, or its exit code.
rt::Result<void> run(const std::vector<std::string>& words) {
  std::vector<char*> arguments;
  for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  pid_t child = 0;
  if (const int error = posix_spawnp(&child, arguments[0], nullptr, nullptr, arguments.data(), environ); error != 0) {
    return rt::Error{words[0] + ": cannot be started: " + std::strerror(error)};
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0) {
    if (errno != EINTR) return rt::Error{words[0] + ": " + std::strerror(errno)};
  }
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return {};
  return rt::Error{WIFEXITED(status) ? fmt::format("{}: ended with {}", words[0], WEXITSTATUS(status))
                                     : fmt::format("{}: ended by signal {}", words[0], WTERMSIG(status))};
}

/// The figures that are compared, of one side's JSON: name -> value. Error: not the JSON of a latency run.
rt::Result<std::map<std::string, double>> figures_of(const std::string& file) {
  std::ifstream in(file);
  const Json run = Json::parse(in, nullptr, false);
  if (run.is_discarded() || run.value("kind", "") != "latency" || !run.contains("flights")) {
    return rt::Error{file + ": not the figures of a latency run"};
  }
  std::map<std::string, double> out;
  for (const Json& f : run["flights"]) {
    const std::string on = f.value("detector", false) ? "detector on: " : "detector off: ";
    out[on + "tracker CPU time, median"] = f["tracker_cpu_ms"]["median"].get<double>();
    out[on + "tracker CPU time, p99"] = f["tracker_cpu_ms"]["p99"].get<double>();
    double percent = 0;
    for (const Json& t : f["threads"]) percent += t["cpu_percent"].get<double>();
    out[on + "CPU time of all threads"] = percent;
    out[on + "own share of the age at pose, median"] = f["own_at_pose_ms"]["median"].get<double>();
  }
  return out;
}

}  // namespace

Ratio ratio_of(const std::string& figure, const std::vector<std::pair<double, double>>& pairs) {
  Ratio out;
  out.figure = figure;
  std::vector<double> ratios;
  for (const auto& [a, b] : pairs) ratios.push_back(a / b);
  std::sort(ratios.begin(), ratios.end());
  out.median = app::percentile_of_sorted(ratios, 50);
  out.least = ratios.front();
  out.most = ratios.back();
  std::vector<double> away;
  for (const double r : ratios) away.push_back(std::abs(r - out.median));
  std::sort(away.begin(), away.end());
  // 1.4826: of a normal distribution, its standard deviation over its median absolute deviation.
  out.spread = 1.4826 * app::percentile_of_sorted(away, 50) / std::sqrt(static_cast<double>(ratios.size()));
  return out;
}

rt::Result<Comparison> compare(const Options& o, const std::atomic<bool>& stop) {
  std::string folder = (std::filesystem::temp_directory_path() / "godwit-latency-XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr) return rt::Error{folder + ": " + std::strerror(errno)};
  struct Remove {
    const std::string& folder;
    ~Remove() {
      std::error_code error;
      std::filesystem::remove_all(folder, error);
    }
  } const remove{folder};
  std::map<std::string, std::vector<std::pair<double, double>>> pairs;
  for (std::int64_t pair = 0; pair < o.pairs; ++pair) {
    std::array<std::map<std::string, double>, 2> figures;
    for (int turn = 0; turn < 2; ++turn) {
      // A B, B A, A B ..
      const auto side = static_cast<std::size_t>((turn + pair) % 2);
      const std::string file = folder + "/" + std::to_string(side) + ".json";
      if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted"};
      if (const auto flown = run(command_of(o, o.compare[side], file)); !flown) return flown.error();
      auto read = figures_of(file);
      if (!read) return read.error();
      figures[side] = std::move(read).value();
    }
    for (const auto& [name, a] : figures[0]) {
      const auto b = figures[1].find(name);
      if (b == figures[1].end()) return rt::Error{o.compare[1] + ": has no figure '" + name + "'"};
      if (!(a > 0) || !(b->second > 0)) return rt::Error{"'" + name + "' is not above zero on both sides"};
      pairs[name].emplace_back(a, b->second);
    }
    if (!o.quiet) fmt::print(stderr, "godwit-latency: pair {} of {}\n", pair + 1, o.pairs);
  }
  Comparison out;
  out.pairs = o.pairs;
  for (const auto& [name, values] : pairs) out.ratios.push_back(ratio_of(name, values));
  return out;
}

std::string table(const Options& o, const Comparison& c) {
  std::string out = fmt::format("A = {}\nB = {}\n{} pairs on {}, {} s each flight\n  {:<52} {:>7} {:>8} {:>7} {:>7}\n",
                                o.compare[0], o.compare[1], c.pairs, o.live ? "a live camera" : o.input, o.seconds,
                                "A / B", "median", "+-", "least", "most");
  for (const Ratio& r : c.ratios) {
    out += fmt::format("  {:<52} {:7.3f} {:8.3f} {:7.3f} {:7.3f}\n", r.figure, r.median, r.spread, r.least, r.most);
  }
  return out;
}

std::string json(const Options& o, const Comparison& c) {
  Json ratios = Json::array();
  for (const Ratio& r : c.ratios) {
    ratios.push_back(
        {{"figure", r.figure}, {"median", r.median}, {"spread", r.spread}, {"least", r.least}, {"most", r.most}});
  }
  const Json out = {{"kind", "latency-comparison"},
                    {"schema", 1},
                    {"version", app::version_words(app::version())},
                    {"input", o.live ? "live camera" : o.input},
                    {"a", o.compare[0]},
                    {"b", o.compare[1]},
                    {"pairs", c.pairs},
                    {"ratios", std::move(ratios)}};
  return out.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace godwit::bench
