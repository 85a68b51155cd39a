// godwit-mask-survey WITH WITHOUT [--every N] [--late N] [--limit N] [--score S] [--hold S...] [--model FILE]
// What of the people in a sequence is masked, picture by picture: WITH is a sequence that people were put into
// (boxes.txt: timestamp x0 y0 x1 y1), WITHOUT the one they were put into; where the two differ inside a box stands a
// person. Every Nth picture is looked at (1), its boxes come N pictures later (0, less than --every). One line for each
// --hold (scores; 1: nothing is held), all with DynamicMasks as it flies but for the camera's turning, which nobody
// tells here.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "benchmarks/last_catch.h"
#include "benchmarks/table_file.h"
#include "detector/decode.h"
#include "firmware_app/dynamic/dynamic_masks.h"

namespace {

using namespace godwit;

constexpr double kSmallest = 0.01;  // of the picture: a person in view by less is not counted
constexpr double kMuch = 0.03;      // of the picture: an unmasked person to speak of
constexpr int kApart = 60;          // sum over three channels: more than compression changes

struct Person {
  detector::Box box;
  int run = 0;  // pictures in a row in which less than half of it was masked
};

struct Sums {
  double people = 0, masked = 0, cut = 0, cut_masked = 0, other = 0;
  int pictures = 0, much = 0, longest = 0, seen = 0, missed = 0, cut_seen = 0, cut_missed = 0;
  std::map<int, int> runs;
  std::vector<Person> before;
};

cv::Mat picture(const std::string& path) {
  cv::Mat out = cv::imread(path, cv::IMREAD_COLOR);
  if (out.empty()) {
    std::fprintf(stderr, "cannot read %s\n", path.c_str());
    std::exit(1);
  }
  return out;
}

cv::Mat silhouettes(const cv::Mat& with, const cv::Mat& without, const std::vector<detector::Box>& boxes) {
  cv::Mat apart, sum, inside = cv::Mat::zeros(with.size(), CV_8U);
  cv::absdiff(with, without, apart);
  cv::transform(apart, sum, cv::Matx13f(1.F, 1.F, 1.F));
  for (const detector::Box& b : boxes)
    inside(cv::Rect(cv::Point(static_cast<int>(b.x0), static_cast<int>(b.y0)),
                    cv::Point(static_cast<int>(b.x1), static_cast<int>(b.y1))))
        .setTo(255);
  cv::Mat out = (sum > kApart) & inside;
  cv::morphologyEx(out, out, cv::MORPH_CLOSE, cv::Mat::ones(9, 9, CV_8U));
  cv::morphologyEx(out, out, cv::MORPH_OPEN, cv::Mat::ones(3, 3, CV_8U));
  return out;
}

void take(const cv::Mat& people, const cv::Mat& mask, const std::vector<detector::Box>& boxes, Sums* s) {
  const double area = static_cast<double>(people.total());
  const cv::Mat covered = people & mask;
  ++s->pictures;
  s->people += cv::countNonZero(people) / area;
  s->masked += cv::countNonZero(covered) / area;
  s->much += (cv::countNonZero(people) - cv::countNonZero(covered)) / area > kMuch;
  cv::Mat near;  // a mask has its margin
  cv::dilate(people, near, cv::Mat::ones(31, 31, CV_8U));
  s->other += cv::countNonZero(mask & ~near) / area;
  std::vector<Person> now;
  for (const detector::Box& b : boxes) {
    const cv::Rect r(cv::Point(static_cast<int>(b.x0), static_cast<int>(b.y0)),
                     cv::Point(static_cast<int>(b.x1), static_cast<int>(b.y1)));
    const double all = cv::countNonZero(people(r)), seen = cv::countNonZero(covered(r));
    Person p{b};
    if (all >= kSmallest * area) {
      const bool cut = b.x0 < 1 || b.y0 < 1 || b.x1 > static_cast<float>(people.cols - 1);  // not by the feet alone
      const bool missed = seen < 0.5 * all;
      if (missed) {
        float most = 0.3F;
        for (const Person& q : s->before) {
          if (detector::overlap(q.box, b) < most) continue;
          most = detector::overlap(q.box, b);
          p.run = q.run;
        }
        ++p.run;
        if (p.run > 1) --s->runs[p.run - 1];
        ++s->runs[p.run];
      }
      s->longest = std::max(s->longest, p.run);
      ++s->seen, s->missed += missed;
      if (cut) ++s->cut_seen, s->cut_missed += missed, s->cut += all, s->cut_masked += seen;
    }
    now.push_back(p);
  }
  s->before = std::move(now);
}

std::unique_ptr<app::DynamicMasks> open(const rt::FramePool* pool, const std::string& model, float score, float hold) {
  app::DynamicMasksOptions options;
  options.model = model;
  options.detector.decode.score_threshold = score;
  options.hold_score = hold;
  options.first_mask_ns = 0;
  const int w = pool->layout().width, h = pool->layout().height;
  const auto camera = vo::CameraModel::pinhole_radtan(w, h, w, w, 0.5 * w, 0.5 * h, {});
  auto out = app::DynamicMasks::open(options, camera.value(), pool);
  if (!out) {
    std::fprintf(stderr, "%s\n", out.error().message.c_str());
    std::exit(1);
  }
  return std::move(out).value();
}

int run(int argc, char** argv) {
  int every = 1, late = 0, limit = 1 << 30;
  float score = 0.25F;
  std::string model = GODWIT_MODEL_DIR "/cbam_yolov5n_416.onnx";
  std::vector<std::string> folders;
  std::vector<float> holds;
  for (int i = 1; i < argc; ++i) {
    const std::string arg = argv[i];
    const char* value = i + 1 < argc ? argv[i + 1] : "";
    if (arg.rfind("--", 0) != 0) {
      folders.push_back(arg);
      continue;
    }
    ++i;
    if (arg == "--every")
      every = std::max(1, std::atoi(value));
    else if (arg == "--late")
      late = std::max(0, std::atoi(value));
    else if (arg == "--limit")
      limit = std::atoi(value);
    else if (arg == "--score")
      score = std::strtof(value, nullptr);
    else if (arg == "--model")
      model = value;
    else if (arg == "--hold")
      holds.push_back(std::strtof(value, nullptr));
    else
      folders.clear(), i = argc;
  }
  if (folders.size() != 2 || late >= every) {
    std::fprintf(stderr,
                 "usage: godwit-mask-survey WITH WITHOUT [--every N] [--late N, below N of --every] [--limit N] "
                 "[--score S] [--hold S]... [--model FILE]\n");
    return 2;
  }
  if (holds.empty()) holds = {1.F, 0.15F};
  std::map<std::string, std::vector<detector::Box>> people;
  for (const auto& row : bench::read_table(folders[0] + "/boxes.txt"))
    people[row.at(0)].push_back(
        {std::stof(row.at(1)), std::stof(row.at(2)), std::stof(row.at(3)), std::stof(row.at(4))});
  std::map<std::string, std::string> empty;
  for (const auto& row : bench::read_table(folders[1] + "/rgb.txt")) empty[row.at(0)] = row.at(1);
  const auto pictures = bench::read_table(folders[0] + "/rgb.txt");

  const cv::Mat first = picture(folders[0] + "/" + pictures.at(0).at(1));
  rt::FramePool::Layout layout;
  layout.width = first.cols;
  layout.height = first.rows;
  layout.colour = true;
  layout.slots = 2;
  layout.readers = 1;
  const auto pool = std::move(rt::FramePool::create(layout)).value();
  const int slot = pool->acquire(), looked_at = pool->acquire();
  rt::FrameMeta meta, looked_at_meta;
  std::vector<std::unique_ptr<app::DynamicMasks>> masks;
  masks.reserve(holds.size());
  for (const float hold : holds) masks.push_back(open(pool.get(), model, score, hold));
  std::vector<Sums> sums(masks.size());
  const auto fill = [&](const cv::Mat& bgr, int into) {
    cv::Mat grey;
    cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
    for (int y = 0; y < grey.rows; ++y)
      std::memcpy(pool->grey(into).row(y), grey.ptr(y), static_cast<std::size_t>(grey.cols));
    std::memcpy(pool->bgr(into), bgr.data, bgr.total() * 3);
  };
  const int count = std::min(limit, static_cast<int>(pictures.size()));
  for (int i = 0; i < count; ++i) {
    const auto& row = pictures[static_cast<std::size_t>(i)];
    const cv::Mat with = picture(folders[0] + "/" + row.at(1)),
                  without = picture(folders[1] + "/" + empty.at(row.at(0)));
    const auto& boxes = people[row.at(0)];
    const cv::Mat truth = silhouettes(with, without, boxes);
    fill(with, slot);
    meta.t_capture_ns = static_cast<rt::TimeNs>(std::stod(row.at(0)) * 1e9);
    if (i % every == 0) {
      fill(with, looked_at);
      looked_at_meta = meta;
    }
    for (std::size_t k = 0; k < masks.size(); ++k) {
      if (i >= late && (i - late) % every == 0) masks[k]->detect({.frame = {looked_at, looked_at_meta}});
      const rt::MaskPyramidView view = masks[k]->mask_for(meta, pool->grey(slot));
      if (i < 10) continue;
      cv::Mat mask(first.size(), CV_8U);
      for (int y = 0; y < mask.rows; ++y)
        for (int x = 0; x < mask.cols; ++x) mask.at<std::uint8_t>(y, x) = view.level[0].row(y)[x] != 0 ? 255 : 0;
      take(truth, mask, boxes, &sums[k]);
    }
  }
  for (std::size_t k = 0; k < sums.size(); ++k) {
    const Sums& s = sums[k];
    std::printf(
        "score %.2f hold %.2f every %d late %d: %d pictures, people's area masked %.4f (cut by the edge %.4f); "
        "people missed %d of %d (cut %d of %d); longest run %d; pictures with more than 3 %% unmasked %d; "
        "masked that is nobody %.4f of the picture; runs",
        static_cast<double>(score), static_cast<double>(holds[k]), every, late, s.pictures, s.masked / s.people,
        s.cut > 0 ? s.cut_masked / s.cut : 0, s.missed, s.seen, s.cut_missed, s.cut_seen, s.longest, s.much,
        s.other / s.pictures);
    for (const auto& [length, times] : s.runs)
      if (times > 0) std::printf(" %dx%d", times, length);
    std::printf("\n");
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return bench::last_catch("godwit-mask-survey", run, argc, argv);
}
