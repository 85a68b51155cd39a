#!/usr/bin/python3
"""scripts/check_tidy finds what .clang-tidy asks for: a finding of each family of checks, in a file by itself, in files that are
compiled together and in a header, by --all and in changed lines; and neither what the rest of a file has nor what a system header has.

In a repository of its own, with this project's checks, its plugin and its way of compiling files together.
"""
import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
CHECKS = {  # in files by themselves and together: what is found
    "bugprone-use-after-move", "bugprone-sizeof-expression", "bugprone-reserved-identifier",
    "bugprone-forward-declaration-namespace", "bugprone-unused-raii",
    "clang-analyzer-core.NullDereference", "clang-analyzer-core.DivideZero", "clang-analyzer-deadcode.DeadStores",
    "clang-analyzer-cplusplus.NewDelete", "clang-analyzer-cplusplus.NewDeleteLeaks",
    "concurrency-thread-canceltype-asynchronous",
    "performance-for-range-copy", "performance-unnecessary-value-param", "performance-inefficient-vector-operation",
    "performance-move-const-arg", "performance-unnecessary-copy-initialization",
    "readability-identifier-naming", "modernize-use-override", "modernize-use-nullptr",
}
# What .clang-tidy leaves out with its reason: planted, too, and not found.
LEFT_OUT = {"bugprone-integer-division", "bugprone-macro-parentheses"}
PLANTED = """#include "hal/SPACE.h"

#include <pthread.h>

#include <string>
#include <utility>
#include <vector>

#define SPACE_TWICE(x) x * 2
namespace SPACE {
namespace other { struct Elsewhere; }
struct Elsewhere { int a = SPACE_TWICE(1); };
int use(std::string text);
int moved(std::string text) {
  std::string other = std::move(text);
  return static_cast<int>(text.size() + other.size());
}
double half(int n) { return n / 2; }
int size(const int* p) { return static_cast<int>(sizeof(p) / sizeof(*p)); }
int __reserved = 0;
struct Held {
  explicit Held(int n) : n(n) {}
  ~Held() { n = 0; }
  int n;
};
int held() {
  Held(42);
  return 1;
}
int null(int n) {
  int* p = 0;
  if (n > 3) p = &n;
  return *p;
}
int zero(int n) { return n == 0 ? 1 / n : n; }
int dead(int n) {
  int unread = n;
  unread = 3;
  return n;
}
int twice() {
  int* p = new int(1);
  delete p;
  return *p;
}
int leak() {
  int* p = new int(1);
  return *p;
}
void cancelled() { pthread_setcanceltype(PTHREAD_CANCEL_ASYNCHRONOUS, nullptr); }
int copied(const std::vector<std::string>& all) {
  int n = 0;
  for (const auto text : all) n += static_cast<int>(text.size());
  return n;
}
int by_value(std::string text) { return static_cast<int>(text.size()); }
std::vector<int> grown(int n) {
  std::vector<int> v;
  for (int i = 0; i < n; ++i) v.push_back(i);
  return v;
}
int moved_constant(const std::string& text) {
  const std::string copy = text;
  return use(std::move(copy));
}
int BadName() { return 0; }
// A template's findings are found where it is, however often it is made.
template <typename T>
T* nothing() { return 0; }
int* made() { return nothing<int>(); }
struct Derived : Base {
  virtual int value() const { return 2; }
};
}  // namespace SPACE
"""
HEADER = """#pragma once
#include <made/system.h>
namespace SPACE {
struct Base {
  virtual ~Base() = default;
  virtual int value() const { return 1; }
};
inline int* header_nothing() { return 0; }
}  // namespace SPACE
"""
SYSTEM = """#pragma once
inline int* SystemNothing() { return 0; }
"""
CLEAN = """namespace SPACE {
int clean() { return 1; }
}  // namespace SPACE
"""
CMAKE = """cmake_minimum_required(VERSION 3.25)
project(planted LANGUAGES CXX)
include(toolchain/options.cmake)
include_directories(SYSTEM system)
godwit_library(alone hal/alone.cpp)
godwit_library(together hal/one.cpp hal/clean.cpp hal/two.cpp)
godwit_library(tests tests/first_test.cpp tests/second_test.cpp)
"""


