// Faults in the pictures of tum_fr1_xyz at five places: does it come back, in the same map, and is what it says true?
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <gtest/gtest.h>

#include "tests/faults/fault_run.h"

namespace godwit::test::fault_runs_test {
namespace {

constexpr int kBefore = 150, kAfter = 60;
constexpr int kWithinFrames = 30;  ///< 1 s
constexpr double kAteBar = 0.015;  ///< of the sequence as it is [m]
constexpr double kWrongMetres = 0.05, kWrongDegrees = 3.0;
#if defined(__SANITIZE_ADDRESS__)
constexpr std::array<int, 1> kPlaces = {290};  // everything takes twenty times as long
#else
constexpr std::array<int, 5> kPlaces = {180, 290, 400, 510, 620};
#endif

/// The committed places, or with GODWIT_FAULT_STEP=N every N-th picture of the sequence that leaves room around it.
std::vector<int> places() {
  const char* step = std::getenv("GODWIT_FAULT_STEP");
  if (step == nullptr) return {kPlaces.begin(), kPlaces.end()};
  std::vector<int> out;
  constexpr int kFirst = 160, kLast = 640;
  for (int place = kFirst; place <= kLast; place += std::max(1, std::atoi(step))) out.push_back(place);
  return out;
}

enum class Fault { kRemoved, kBlack, kForeign };
constexpr const char* kFaultNames[] = {"removed", "black", "foreign"};

/// Counts over all runs of one test.
struct Tally {
  int runs = 0, back = 0;
  int tracked = 0, wrong = 0;
  int blind_tracked_late = 0;                  ///< black or foreign frames that counted as tracked after the first five
  std::vector<double> search_ms, tracking_ms;  ///< processor time of the tracking call
};

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// The middle 640x480 of another scene.
std::vector<Pixels> foreign_pictures(const Recording& other, int width, int height) {
  std::vector<Pixels> out;
  const int ow = other.calibration.width, oh = other.calibration.height;
  const int x0 = (ow - width) / 2, y0 = (oh - height) / 2;
  for (const Pixels& p : other.pictures) {
    Pixels cut(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    for (int y = 0; y < height; ++y)
      std::memcpy(cut.data() + static_cast<std::ptrdiff_t>(y) * width,
                  p.data() + static_cast<std::ptrdiff_t>(y + y0) * ow + x0, static_cast<std::size_t>(width));
    out.push_back(std::move(cut));
  }
  return out;
}

void add_run(const Recording& recording, const std::vector<Shown>& shown, std::size_t fault, std::size_t back,
             const char* name, Tally* tally) {
  const auto records = fly(recording.calibration, shown);
  ASSERT_EQ(records.size(), shown.size());
  std::uint32_t map_id = 0;
  for (std::size_t i = 0; i < fault; ++i)
    if (records[i].tracked) map_id = records[i].map_id;
  ASSERT_NE(map_id, 0u) << name << ": no map before the fault";
  const auto e = errors(recording, shown, records, map_id, [&](std::size_t i) { return i < fault; });
  int blind = 0, wrong = 0, tracked = 0, late = 0;
  std::size_t returned = records.size();
  double sum = 0;
  int n = 0;
  double worst_m = 0, worst_deg = 0;
  for (std::size_t i = 0; i < records.size(); ++i) {
    const double ms = static_cast<double>(records[i].thread_cpu_ns) * 1e-6;
    if (records[i].state == vo::State::kRelocalising) tally->search_ms.push_back(ms);
    if (!records[i].tracked) continue;
    tally->tracking_ms.push_back(ms);
    ++tracked;
    if (shown[i].truth_index < 0) {
      ++wrong;
      if (i >= fault + 5) ++late;
      ++blind;
      continue;
    }
    if (!e[i].known) continue;
    worst_m = std::max(worst_m, e[i].metres);
    worst_deg = std::max(worst_deg, e[i].degrees);
    if (e[i].metres > kWrongMetres || e[i].degrees > kWrongDegrees) {
      ++wrong;
      std::printf("  %s: frame %zu is %.3f m and %.2f deg off, %d features, map %u\n", name, i, e[i].metres,
                  e[i].degrees, records[i].features, records[i].map_id);
    }
    if (i >= back) {
      returned = std::min(returned, i);
      sum += e[i].metres * e[i].metres;
      ++n;
    }
  }
  const double rms = n > 0 ? std::sqrt(sum / n) : 1e9;
  const bool ok = returned < back + kWithinFrames && records[returned].map_id == map_id && rms <= 2 * kAteBar;
  std::printf("%-22s back after %4d frames, then %.4f m rms; tracked %3d, wrong %d (worst %.3f m %.2f deg), blind %d\n",
              name, returned < records.size() ? static_cast<int>(returned - back) : -1, n > 0 ? rms : -1.0, tracked,
              wrong, worst_m, worst_deg, blind);
  ++tally->runs;
  tally->back += ok;
  tally->tracked += tracked;
  tally->wrong += wrong;
  tally->blind_tracked_late += late;
}

class FaultRuns : public testing::Test {
 protected:
  void SetUp() override {
    need_sequence("tum_fr1_xyz", &fr1_);
    if (!HasFatalFailure() && !IsSkipped()) need_sequence("euroc_mh01", &mh01_);
  }
  std::string fr1_, mh01_;
};

/// One place, one length, all three faults.
void all_faults(const Recording& recording, const std::vector<Pixels>& foreign, const Pixels& black, int length,
                int place, Tally* tally) {
  for (const Fault fault : {Fault::kRemoved, Fault::kBlack, Fault::kForeign}) {
    std::vector<Shown> shown;
    std::size_t back = 0;
    for (int i = 0; i < static_cast<int>(recording.pictures.size()); ++i) {
      const auto k = static_cast<std::size_t>(i);
      Shown s{&recording.pictures[k], recording.times[k], i};
      if (i >= kBefore && i < kBefore + length) {
        if (fault == Fault::kRemoved) continue;
        s.pixels = fault == Fault::kBlack ? &black : &foreign[static_cast<std::size_t>(i - kBefore) % foreign.size()];
        s.truth_index = -1;
      }
      if (i == kBefore + length) back = shown.size();
      shown.push_back(s);
    }
    char name[64];
    std::snprintf(name, sizeof(name), "%s %d at %d", kFaultNames[static_cast<int>(fault)], length, place);
    add_run(recording, shown, kBefore, back, name, tally);
  }
}

TEST_F(FaultRuns, OneAndThreeSecondsRemovedBlackenedOrReplacedAtFivePlaces) {
  Tally tally;
  const Recording other = Recording::load(mh01_, 100, 90);
  const std::vector<int> all_places = places();
  for (const int place : all_places) {
    const Recording recording = Recording::load(fr1_, place - kBefore, kBefore + 90 + kAfter);
    const auto foreign = foreign_pictures(other, recording.calibration.width, recording.calibration.height);
    const Pixels black(recording.pictures[0].size(), 0);
    all_faults(recording, foreign, black, 90, place, &tally);
    Recording shorter = recording;
    shorter.pictures.resize(kBefore + 30 + kAfter);
    shorter.times.resize(kBefore + 30 + kAfter);
    all_faults(shorter, foreign, black, 30, place, &tally);
  }
  std::printf("%d of %d back; %d of %d tracked frames wrong; %d blind ones after the fifth\n", tally.back, tally.runs,
              tally.wrong, tally.tracked, tally.blind_tracked_late);
  std::printf(
      "processor time of a frame: tracking median %.2f ms, p99 %.2f; searching median %.2f, p99 %.2f, max %.2f\n",
      percentile(tally.tracking_ms, 0.5), percentile(tally.tracking_ms, 0.99), percentile(tally.search_ms, 0.5),
      percentile(tally.search_ms, 0.99), percentile(tally.search_ms, 1.0));
  EXPECT_EQ(tally.runs, static_cast<int>(6 * all_places.size()));
  EXPECT_GE(tally.back * 10, tally.runs * 9);
  // At the committed places none; wherever the sequence is begun, at most one in a hundred: a first map is still bent.
  EXPECT_LE(tally.wrong, std::getenv("GODWIT_FAULT_STEP") == nullptr ? 0 : tally.tracked / 100);
  EXPECT_EQ(tally.blind_tracked_late, 0);
}

TEST_F(FaultRuns, TheStartIsFoundAgainAfterTheEnd) {
  const Recording recording = Recording::load(fr1_, 0, 0);
  std::vector<Shown> shown;
  const int n = static_cast<int>(recording.pictures.size());
  shown.reserve(recording.pictures.size());
  for (int i = 0; i < n; ++i)
    shown.push_back(
        {&recording.pictures[static_cast<std::size_t>(i)], recording.times[static_cast<std::size_t>(i)], i});
  const rt::TimeNs shift = recording.times.back() + 2 * rt::kNsPerSecond - recording.times.front();
  for (int i = 0; i < 60; ++i)
    shown.push_back(
        {&recording.pictures[static_cast<std::size_t>(i)], recording.times[static_cast<std::size_t>(i)] + shift, i});
  Tally tally;
  add_run(recording, shown, static_cast<std::size_t>(n), static_cast<std::size_t>(n), "return to the start", &tally);
  EXPECT_EQ(tally.back, 1);
  EXPECT_EQ(tally.wrong, 0);
}

}  // namespace
}  // namespace godwit::test::fault_runs_test
