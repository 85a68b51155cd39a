"""benchmarks/flight_experiment and benchmarks/opencv_odometry: one short street is drawn and flown in all three ways; what was
flown is not flown again; failures and refusals are told.

  flight_experiment_test.py GODWIT
"""
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
GODWIT = pathlib.Path(sys.argv[1]).resolve()


def run(program, *words):
    return subprocess.run([str(ROOT / 'benchmarks' / program), *map(str, words)], capture_output=True, text=True, check=False)


class FlightExperiment(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.out = pathlib.Path(self.temp.name) / 'out'

    def tearDown(self):
        self.temp.cleanup()

    def fly(self, *words, godwit=GODWIT):
        return run('flight_experiment', '--out', self.out, '--godwit', godwit, *words)

    def rows(self):
        with open(self.out / 'flights.csv', newline='', encoding='utf-8') as file:
            return list(csv.DictReader(file))

    def test_three_ways_over_the_same_pictures(self):
        words = '--seeds', 1, '--first-seed', 7, '--frames', 120
        done = self.fly(*words)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = {r['way']: r for r in self.rows()}
        self.assertEqual(set(rows), {'masks', 'no masks', 'OpenCV'})
        for way in ('masks', 'no masks'):
            self.assertGreater(float(rows[way]['tracked']), 0.9, way)
            self.assertGreater(float(rows[way]['path_m']), 1)
            self.assertLess(float(rows[way]['ate_m']), 0.05)
        for row in rows.values():
            self.assertEqual(row['error'], '')
            # Its own errors, not the odometry's: the receiver is off by some decimetres, and not by nothing.
            if row['receiver_m']:
                self.assertGreater(float(row['receiver_m']), 0.02)
                self.assertLess(float(row['receiver_m']), 3)
        self.assertEqual((self.out / 'table.md').read_text(), done.stdout)
        self.assertEqual(len([x for x in done.stdout.splitlines() if x.startswith(('| masks', '| no masks', '| OpenCV'))]), 3)
        again = self.fly(*words)
        self.assertEqual((again.returncode, again.stdout, again.stderr), (0, done.stdout, ''))

    def test_a_flight_that_fails_is_told_and_flown_again(self):
        broken = pathlib.Path(self.temp.name) / 'godwit'
        broken.write_text('#!/bin/sh\necho "godwit: no such luck" >&2\nexit 1\n')
        broken.chmod(0o755)
        words = '--seeds', 1, '--frames', 60, '--ways', 'masks,no masks'
        for _ in range(2):
            done = self.fly(*words, godwit=broken)
            self.assertEqual(done.returncode, 1)
            self.assertIn('seed 1001, masks: godwit: no such luck', done.stderr)
            self.assertIn('are drawn', done.stderr)
            self.assertIn('| masks | 1 (1 failed) | 0.0 %', done.stdout)
            self.assertEqual(len(self.rows()), 2)

    def test_refusals(self):
        for word, words in {'--frames 60 or more': ['--frames', 10], "no 'eyes'": ['--ways', 'eyes']}.items():
            done = self.fly(*words)
            self.assertEqual((done.returncode, done.stdout), (2, ''))
            self.assertIn(word, done.stderr)
        self.assertEqual(self.fly(godwit='/nowhere').returncode, 2)
        done = run('opencv_odometry', self.temp.name, self.out)
        self.assertEqual(done.returncode, 2)
        self.assertIn('no sequence', done.stderr)
        self.assertNotIn('Traceback', done.stderr)


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
