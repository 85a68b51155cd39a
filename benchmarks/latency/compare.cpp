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
  if (o.watched) words.emplace_back("--watched");
  add("--json", json_file);
  words.emplace_back("--quiet");
  return words;
}

/// Runs the command to its end. Error: it could not be started, or its exit code.
rt::Result<void> run(const std::vector<std::string>& words) {
  std::vector<char*> arguments;
  arguments.reserve(words.size() + 1);
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

/// Fewer detections of a kind in a flight say nothing of what one costs.
constexpr std::size_t kEnoughDetections = 5;
constexpr std::size_t kLeastPairs = 2;  // of either order
constexpr std::array<const char*, 2> kKinds = {"full", "small"};

rt::Result<Json> flights_of(const std::string& text) {
  Json run = Json::parse(text, nullptr, false);
  if (run.is_discarded() || run.value("kind", "") != "latency" || !run.contains("flights")) {
    return rt::Error{"not the figures of a latency run"};
  }
  for (const Json& f : run["flights"]) {
    if (!f.contains("detection_cpu_ms")) return rt::Error{"has no CPU time of a detection: an older build's figures?"};
  }
  return run["flights"];
}

/// What a flight's threads cost [ms of CPU time]: the detector's by detection, since how many there are in a flight is
/// a matter of how busy the machine is, and the others' by picture.
struct Cost {
  double others = 0;                    ///< a picture
  std::array<double, 2> detection{};    ///< of either kind; 0: too few to tell
  std::array<double, 2> per_picture{};  ///< detections of that kind a picture
};

Cost cost_of(const Json& f) {
  Cost out;
  const auto pictures = f["frames"]["processed"].get<double>();
  for (const Json& t : f["threads"]) {
    if (t["name"] == "gw-detector") continue;
    out.others += t["cpu_percent"].get<double>() / 100 * f["seconds"].get<double>() * 1e3 / pictures;
  }
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    const Json& d = f["detection_cpu_ms"][kKinds[kind]];
    if (d["samples"].get<std::size_t>() < kEnoughDetections) continue;
    out.detection[kind] = d["median"].get<double>();
    out.per_picture[kind] = d["samples"].get<double>() / pictures;
  }
  return out;
}

void add_flights(const Json& a, const Json& b, PairFigures* out) {
  const bool detector = a.value("detector", false);
  const std::string on = detector ? "detector on: " : "detector off: ";
  const auto add = [&](const std::string& name, double of_a, double of_b) { (*out)[on + name] = {of_a, of_b}; };
  const auto both = [&](const std::string& name, const char* key, const char* figure) {
    add(name, a[key][figure].get<double>(), b[key][figure].get<double>());
  };
  both("tracker CPU time, median", "tracker_cpu_ms", "median");
  both("tracker CPU time, p99", "tracker_cpu_ms", "p99");
  both("own share of the age at pose, median", "own_at_pose_ms", "median");
  const Cost cost_a = cost_of(a), cost_b = cost_of(b);
  double all_a = cost_a.others, all_b = cost_b.others;
  bool alike = !detector;
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    if (!(cost_a.detection[kind] > 0) || !(cost_b.detection[kind] > 0)) continue;
    alike = true;
    add(std::string("a detection's CPU time, ") + kKinds[kind] + " input, median", cost_a.detection[kind],
        cost_b.detection[kind]);
    // As many on both sides: what the pair had on average.
    const double count = (cost_a.per_picture[kind] + cost_b.per_picture[kind]) / 2;
    all_a += count * cost_a.detection[kind];
    all_b += count * cost_b.detection[kind];
  }
  if (alike) add("CPU time of all threads, as many detections", all_a, all_b);
  // None at all where the ladder has shed the detector: that is no fault of the comparison.
  if (detector && a["detections"]["done"] > 0 && b["detections"]["done"] > 0) {
    add("detections a second", a["detections"]["done"].get<double>() / a["seconds"].get<double>(),
        b["detections"]["done"].get<double>() / b["seconds"].get<double>());
  }
}

/// Not of none.
double median_of(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return app::percentile_of_sorted(values, 50);
}

rt::Result<std::string> text_of(const std::string& file) {
  std::ifstream in(file);
  std::string text{std::istreambuf_iterator<char>(in), {}};
  if (!in) return rt::Error{file + ": cannot be read"};
  return text;
}

}  // namespace

