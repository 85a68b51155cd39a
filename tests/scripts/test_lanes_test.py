#!/usr/bin/python3
"""scripts/test itself: its two lanes go at once, neither hides what failed in the other, and Ctrl-C ends both.

In a folder of its own, where cmake, ctest and the scripts are told what to do by this test.
"""
import os
import pathlib
import re
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCRIPTS = ("scripts/setup", "scripts/check_includes", "scripts/check_format", "scripts/check_docs", "scripts/check_tidy", "scripts/document",
           "scripts/fuzz", "tests/vm/run")
# Each program writes down how it was called, then does what stands in the file of that name, if there is one.
STUB = """#!/bin/bash
cd "{folder}"
call=$(basename "$0")
case "$call" in
  cmake) [ "$1" = --build ] || exit 0; call=build_$3 ;;
  ctest) call=tests_$(basename "$2") ;;
esac
echo "$call" >>calls
echo "what $call prints"
[ ! -e "do/before_$call" ] || . "do/before_$call"
[ "${{call%%_*}}" != tests ] || echo "100% tests passed, 0 tests failed out of 1"
[ ! -e "do/$call" ] || . "do/$call"
"""


class TestLanes(unittest.TestCase):
    def setUp(self):
        self.folder = pathlib.Path(tempfile.mkdtemp())
        self.addCleanup(shutil.rmtree, self.folder)
        for name in (*SCRIPTS, "bin/cmake", "bin/ctest"):
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(STUB.format(folder=self.folder))
            path.chmod(0o755)
        shutil.copy(ROOT / "scripts/test", self.folder / "scripts/test")
        slow = self.folder / "build/aarch64/tests/vo_core/unity/vo_core_slow_0.cpp"
        slow.parent.mkdir(parents=True)
        slow.write_text('#include "tests/vo_core/crowd_test.cpp"\n')
        with_torch = self.folder / "tests/detector/CMakeLists.txt"
        with_torch.parent.mkdir(parents=True)
        with_torch.write_text("    foreach(name torch_loss_test)\n")
        (self.folder / "do").mkdir()

    def do(self, call, commands):
        (self.folder / "do" / call).write_text(commands)

    def calls(self):
        path = self.folder / "calls"
        return path.read_text().split() if path.exists() else []

    def start(self, *steps, **options):
        environment = dict(os.environ, PATH=f"{self.folder}/bin:{os.environ['PATH']}", CI="true")
        return subprocess.Popen([self.folder / "scripts/test", *steps], env=environment, stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, text=True, **options)

    def run_steps(self, *steps):
        process = self.start(*steps)
        printed, _ = process.communicate(timeout=60)
        return process.returncode, printed

    def test_all_steps_are_run_and_told(self):
        status, printed = self.run_steps()
        self.assertEqual(status, 0, printed)
        calls = self.calls()
        for name in ("build_release", "tests_release", "run", "build_aarch64", "tests_aarch64", "build_asan", "tests_asan",
                     "build_tsan", "tests_tsan", "fuzz", "check_includes", "check_format", "check_docs", "check_tidy", "document"):
            self.assertIn(name, calls)
            self.assertIn(f"what {name} prints", printed)
        self.assertEqual(printed.count("100% tests passed"), 8, "printed once when it ended, and once at the end")
        self.assertIn("only scripts/test full runs vo_core's, of 1 files", printed)
        self.assertIn("only scripts/test full, or training, runs torch_loss_test", printed)

    def test_a_build_goes_while_tests_run(self):
        # Neither could end without the other.
        self.do("build_tsan", "until [ -e in_tests ]; do sleep 0.1; done; touch in_build\n")
        self.do("tests_release", "touch in_tests; until [ -e in_build ]; do sleep 0.1; done\n")
        status, printed = self.run_steps("release", "tsan")
        self.assertEqual(status, 0, printed)

    def test_tests_wait_for_their_build(self):
        self.do("build_release", "sleep 1; echo built_release >>calls\n")
        status, printed = self.run_steps("release")
        self.assertEqual(status, 0, printed)
        calls = self.calls()
        self.assertLess(calls.index("built_release"), calls.index("tests_release"))

    def test_a_step_alone(self):
        status, printed = self.run_steps("tsan")
        self.assertEqual(status, 0, printed)
        # What the peers need is fetched while the step builds: the second setup has no place in the order.
        calls = self.calls()
        self.assertCountEqual(calls, ["setup", "setup", "build_tsan", "tests_tsan"])
        self.assertEqual(calls[0], "setup")
        self.assertLess(calls.index("build_tsan"), calls.index("tests_tsan"))

    def test_a_failed_build_is_told_and_the_rest_is_run(self):
        self.do("build_release", "echo 'error: no semicolon'; exit 1\n")
        status, printed = self.run_steps("release", "tsan")
        self.assertEqual(status, 1)
        self.assertRegex(printed, r"release build +FAILED")
        self.assertIn("error: no semicolon", printed)
        self.assertRegex(printed, r"release +not run: its build FAILED")
        self.assertRegex(printed, r"tsan tests +ok")
        self.assertNotIn("tests_release", self.calls())

    def test_what_failed_is_told_again_at_the_end(self):
        self.do("before_tests_release", "echo '  7/9 Test #7: link.poses ...***Failed 3 s'; echo 'FAIL  quality -1'\n")
        self.do("tests_release", "exit 8\n")
        status, printed = self.run_steps("release")
        self.assertEqual(status, 1)
        self.assertEqual(printed.count("#7: link.poses"), 2, printed)
        self.assertEqual(printed.count("FAIL  quality -1"), 2, printed)

    def test_failed_tests_are_told_and_the_rest_is_run(self):
        self.do("tests_release", "exit 8\n")
        self.do("check_format", "exit 1\n")
        status, printed = self.run_steps("rules", "release", "tsan")
        self.assertEqual(status, 1)
        self.assertRegex(printed, r"release tests +FAILED")
        self.assertRegex(printed, r"format +FAILED")
        self.assertRegex(printed, r"clang-tidy, what changed +ok")
        self.assertRegex(printed, r"tsan tests +ok")

    def test_a_killed_builder_is_a_failure(self):
        self.do("build_tsan", "kill -9 $(ps -o ppid= $PPID) $PPID\n")
        status, printed = self.run_steps("release", "tsan")
        self.assertNotEqual(status, 0)
        self.assertRegex(printed, r"release tests +ok")
        self.assertRegex(printed, r"tsan +not run: its build FAILED, and the builder with it")

    def test_processor_time_is_told_of_the_step_that_took_it(self):
        self.do("tests_release", "python3 -c 'import time\nwhile time.process_time() < 3: pass'\n")
        status, printed = self.run_steps("release", "tsan")
        self.assertEqual(status, 0, printed)
        took = {name: int(re.search(name + r" +ok +\d+ s +(\d+) s of processor", printed)[1])
                for name in ("release build", "release tests", "tsan build", "tsan tests")}
        self.assertIn(took.pop("release tests"), (3, 4))
        self.assertTrue(all(seconds <= 1 for seconds in took.values()), took)

    def test_an_unknown_step_is_refused(self):
        status, printed = self.run_steps("release", "tsna")
        self.assertEqual(status, 2)
        self.assertIn("unknown step 'tsna'", printed)
        self.assertEqual(self.calls(), [])

    def test_interrupted_both_lanes_end(self):
        self.do("build_tsan", "echo $$ >building; exec sleep 300\n")
        self.do("tests_release", "echo $$ >testing; exec sleep 300\n")
        # As from a terminal: to all that belong to it.
        process = self.start("release", "tsan", start_new_session=True)
        pids = []
        for name in ("building", "testing"):
            path = self.folder / name
            until = time.monotonic() + 60
            while not (path.exists() and path.read_text().strip()):
                self.assertLess(time.monotonic(), until)
                time.sleep(0.1)
            pids.append(int(path.read_text()))
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=60)
        self.assertEqual(process.returncode, 130)
        for pid in pids:
            self.assertFalse(pathlib.Path(f"/proc/{pid}").exists())
        self.assertNotIn("tests_tsan", self.calls())


if __name__ == "__main__":
    unittest.main()
