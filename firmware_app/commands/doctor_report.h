// What `godwit doctor` found, told as it is found.
#pragma once

#include <fmt/format.h>
#include <string>

namespace godwit::app {

/// One line each: what fits, what is only told, what does not fit and how to mend it.
class DoctorReport {
 public:
  void fits(const std::string& words) { say("ok   ", words); }
  void note(const std::string& words) { say("note ", words); }
  void wrong(const std::string& words) {
    ++wrong_;
    say("WRONG", words);
  }
  int wrong_count() const { return wrong_; }

 private:
  static void say(const char* mark, const std::string& words) {
    fmt::print("{}  {}\n", mark, words);
    std::fflush(stdout);
  }
  int wrong_ = 0;
};

}  // namespace godwit::app