rt::Result<PairFigures> pair_figures(const std::string& a, const std::string& b) {
  const auto of_a = flights_of(a), of_b = flights_of(b);
  if (!of_a) return rt::Error{"A: " + of_a.error().message};
  if (!of_b) return rt::Error{"B: " + of_b.error().message};
  if (of_a.value().size() != of_b.value().size()) return rt::Error{"A and B did not fly the same number of flights"};
  PairFigures out;
  for (std::size_t i = 0; i < of_a.value().size(); ++i) {
    if (of_a.value()[i].value("detector", false) != of_b.value()[i].value("detector", false)) {
      return rt::Error{"A and B did not fly with and without the detector in the same order"};
    }
    add_flights(of_a.value()[i], of_b.value()[i], &out);
  }
  for (const auto& [name, values] : out) {
    if (!(values.first > 0) || !(values.second > 0)) return rt::Error{"'" + name + "' is not above zero on both sides"};
  }
  return out;
}

Ratio ratio_of(const std::string& figure, const std::vector<Pair>& pairs) {
  Ratio out;
  out.figure = figure;
  out.pairs = pairs.size();
  // Logarithms: A / B and B / A must come out as each other's inverse.
  std::array<std::vector<double>, 2> orders;
  for (const Pair& p : pairs) orders[p.a_first ? 0 : 1].push_back(std::log(p.a / p.b));
  std::vector<double> means, first;
  for (const double i : orders[0]) {
    for (const double j : orders[1]) {
      means.push_back((i + j) / 2);
      first.push_back((i - j) / 2);  // what being first does to the ratio
    }
  }
  const double middle = median_of(std::move(means)), of_first = median_of(std::move(first));
  double distance = 0;
  for (const double i : orders[0]) distance += std::abs(i - of_first - middle);
  for (const double j : orders[1]) distance += std::abs(j + of_first - middle);
  const auto n = static_cast<double>(pairs.size());
  out.median = std::exp(middle);
  // 1.2533: of a normal distribution, its standard deviation over its mean distance; two pairs went into the middles.
  out.spread = out.median * 1.2533 * distance / n * std::sqrt(n / std::max(1.0, n - 2)) / std::sqrt(n);
  const auto by_ratio = [](const Pair& p, const Pair& q) { return p.a * q.b < q.a * p.b; };
  const auto [least, most] = std::minmax_element(pairs.begin(), pairs.end(), by_ratio);
  out.least = least->a / least->b;
  out.most = most->a / most->b;
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
  std::map<std::string, std::vector<Pair>> pairs;
  // Pair 0 only warms up.
  for (std::int64_t pair = 0; pair <= o.pairs; ++pair) {
    const bool a_first = pair % 2 == 0;
    std::array<std::string, 2> told;
    for (const std::size_t side : {a_first ? 0u : 1u, a_first ? 1u : 0u}) {
      const std::string file = folder + "/" + std::to_string(side) + ".json";
      if (stop.load(std::memory_order_relaxed)) return rt::Error{"interrupted"};
      if (const auto flown = run(command_of(o, o.compare[side], file)); !flown) return flown.error();
      auto read = text_of(file);
      if (!read) return read.error();
      told[side] = std::move(read).value();
    }
    const auto figures = pair_figures(told[0], told[1]);
    if (!figures) return figures.error();
    if (!o.quiet) {
      fmt::print(stderr, "godwit-latency: {}\n",
                 pair > 0 ? fmt::format("pair {} of {}", pair, o.pairs) : "warmed up, this pair counts nowhere");
    }
    if (pair == 0) continue;
    for (const auto& [name, values] : figures.value()) pairs[name].push_back({values.first, values.second, a_first});
  }
  Comparison out;
  out.pairs = o.pairs;
  // What one side shed in a pair is not compared there; of too few pairs of either order nothing is told.
  for (const auto& [name, values] : pairs) {
    const auto a_first =
        static_cast<std::size_t>(std::count_if(values.begin(), values.end(), [](const Pair& p) { return p.a_first; }));
    if (std::min(a_first, values.size() - a_first) >= kLeastPairs) out.ratios.push_back(ratio_of(name, values));
  }
  return out;
}

std::string table(const Options& o, const Comparison& c) {
  std::string out =
      fmt::format("A = {}\nB = {}\n{} pairs on {}, {} s each flight\n  {:<56} {:>7} {:>8} {:>7} {:>7} {:>6}\n",
                  o.compare[0], o.compare[1], c.pairs, o.live ? "a live camera" : o.input, o.seconds, "A / B", "ratio",
                  "+-", "least", "most", "pairs");
  for (const Ratio& r : c.ratios) {
    out += fmt::format("  {:<56} {:7.3f} {:8.3f} {:7.3f} {:7.3f} {:6}\n", r.figure, r.median, r.spread, r.least, r.most,
                       r.pairs);
  }
  return out;
}

std::string json(const Options& o, const Comparison& c) {
  Json ratios = Json::array();
  for (const Ratio& r : c.ratios) {
    ratios.push_back({{"figure", r.figure},
                      {"median", r.median},
                      {"spread", r.spread},
                      {"least", r.least},
                      {"most", r.most},
                      {"pairs", r.pairs}});
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
