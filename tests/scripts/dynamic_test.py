"""benchmarks/dynamic with a stand-in for the program: what it flies, repeats and refuses, and what its table says."""
import os
import pathlib
import subprocess
import sys
import unittest

sys.dont_write_bytecode = True
import stand_in  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Flies the truth with noise: run n is n times as bad; with the gate all is tracked, without it only half.
FLYER = '''#!/usr/bin/python3
import pathlib, random, sys
a = sys.argv
here, out = pathlib.Path(__file__).parent, pathlib.Path(a[a.index('--out') + 1])
with open(here / 'flown', 'a') as log:
    log.write(' '.join(a[1:]) + chr(10))
lines = (here / 'flown').read_text().splitlines()
n = sum(line == lines[-1] for line in lines)
out.mkdir(parents=True)
truth = [l.split() for l in open(pathlib.Path(a[2]) / 'groundtruth.txt')]
random.seed(1)
frames, poses = open(out / 'frames.csv', 'w'), open(out / 'trajectory.tum', 'w')
frames.write('t,tracked,fate\\n')
for i, row in enumerate(truth):
    tracked = '--gate' in a or i % 2 == 0
    frames.write('%s,%d,processed\\n' % (row[0], tracked))
    if tracked:
        p = [float(x) + random.gauss(0, 0.01 * n) for x in row[1:4]]
        poses.write('%s %.6f %.6f %.6f 0 0 0 1 1\\n' % (row[0], *p))
'''


class Dynamic(stand_in.StandInTest):
    FLYER = FLYER

    def setUp(self):
        super().setUp()
        still = self.folder / 'shared/data/tum_fr1_xyz'
        still.mkdir(parents=True)
        (still / 'groundtruth.txt').write_text(
            ''.join(f'{i / 30:.6f} {i % 17} {i % 13} {i % 7} 0 0 0 1\n' for i in range(200)))

    def run_it(self, *arguments):
        return subprocess.run([sys.executable, str(ROOT / 'benchmarks' / 'dynamic'), '--godwit', str(self.flyer),
                               '--out', str(self.folder / 'out'), *arguments], capture_output=True, text=True,
                              env=os.environ | {'GODWIT_SHARED_DIR': str(self.folder / 'shared')})

    def flown(self):
        return (self.folder / 'flown').read_text().splitlines()

    def test_table_tells_the_worst_share_and_the_median_error(self):
        done = self.run_it('--worlds', 'still', '--guards', 'neither,gate', '--runs', '3')
        self.assertEqual(done.returncode, 0, done.stderr)
        neither, gate = done.stdout.splitlines()[2:]
        self.assertIn('| still | neither | 3 | 50.0 % |', neither)
        self.assertIn('| still | gate | 3 | 100.0 % |', gate)
        median, worst = (float(x) for x in gate.split('|')[5].split('/'))
        # Noise along three axes, twice and three times 0.01 m.
        self.assertAlmostEqual(median, 0.02 * 3 ** 0.5, delta=0.004)
        self.assertAlmostEqual(worst, 0.03 * 3 ** 0.5, delta=0.006)
        self.assertAlmostEqual(float(gate.split('|')[6]), 0.02 * 6 ** 0.5, delta=0.006)
        self.assertTrue(all('--pace real' in line for line in self.flown()))

    def test_what_was_flown_is_not_flown_again(self):
        first = self.run_it('--worlds', 'still', '--guards', 'both', '--sequential')
        again = self.run_it('--worlds', 'still', '--guards', 'both', '--sequential')
        self.assertEqual(first.stdout, again.stdout)
        self.assertEqual(len(self.flown()), 1)
        self.assertIn('--detector on --gate on', self.flown()[0])
        self.flyer.write_text(FLYER + '# another program\n')
        self.run_it('--worlds', 'still', '--guards', 'both', '--sequential')
        self.assertEqual(len(self.flown()), 2)

    def test_a_network_that_takes_its_time_is_flown_from_other_pictures_on(self):
        done = self.run_it('--worlds', 'still', '--guards', 'both', '--detection-ms', '85', '--runs', '3')
        self.assertEqual(done.returncode, 0, done.stderr)
        flown = self.flown()
        self.assertEqual([line.split('--start ')[1].split()[0] for line in flown], ['0', '10', '20'])
        self.assertTrue(all('--sequential' in line for line in flown))
        config = flown[0].split('--config ')[1].split()[0]
        self.assertEqual(pathlib.Path(config).read_text(), '[pipeline]\ndetection_ms = 85\n')
        self.run_it('--worlds', 'still', '--guards', 'both', '--detection-ms', '200', '--runs', '1')
        self.assertEqual(len(self.flown()), 4)  # not that of 85 ms
        for more in (['--sequential'], ['--detection-ms', '0']):
            self.assertIn('sequential by itself', self.run_it('--detection-ms', '85', *more).stderr)

    def test_another_network_is_flown_again(self):
        other = self.folder / 'other.onnx'
        other.write_text('another network')
        for more in ([], [], ['--model', str(other)]):
            self.run_it('--worlds', 'still', '--guards', 'detector', '--sequential', *more)
        self.assertEqual(len(self.flown()), 2)
        self.assertIn('cbam_yolov5n_416.onnx', self.flown()[0])
        self.assertIn(f'--model {other}', self.flown()[1])
        self.assertIn('nowhere.onnx is not there', self.run_it('--model', '/nowhere.onnx').stderr)

    def test_table_holds_only_the_runs_that_were_asked_for(self):
        self.run_it('--worlds', 'still', '--guards', 'gate', '--runs', '3')
        done = self.run_it('--worlds', 'still', '--guards', 'neither,gate', '--runs', '1')
        self.assertIn('| still | gate | 1 |', done.stdout)

    def test_a_flight_that_fails_is_told(self):
        self.flyer.write_text('#!/bin/sh\necho "godwit: it does not fly" >&2\nexit 3\n')
        done = self.run_it('--worlds', 'still', '--guards', 'gate', '--runs', '1')
        self.assertEqual(done.returncode, 1)
        self.assertIn('failed: godwit: it does not fly', done.stdout)

    def test_nonsense_is_refused(self):
        self.assertIn("no world 'sea'", self.run_it('--worlds', 'sea').stderr)
        self.assertIn("no guard 'dog'", self.run_it('--guards', 'dog').stderr)
        self.assertIn('at least 1', self.run_it('--runs', '0').stderr)
        self.flyer.unlink()
        self.assertIn('build it first', self.run_it().stderr)


if __name__ == '__main__':
    unittest.main()
