"""benchmarks/readme_results: what it reads out of what the commands tell, that nothing is taken for a figure which is none, and
where the table goes."""
import importlib.machinery
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import unittest

sys.dont_write_bytecode = True
ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('readme_results', str(ROOT / 'benchmarks' / 'readme_results'))
results = importlib.util.module_from_spec(importlib.util.spec_from_loader('readme_results', loader))
loader.exec_module(results)

ACCURACY = '''
test 12
    Start 12: accuracy.tum_fr1_xyz

12: tum_fr1_xyz: bars 99% tracked, ATE 0.01 m, first pose within 10 frames
12: start  tracked  maps   ATE [m]  first pose after  peak [MB]
12:     0  100.00%     1    0.0044                 6      110.1
12:    37   99.71%     1    0.0035                 6      110.1
12:   111  100.00%     1    0.0039                 7      110.1
13: euroc_mh01: bars 99% tracked, ATE 0.006 m, first pose within 20 frames
13: start  tracked  maps   ATE [m]  first pose after  peak [MB]
13:     0  100.00%     1    0.0040                15      116.0
13:    37  100.00%     1    0.0036                 4      116.0
13:   111  100.00%     1    0.0036                 4      116.0
14: tum_fr1_xyz: ATE 0.0044 m sequential, 0.0046, 0.0047, 0.0045 m in threads
'''
WALKERS = '''| world | guard | runs | tracked in one map, worst | ATE median / worst [m] | RPE over 1 s, median [m] |
|---|---|---|---|---|---|
| moderate | both | 5 | 100.0 % | 0.0045 / 0.0048 | 0.0083 |
| severe | both | 5 | 62.9 % | 0.0142 / 0.0186 | 0.0210 |
'''
STREET = '''| scenario | seeds | tracked | one map, least | ATE median [m] | of the way | worst ATE [m] | false-sure frames |
|---|---|---|---|---|---|---|---|
| street | 1 | 98.1 % | 100.0 % | 0.026 | 0.015 % | 0.027 | 0 of 1765 |
'''
INERTIAL = '''
140: ok    and heads right to 0.10 degrees at most (0.5 allowed), through all of it; sigma told 0.2 to 0.5
140: ok    after three seconds without they come again within a second: [0.0333]
140: ok    and they come again after the seven: 2.57 s later
140: ok    no reset is told: []
'''
COST = '''798 frames, 792 tracked (99.25 %); thread CPU time, tracked frames only
[ms | in Y]                    median      p95      p99      max     mean   median    p95    p99    max   mean
yardstick (Y = median)          2.450    3.000    3.100    4.000    2.500    1.000  1.200  1.300  1.600  1.020
tracking                        0.809    1.000    1.127   10.000    0.800    0.330  0.410  0.460  4.100  0.330
tracking and mapping            1.000    1.500    2.000   11.000    1.176    0.410  0.610  0.820  4.500  0.480
'''
READ = {'accuracy': ACCURACY, 'walkers': WALKERS, 'street': STREET, 'inertial': INERTIAL, 'cost': COST}


class Figures(unittest.TestCase):
    def told(self, name):
        return [figure for _, figure, _ in results.ROWS[name][0](READ[name])]

    def test_the_worst_of_the_starts_counts(self):
        self.assertEqual(self.told('accuracy'), ['ATE 0.0044 m, 99.71 % in one map', 'ATE 0.0040 m, 100 % in one map'])

    def test_the_worst_of_the_runs_counts(self):
        self.assertEqual(self.told('walkers'), ['ATE 0.0048 m, 100 % in one map', 'ATE 0.0186 m, 62.9 % in one map'])
        self.assertEqual(self.told('street'), ['ATE 0.027 m, 98.1 % tracked'])

    def test_the_flight_over_the_bus(self):
        self.assertEqual(self.told('inertial'), ['one frame, no reset; back 0.03 s after the 3, 2.6 s after the 7; heading within 0.1 degrees'])

    def test_the_cost_is_the_ratio_and_not_the_time(self):
        self.assertEqual(self.told('cost'), ['0.33; 0.46 of the [yardstick](docs/results.md)'])

    def test_what_is_no_figure_is_refused(self):
        two_maps = ACCURACY.replace('  1    0.0035', '  2    0.0035')
        reset = INERTIAL.replace('told: []', 'told: [1]')
        failed = WALKERS.replace('| moderate | both | 5 | 100.0 %', '| moderate | both | 5 | failed: no model')
        for name, text in (('accuracy', two_maps), ('accuracy', ''), ('inertial', reset), ('street', ''), ('cost', ''), ('walkers', '')):
            with self.assertRaises(results.NoFigure, msg=name):
                results.ROWS[name][0](text)
        with self.assertRaises((results.NoFigure, ValueError)):
            results.ROWS['walkers'][0](failed)


class Complaint(unittest.TestCase):
    def test_of_a_test_that_fails_the_checks_that_failed_are_told(self):
        told = '874: ok    level\n874: FAIL  it came again after 1.2 s\n874: 1 failed\n\nErrors while running CTest\nUse "--rerun-failed"\n'
        self.assertEqual(results.complaint(told), ['874: FAIL  it came again after 1.2 s'])

    def test_of_anything_else_the_last_line(self):
        self.assertEqual(results.complaint('flying\ngodwit: no such model\n'), ['godwit: no such model'])
        self.assertEqual(results.complaint(''), [])


class Readme(unittest.TestCase):
    def test_the_table_goes_between_its_marks_and_names_the_commit(self):
        text = results.table({name: results.ROWS[name][0](told) for name, told in READ.items()}, 'abc1234')
        self.assertTrue(text.startswith('| all at commit abc1234 |'), text)
        self.assertEqual(text.count('\n'), 2 + 7)
        self.assertIn(f'| `{results.ROWS["accuracy"][1]}` |', text)
        with tempfile.TemporaryDirectory() as folder:
            readme = pathlib.Path(folder) / 'README.md'
            readme.write_text(f'before\n{results.MARKS[0]}old\n{results.MARKS[1]}after\n')
            results.put(readme, text)
            self.assertEqual(readme.read_text(), f'before\n{results.MARKS[0]}{text}{results.MARKS[1]}after\n')
            readme.write_text('nothing\n')
            with self.assertRaises(results.NoFigure):
                results.put(readme, text)

    def test_the_one_that_is_committed_has_a_place_for_it(self):
        text = (ROOT / 'README.md').read_text()
        self.assertTrue(all(mark in text for mark in results.MARKS))

    def test_half_a_table_is_not_written(self):
        done = subprocess.run([str(ROOT / 'benchmarks/readme_results'), '--only', 'cost', '--readme'], capture_output=True, text=True,
                              check=False)
        self.assertEqual(done.returncode, 2)
        self.assertIn('all rows', done.stderr)


if __name__ == '__main__':
    unittest.main()
