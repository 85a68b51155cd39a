#!/usr/bin/python3
"""scripts/check_docs: the repository's documents are in order, and what leads nowhere is found.

  check_docs_test.py BUILD     options are compared with the --help of the programs built there, too
"""
import importlib.machinery
import importlib.util
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

sys.dont_write_bytecode = True
ROOT = pathlib.Path(__file__).resolve().parents[2]
CHECK = ROOT / 'scripts/check_docs'
if len(sys.argv) < 2:
    sys.exit('check_docs_test: name the folder of a build, build/release say')
BUILD = ['--build', sys.argv[1]]
NONE = '-' + '-wings'  # not written out, because the tests are searched for options, too
sys.path.insert(0, str(ROOT / 'scripts'))
from documents import commands, configuration, links, named_tests, reasons, runs  # noqa: E402


def load(path):
    """A program without an ending, as a module."""
    loader = importlib.machinery.SourceFileLoader(path.name, str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(path.name, loader))
    loader.exec_module(module)
    return module


def run(*words):
    return subprocess.run([str(CHECK), *map(str, words)], capture_output=True, text=True, check=False)


class CheckDocs(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # For all the pages below: what tests name is looked up once.
        cls.checks = load(CHECK)
        cls.known = {build: commands.Known(str(ROOT), build) for build in (None, BUILD[1])}
        cls.tests = runs.Tests(str(ROOT))

    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)

    def tearDown(self):
        self.temp.cleanup()

    def findings(self, text, name='page.md', words=()):
        (self.folder / name).write_text(text)
        known = self.known[words[1] if words else None]
        return [f'{number}: {what}'
                for number, what in sorted(set(self.checks.wrong_in(str(self.folder / name), known, self.tests)))]

    def test_the_program_tells_what_it_finds(self):
        page = self.folder / 'page.md'
        for text, status, lines in (('[a](gone.md)\n', 1, ['1: link to gone.md, which is not there']), ('a\n', 0, [])):
            page.write_text(text)
            told = run(page)
            self.assertEqual(told.returncode, status, told.stdout + told.stderr)
            self.assertEqual([line.partition('page.md:')[2] for line in told.stdout.splitlines()[:-1]], lines)
            self.assertEqual(told.stdout.splitlines()[-1], f'check_docs: 1 documents, {len(lines)} findings')

    def test_the_documents_are_in_order(self):
        for words in ([], BUILD) if BUILD else ([],):
            told = run(*words)
            self.assertEqual(told.returncode, 0, told.stdout + told.stderr)
            self.assertRegex(told.stdout, r'check_docs: \d\d documents, 0 findings')

    def test_links_and_anchors(self):
        (self.folder / 'other.md').write_text('# One heading, and `code`\n## Twice\n## Twice\n')
        self.assertEqual(self.findings('# Here\n[a](other.md) [b](#here) [c](other.md#one-heading-and-code) [d](other.md#twice-1) '
                                       '[e](https://x.y/z#q) `[f](no link)`\n'), [])
        self.assertEqual(self.findings('[a](gone.md)\n[b](other.md#nowhere) [c](#gone)\n'),
                         ['1: link to gone.md, which is not there', '2: link to #gone: no heading of that page is #gone',
                          '2: link to other.md#nowhere: no heading of that page is #nowhere'])

    def test_headings_in_code_are_none(self):
        self.assertEqual(links.anchors('# A\n```\n# b\n```\n## [C](d.md) e\n'), {'a', 'c-e'})

    def test_names_of_files(self):
        self.assertEqual(self.findings('`hal/rt/time.h` `hal/rt/time` `hal/rt/gone.cpp` `scripts/{demo,gone}` `build/release/x`\n'),
                         ['1: `hal/rt/gone.cpp` is not there', '1: `scripts/gone` is not there'])

    def test_commands_of_ours(self):
        for good in ('godwit replay FOLDER --out DIR --imu on', 'build/release/firmware_app/godwit fly street --seed 2',
                     'scripts/test full', 'tests/vm/run service', 'benchmarks/conditions --seeds 1', 'cmake --preset release',
                     'sudo ip link set can0 up', 'godwitd --config FILE', 'GODWIT_X=1 scripts/golden check  # a word'):
            self.assertEqual(self.findings(f'Text\n\n    {good}\n'), [], good)
            self.assertEqual(self.findings(f'So: `{good}`.\n'), [], good)
        for bad, why in (('godwit fly street --sed 2', '`godwit fly` has no option --sed'),
                         ('godwit flie street', '`godwit` has no command flie'),
                         ('godwit fly stret', 'there is no scenario stret'),
                         ('scripts/gone --all', '`scripts/gone` is not there'),
                         ('scripts/demo --slow', '`scripts/demo` has no option --slow'),
                         ('scripts/test fast', '`scripts/test` has no step fast'),
                         ('tests/vm/run gone', '`tests/vm/run` has no case gone'),
                         ('benchmarks/conditions --scenarios strete', 'there is no scenario strete'),
                         ('build/release/benchmarks/godwit-gone X', 'nothing of that name is built'),
                         ('cmake --preset fast', 'cmake has no preset fast')):
            for text in (f'Text\n\n    {bad}\n', f'So: `{bad}`.\n', f'```\n{bad}\n```\n', f'    true && {bad}\n'):
                found = [f for f in self.findings(text) if why in f]
                self.assertEqual(len(found), 1, (text, why))

    def test_what_is_marked_is_left_alone(self):
        self.assertEqual(self.findings(f'Of another one: `godwit fly {NONE} 2` <!-- not ours -->\n'), [])

    def test_what_is_no_command(self):
        self.assertEqual(self.findings('Text\n\n    E = m c^2 --> x\n\n`godwit` and `--imu on`, `a --b`\n'), [])
        self.assertEqual(self.findings(f'`{NONE}`\n'), [f'1: no program here has an option {NONE}'])

    def test_by_the_programs_own_help(self):
        self.assertEqual(self.findings('    godwit fly street --loop 2\n'), [], 'another command of the program has it')
        self.assertEqual(self.findings('    godwit fly street --loop 2\n', words=BUILD), ['1: `godwit fly` has no option --loop'])
        self.assertEqual(self.findings('    ctest -R no_such_test\n', words=BUILD), ['1: ctest knows no test no_such_test'])

    def test_commands_are_run_by_a_test_or_marked(self):
        told = 'no test runs `{}`, and scripts/documents/runs.py does not say why'
        tests = runs.Tests(ROOT)
        for good in ('godwit replay FOLDER --out DIR --imu on', 'godwit calibrate imu OUT --plot FILE', 'godwit --version', 'godwitd --config F',
                     'benchmarks/metric simulator --seeds 1', 'tests/vm/run service', 'build/release/benchmarks/godwit-yardstick X',
                     'scripts/package --generic', 'ctest -R accuracy', 'sudo modprobe can'):
            self.assertEqual([key for key in runs.not_run(good, tests) if key not in runs.NOT_RUN], [], good)
        # Each program without its tests.
        for program, files, key in (('benchmarks/metric starts', r'metric_test', 'benchmarks/metric'),
                                    ('scripts/from_video F', r'from_video|look_into|from_kitti', 'scripts/from_video'),
                                    ('godwit sim street --imu-faults', r'replay_command', 'godwit sim --imu-faults'),
                                    ('build/release/benchmarks/godwit-yardstick X', r'scripts/test$', 'godwit-yardstick'),
                                    ('tests/service/memory_test.py X', r'service/CMake', 'tests/service/memory_test.py')):
            self.assertEqual(list(runs.not_run(program, tests)), [], program)
            fewer = runs.Tests(ROOT)
            fewer.files = {name: text for name, text in tests.files.items() if not re.search(files, name)}
            self.assertEqual(list(runs.not_run(program, fewer)), [key])
            self.assertEqual(list(runs.wrong_runs(f'a\n\n    {program}\n', fewer)), [(3, told.format(key))])
        self.assertEqual(len(list(runs.wrong_marks([], tests))), len(runs.NOT_RUN), 'a mark that no document needs is in vain')

    def test_each_hazard_names_a_test(self):
        table = '| # | failure | test |\n|---|---|---|\n'
        self.assertEqual(self.findings(table + '| 1 | a | LostIsToldWithTheFrame; link_test.py lost |\n'
                                       '| 2 | b | `tests/vm/run` socketcan |\n', 'hazards.md'), [])
        self.assertEqual(self.findings(table + '| 1 | a | - |\n| 3 | b | NoSuchTestIsThere |\n| 3 | c | gone_test.py |\n', 'hazards.md'),
                         ['3: row 1 names no test', '4: no test is called NoSuchTestIsThere', '4: row 2 has the number 3',
                          '4: row 2 names no test', '5: gone_test.py is not in tests/', '5: row 3 names no test'])
        faults = '| # | what happened | now | test |\n|---|---|---|---|\n'
        self.assertEqual(self.findings(table + '| 1 | a | LineLog |\n\n' + faults + '| 1 | a | b | LineLog |\n| 2 | a | b | - |\n',
                                       'hazards.md'), ['8: row 2 names no test'])
        run = named_tests.Tests(ROOT, BUILD[1])
        self.assertEqual([run.is_run(t) for t in ('LostIsToldWithTheFrame', 'chaos_test.py', 'DoctorFinds', 'LostIsTold', 'gone_test.py')],
                         [True, True, True, False, False])
        self.assertEqual(self.findings('no table\n', 'hazards.md'), ['1: no table of hazards (it begins with "| # | failure |")'])

    def test_figures_have_a_command(self):
        table = '| what | error |\n|---|---|\n| a | 0.0123 m |\n'
        self.assertEqual(self.findings(f'# Page\n## One\n{table}\n## Two\n\n    scripts/test\n\n{table}'),
                         ['2: "One" shows figures and no command that makes them'])
        self.assertEqual(self.findings(f'# Page\n`scripts/test` makes all of it.\n## One\n{table}'), [])
        self.assertEqual(self.findings('# Page\n| what | version |\n|---|---|\n| a | 4.6.3 |\n'), [])

    def test_the_configuration_is_the_programs(self):
        page = configuration.page(ROOT, f'{BUILD[1]}/firmware_app/godwit')
        self.assertIn('\n| `can.node_id` | `42` | a whole number from 0 to 125 |\n', page)
        self.assertIn('\n## [camera]\n', page)
        with tempfile.TemporaryDirectory() as other:
            other = pathlib.Path(other)
            (other / 'config').mkdir()
            file = (ROOT / 'config/godwit.toml').read_text()
            for text, why in ((file.replace('node_id = 42', ''), 'lacks can.node_id'), (file + 'wings = 2\n', 'live.wings')):
                (other / 'config/godwit.toml').write_text(text)
                with self.assertRaisesRegex(ValueError, why):
                    configuration.page(other, f'{BUILD[1]}/firmware_app/godwit')

    def test_each_reason_is_explained(self):
        known = reasons.reasons(ROOT)
        # Of each way in which the sources write one.
        for reason in ('too few features', 'first map, homography', 'disparity too small [px]', 'no keyframe to begin with, points in it',
                       'too little speaks for the pose [nats]', 'the scale is not seen: its sigma [0.1 %]', 'rung down', 'IMU silent', 'no picture',
                       'waiting for motion that shows scale and vertical', 'by the inertial sensor alone [ms]', 'a newer picture had come',
                       'camera clock: the capture time did not advance', 'detector is back', 'flown blind too far to join on: sigma [cm]',
                       'nothing seen for too long to coast [ms]', 'tracking, mostly by proved points inside the mask'):
            self.assertIn(reason, known)
        found = self.findings('`too few features`\n', 'troubleshooting.md')
        self.assertEqual(len(found), len(known) - 1)
        self.assertTrue(all(re.match(r'1: `.*` is told by \S+ and not explained', f) for f in found), found)

    def test_readme_is_short(self):
        self.assertLessEqual((ROOT / 'README.md').read_text().count('\n'), 130)


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
