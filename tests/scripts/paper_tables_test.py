"""benchmarks/paper_tables with a stand-in for the program: what it flies, how it finds a calibration, what its tables say."""
import csv
import pathlib
import subprocess
import sys
import unittest

sys.dont_write_bytecode = True
import stand_in  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Flies the truth with noise, ten times as much of it without the network; notes the focal length that it was given. Of
# pictures of which some are missing it fails.
FLYER = '''#!/usr/bin/python3
import json, pathlib, random, sys
a = sys.argv
here, out, pictures = pathlib.Path(__file__).parent, pathlib.Path(a[a.index('--out') + 1]), pathlib.Path(a[2])
camera = dict(l.split(': ', 1) for l in (pictures / 'camera.yaml').read_text().splitlines())
on = a[a.index('--detector') + 1] == 'on'
with open(here / 'flown', 'a') as log:
    log.write(f"{camera['fx']} {on}\\n")
if (pictures / 'broken').exists():
    sys.exit('godwit: something is wrong')
out.mkdir(parents=True)
random.seed(1)
frames, poses = open(out / 'frames.csv', 'w'), open(out / 'trajectory.tum', 'w')
frames.write('t,tracked,fate\\n')
for row in (l.split() for l in open(pictures / 'groundtruth.txt')):
    seen = on or not (pictures / 'hard').exists() or float(row[0]) < 2
    frames.write('%s,%d,processed\\n' % (row[0], seen))
    if not seen:
        continue
    p = [float(x) + random.gauss(0, 0.01 if on else 0.1) for x in row[1:4]]
    poses.write('%s %.6f %.6f %.6f 0 0 0 1 1\\n' % (row[0], *p))
(out / 'summary.json').write_text(json.dumps({'poses_hz': 29.5 if on else 30, 'first_pose_after_ms': 400 if on else None,
                                              'thread_cpu_ms': {'median': 2.0 if on else 1.0}}))
'''


class PaperTables(stand_in.StandInTest):
    FLYER = FLYER

    def sequence(self, name, camera=None):
        folder = self.folder / name
        folder.mkdir()
        (folder / 'rgb.txt').write_text('# seconds file\n')
        (folder / 'groundtruth.txt').write_text(''.join(f'{i / 30:.6f} {i % 17} {i % 13} {i % 7} 0 0 0 1\n' for i in range(200)))
        if camera:
            (folder / 'camera.yaml').write_text(f'fx: {camera}\n')
        return folder

    def run_it(self, *words):
        return subprocess.run([sys.executable, str(ROOT / 'benchmarks/paper_tables'), '--godwit', str(self.flyer), '--out',
                               str(self.folder / 'out'), *map(str, words)], capture_output=True, text=True, check=False)

    def flown(self):
        return (self.folder / 'flown').read_text().splitlines()

    def test_both_tables(self):
        done = self.run_it(self.sequence('walk', 500), '--runs', 3)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.flown(), ['500 True', '500 False'] * 3)
        rows = [[c.strip() for c in line.split('|')[1:-1]] for line in done.stdout.splitlines() if line.startswith('| walk')]
        neither, both, off, on = rows
        self.assertEqual((neither[1], both[1], both[6]), ('neither', 'network and gate', '100.0 %'))
        # 0.01 and 0.1 m on each of three axes.
        self.assertAlmostEqual(float(both[2]), 0.0173, delta=0.002)
        self.assertAlmostEqual(float(neither[2]), 0.173, delta=0.02)
        self.assertAlmostEqual(float(both[7].split()[0]), 90, delta=1)
        # RMSE^2 = mean^2 + S.D.^2
        self.assertAlmostEqual(float(both[3]) ** 2 + float(both[5]) ** 2, float(both[2]) ** 2, delta=1e-5)
        self.assertEqual(on[1:], ['on', '0.40', '29.5', '500'])
        self.assertEqual(off[1:], ['off', '-', '30.0', '1000'])
        self.assertEqual((self.folder / 'out/paper_tables.md').read_text(), done.stdout)
        with open(self.folder / 'out/runs.csv', newline='', encoding='utf-8') as file:
            self.assertEqual(len(list(csv.DictReader(file))), 6)

    def test_a_calibration_by_the_datasets_name_by_file_or_none(self):
        plain = self.sequence('rgbd_dataset_freiburg3_walking_xyz')
        done = self.run_it(plain, '--runs', 1)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(self.flown()[0], '535.4 True')
        self.assertEqual(sorted(p.name for p in plain.iterdir()), ['groundtruth.txt', 'rgb.txt'])
        (self.folder / 'mine.yaml').write_text('fx: 123\n')
        self.assertEqual(self.run_it(plain, '--runs', 1, '--camera', self.folder / 'mine.yaml').returncode, 0)
        self.assertEqual(self.flown()[-1], '123 False')
        done = self.run_it(self.sequence('kitchen'), '--runs', 1)
        self.assertEqual((done.returncode, done.stdout), (2, ''))
        self.assertIn('has no camera.yaml', done.stderr)

    def test_a_flight_that_fails_is_told_and_the_others_count(self):
        broken = self.sequence('broken_one', 500)
        (broken / 'broken').write_text('')
        done = self.run_it(broken, self.sequence('walk', 500), '--runs', 1)
        self.assertEqual(done.returncode, 1)
        self.assertIn('broken_one, both, run 1: godwit: something is wrong', done.stderr)
        self.assertIn('| broken_one | neither (1 of 1 failed) | - | - | - | - | - |  |', done.stdout)
        self.assertIn('| walk | network and gate | 0.0', done.stdout)

    def test_errors_of_other_pictures_are_not_compared(self):
        hard = self.sequence('hard_one', 500)
        (hard / 'hard').write_text('')
        done = self.run_it(hard, self.sequence('walk', 500), '--runs', 1)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = [[c.strip() for c in line.split('|')[1:-1]] for line in done.stdout.splitlines() if line.startswith('| hard')]
        self.assertEqual((rows[0][6], rows[1][6], rows[1][7]), ('30.0 %', '100.0 %', 'of other pictures'))
        self.assertRegex(done.stdout, r'RMSE less on average: (89|90|91)\.')

    def test_refusals(self):
        (self.folder / 'empty').mkdir()
        walk = self.sequence('walk', 500)
        for word, words in {'has no rgb.txt': [self.folder / 'empty'], '--runs 0': [walk, '--runs', 0], 'the same name': [walk, walk],
                            'there is no such file': [walk, '--camera', self.folder / 'none.yaml']}.items():
            done = self.run_it(*words)
            self.assertEqual((done.returncode, done.stdout), (2, ''), words)
            self.assertIn(word, done.stderr)
            self.assertFalse((self.folder / 'flown').exists())


if __name__ == '__main__':
    unittest.main()
