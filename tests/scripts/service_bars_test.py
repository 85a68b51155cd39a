"""benchmarks/service_bars: what --write puts into the documents, and where."""
import importlib.machinery
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import unittest

sys.dont_write_bytecode = True
ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('service_bars', str(ROOT / 'benchmarks/service_bars'))
bars = importlib.util.module_from_spec(importlib.util.spec_from_loader('service_bars', loader))
loader.exec_module(bars)


def ages(of):
    return {'median': of, 'p95': of + 1, 'p99': of + 2, 'p99_9': of + 3, 'max': of + 4}


def flight(detector):
    return {'detector': detector, 'seconds': 60, 'age_at_pose_ms': ages(17), 'own_at_pose_ms': ages(1), 'age_at_bus_ms': None,
            'own_at_bus_ms': None, 'threads': [{'cpu_percent': 50}, {'cpu_percent': 16}], 'first_pose_ms': 300, 'poses_hz': 29.87,
            'missed_deadlines': 0, 'frames': {'dropped': 2, 'due': 1800}, 'memory_mb': {'resident': 413, 'pictures': 200}}


RUN = {'camera_delays_ms': {'delivery': 16.5, 'exposure': 8, 'readout': 15, 'transfer': 5}, 'input': '../shared/data/street',
       'version': '0.1.0 (commit abc1234)', 'machine': {'processors': 2, 'architecture': 'x86_64'}, 'flights': [flight(True), flight(False)]}


class Tables(unittest.TestCase):
    def test_all_of_it_names_the_commit(self):
        held = [{'bar': 'start', 'value': 0.1, 'unit': 's', 'most': 0.5, 'held': True, 'about': 'worst of 6'},
                {'bar': 'end', 'value': None, 'unit': 's', 'most': 5, 'held': False, 'about': ''}]
        for text in (bars.bars_table(held, RUN, 0.25), bars.table(RUN), bars.in_short(RUN)):
            self.assertIn('commit abc1234', text)
        told = bars.bars_table(held, RUN, 0.25)
        self.assertIn('| start | 0.5 s | 0.1 s | worst of 6 |\n| end | 5 s | -: missed |  |\n', told)
        self.assertIn('load 0.25 before', told)

    def test_the_sum_is_that_of_the_detector_on(self):
        other = RUN | {'flights': [flight(False) | {'own_at_pose_ms': ages(7)}, flight(True)]}
        self.assertIn('stands 1.00 ms after its picture came, 3.00 ms in 99 of 100', bars.in_short(other))
        self.assertIn('2 of 1800 pictures dropped', bars.in_short(other))

    def test_a_flight_without_a_bus_has_no_row_of_it(self):
        self.assertNotIn('age at bus', bars.table(RUN))
        self.assertIn('| age at pose | on | 17.00 | 18.00 | 19.00 | 20.00 | 21.00 |', bars.table(RUN))
        self.assertIn('| on | 300 ms | 29.87 | 0 | 2 of 1800 | 213 MB | 0.66 |', bars.table(RUN))


class Places(unittest.TestCase):
    def test_each_document_has_its_place(self):
        with tempfile.TemporaryDirectory() as folder:
            for name, document in bars.PLACES.items():
                copy = pathlib.Path(folder) / 'copy.md'
                copy.write_text((ROOT / document).read_text())
                bars.put(copy, name, 'new\n')
                self.assertIn(f'<!-- {name}: benchmarks/service_bars --write -->\nnew\n<!-- /{name} -->\n', copy.read_text())
            copy.write_text('nothing\n')
            with self.assertRaises(ValueError):
                bars.put(copy, 'bars', 'new\n')

    def test_half_of_it_is_not_written(self):
        done = subprocess.run([str(ROOT / 'benchmarks/service_bars'), '--only', 'latency', '--write'], capture_output=True, text=True,
                              check=False)
        self.assertEqual(done.returncode, 2)
        self.assertIn('wants all parts', done.stderr)


if __name__ == '__main__':
    unittest.main()