class TestCheckTidy(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        for name in ("scripts/check_tidy", "toolchain/options.cmake", "toolchain/tidy_own_code.cpp", ".clang-tidy"):
            (cls.folder / name).parent.mkdir(exist_ok=True)
            shutil.copy(ROOT / name, cls.folder / name)
        shutil.copy(ROOT / "CMakePresets.json", cls.folder)
        cls.write("CMakeLists.txt", CMAKE)
        cls.write("system/made/system.h", SYSTEM)
        cls.write(".gitignore", "/build/\n")
        for space in ("alone", "one", "clean", "two"):
            cls.write(f"hal/{space}.cpp", CLEAN.replace("SPACE", space))
        for space in ("first", "second"):
            cls.write(f"tests/{space}_test.cpp", CLEAN.replace("SPACE", space))
        cls.git("init", "-q", "-b", "main")
        cls.commit()
        # Built once, for all tests.
        status, printed = cls.check("--all")
        assert status == 0, printed

    @classmethod
    def write(cls, name, text):
        (cls.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (cls.folder / name).write_text(text)

    @classmethod
    def git(cls, *args):
        subprocess.run(["git", "-c", "user.name=t", "-c", "user.email=t@example.org", *args], cwd=cls.folder, check=True,
                       capture_output=True)

    @classmethod
    def commit(cls):
        cls.git("add", "-A")
        cls.git("commit", "-q", "--allow-empty", "-m", "state")

    @classmethod
    def check(cls, *args):
        run = subprocess.run([cls.folder / "scripts/check_tidy", *args], cwd=cls.folder, capture_output=True, text=True,
                             env={k: v for k, v in os.environ.items() if not k.startswith("GIT_")})
        return run.returncode, run.stdout + run.stderr

    def setUp(self):
        self.git("checkout", "-q", "-B", "work", "main")

    def tearDown(self):
        self.git("reset", "-q", "--hard")
        self.git("clean", "-q", "-fd")

    def plant(self):
        for space in ("alone", "one", "two"):
            self.write(f"hal/{space}.cpp", PLANTED.replace("SPACE", space))
            self.write(f"hal/{space}.h", HEADER.replace("SPACE", space))
        self.commit()

    def found(self, printed):
        """{file: its checks}"""
        all_found = {}
        for file, names in re.findall(r"^(\S+?):\d+:\d+: error: .* \[([^\]]+)\]$", printed, re.MULTILINE):
            all_found.setdefault(os.path.relpath(file, self.folder), set()).update(set(names.split(",")) - {"-warnings-as-errors"})
        return all_found

    def expect_planted(self, printed):
        found = self.found(printed)
        for space in ("alone", "one", "two"):
            self.assertEqual(CHECKS - found[f"hal/{space}.cpp"], set(), f"{space}\n{printed}")
            self.assertEqual(LEFT_OUT & found[f"hal/{space}.cpp"], set(), f"{space}\n{printed}")
            self.assertEqual(found[f"hal/{space}.h"], {"modernize-use-nullptr"})
        self.assertNotIn("SystemNothing", printed)

    def test_each_family_is_found_in_all(self):
        self.plant()
        status, printed = self.check("--all")
        self.assertEqual(status, 1, printed)
        self.expect_planted(printed)
        self.assertIn("6 files in 3 units (1 of tests, without the static analyzer), 2 of them with findings", printed)

    def test_the_static_analyzer_looks_at_tests_where_they_changed(self):
        self.write("tests/first_test.cpp", PLANTED.replace("SPACE", "first"))
        self.write("hal/first.h", HEADER.replace("SPACE", "first"))
        self.commit()
        for args, wanted in ((("--all",), {name for name in CHECKS if not name.startswith("clang-analyzer")}), ((), CHECKS)):
            status, printed = self.check(*args)
            self.assertEqual(status, 1, printed)
            self.assertEqual(self.found(printed)["tests/first_test.cpp"] & CHECKS, wanted, printed)

    def test_each_family_is_found_in_what_changed(self):
        self.plant()
        status, printed = self.check()
        self.assertEqual(status, 1, printed)
        self.expect_planted(printed)
        self.assertIn("3 files in 3 units, 3 of them with findings", printed)

    def test_what_did_not_change_is_not_told(self):
        self.plant()
        with (self.folder / "hal/one.cpp").open("a") as file:
            file.write("namespace one { int* last() { return 0; } }\n")
        self.commit()
        status, printed = self.check("HEAD~1")
        self.assertEqual(status, 1, printed)
        self.assertEqual(self.found(printed), {"hal/one.cpp": {"modernize-use-nullptr"}}, printed)
        self.assertEqual(printed.count("error:"), 1, printed)

    def test_an_included_source_is_found(self):
        self.write("hal/one.cpp", '#include "hal/alone.cpp"\n')
        self.commit()
        status, printed = self.check("--all")
        self.assertEqual(status, 1, printed)
        self.assertEqual(self.found(printed), {"hal/one.cpp": {"bugprone-suspicious-include"}}, printed)

    def test_a_file_that_nothing_compiles_is_told(self):
        self.write("hal/forgotten.cpp", CLEAN.replace("SPACE", "forgotten"))
        self.commit()
        status, printed = self.check("--all")
        self.assertEqual(status, 0, printed)
        self.assertRegex(printed, r"left out: hal/forgotten\.cpp toolchain/tidy_own_code\.cpp\n")


if __name__ == "__main__":
    unittest.main()
