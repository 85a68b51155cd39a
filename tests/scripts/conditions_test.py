"""benchmarks/conditions with a stand-in for the program: what it judges, what it repeats and what it refuses."""
import csv
import pathlib
import subprocess
import sys
import unittest

sys.dont_write_bytecode = True
import stand_in  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Flies a curve: 100 pictures, the first 10 before the first pose, one of them missing. Seed 2 jumps by three metres near its
# end. The scenario 'broken' fails.
FLYER = '''#!/usr/bin/python3
import math, pathlib, sys
a = sys.argv
name, seed, out = a[2], int(a[a.index('--seed') + 1]), pathlib.Path(a[a.index('--out') + 1])
with open(pathlib.Path(__file__).parent / 'flown', 'a') as log:
    log.write(name + str(seed) + ' ' + ' '.join(a[5:]) + chr(10))
if name == 'broken':
    sys.exit('godwit: it does not fly')
out.mkdir(parents=True)
at = lambda t: (10 * math.cos(t), 7 * math.sin(1.3 * t), math.sin(2.1 * t))
with open(out / 'groundtruth.txt', 'w') as f:
    for i in range(1001):
        f.write('%.3f %.6f %.6f %.6f 0 0 0 1\\n' % (i / 100, *at(i / 100)))
frames, poses = open(out / 'frames.csv', 'w'), open(out / 'trajectory.tum', 'w')
frames.write('t,tracked,fate\\n')
for i in range(100):
    tracked = i >= 10 and i != 50
    frames.write('%.3f,%d,%s\\n' % (i / 10, tracked, 'bad' if i == 50 else 'processed'))
    if tracked:
        x, y, z = at(i / 10)
        poses.write('%.3f %.6f %.6f %.6f 0 0 0 1 1\\n' % (i / 10, x, y, z + (seed == 2 and i >= 95) * 3.0))
'''


class Conditions(stand_in.StandInTest):
    FLYER = FLYER

    def setUp(self):
        super().setUp()
        (self.folder / 'scenarios').mkdir()
        for name in ('calm', 'wild'):
            (self.folder / 'scenarios' / f'{name}.toml').write_text('')

    def run_it(self, *arguments):
        return subprocess.run([sys.executable, str(ROOT / 'benchmarks' / 'conditions'), '--godwit', str(self.flyer),
                               '--folder', str(self.folder / 'scenarios'), '--out', str(self.folder / 'out'),
                               *arguments], capture_output=True, text=True)

    def rows(self):
        with open(self.folder / 'out' / 'conditions.csv') as file:
            return {(r['scenario'], r['seed']): r for r in csv.DictReader(file)}

    def flown(self):
        return len((self.folder / 'flown').read_text().splitlines())

    def test_judges_each_flight(self):
        done = self.run_it('--seeds', '2')
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = self.rows()
        self.assertEqual(len(rows), 4)
        good, jumping = rows['calm', '1'], rows['calm', '2']
        self.assertEqual((good['pictures'], good['came'], good['tracked']), ('100', '99', '89'))
        self.assertEqual(good['first_pose_frames'], '10')
        self.assertEqual(good['one_map_share'], '1.0000')
        self.assertLess(float(good['ate_m']), 0.002)
        self.assertEqual(good['false_sure'], '0')
        self.assertEqual(jumping['false_sure'], '5')
        self.assertIn('| calm | 2 | 89.9 % | 100.0 % |', done.stdout)
        self.assertIn('| 5 of 178 |', done.stdout)
        self.assertEqual((self.folder / 'out' / 'conditions.md').read_text(), done.stdout)

    def test_goes_on_where_it_was(self):
        self.run_it('--seeds', '1')
        self.assertEqual(self.flown(), 2)
        self.run_it('--seeds', '2')
        self.assertEqual(self.flown(), 4, 'seed 1 is known')
        self.flyer.write_text(FLYER + '# another program\n')
        self.run_it('--seeds', '1', '--scenarios', 'calm')
        self.assertEqual(self.flown(), 5, 'what another program flew does not count')

    def test_short_and_further_options_reach_the_program(self):
        self.run_it('--short', '--seeds', '3', '--fly=--truth-masks')
        flown = (self.folder / 'flown').read_text()
        self.assertEqual(flown.count('--truth-masks'), 2, 'one seed of each')
        self.assertEqual(flown.count('--frames 300'), 2)

    def test_tells_what_did_not_fly_and_what_is_unknown(self):
        (self.folder / 'scenarios' / 'broken.toml').write_text('')
        done = self.run_it('--seeds', '1')
        self.assertEqual(done.returncode, 1)
        self.assertIn('| broken | 1 | failed: godwit: it does not fly |', done.stdout)
        self.assertIn("no scenario 'clam'", self.run_it('--scenarios', 'clam').stderr)
        self.assertIn('--seeds', self.run_it('--seeds', '0').stderr)


if __name__ == '__main__':
    unittest.main()
