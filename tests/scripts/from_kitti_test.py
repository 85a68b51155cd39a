"""scripts/from_kitti: a simulated flight in KITTI's layout is flown, and its truth fits in place and attitude; what is no such
sequence is refused with a word.

  from_kitti_test.py GODWIT
"""
import json
import math
import pathlib
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
import zlib

ROOT = pathlib.Path(__file__).resolve().parents[2]
GODWIT = pathlib.Path(sys.argv[1]).resolve()
FRAMES = 75


def run(*words):
    return subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)


def convert(*words):
    return run(ROOT / 'scripts/from_kitti', *words)


def rotation(q):
    x, y, z, w = q
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]


def png(width, height, colour=0):
    """A black picture; colour: PNG's colour type, 0 grey, 2 RGB."""
    def chunk(name, data):
        return struct.pack('>I', len(data)) + name + data + struct.pack('>I', zlib.crc32(name + data))
    rows = (b'\0' + bytes(width * (3 if colour else 1))) * height
    return b'\x89PNG\r\n\x1a\n' + chunk(b'IHDR', struct.pack('>IIBBBBB', width, height, 8, colour, 0, 0, 0)) + \
        chunk(b'IDAT', zlib.compress(rows)) + chunk(b'IEND', b'')


class FromKitti(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        self.sequence = self.folder / 'dataset/sequences/05'
        self.out = self.folder / 'out'

    def tearDown(self):
        self.temp.cleanup()

    def little(self, pictures=3, **files):
        """A sequence of black pictures; files: other contents, None: not there."""
        for camera, colour in ((0, 0), (2, 2)):
            (self.sequence / f'image_{camera}').mkdir(parents=True, exist_ok=True)
            for i in range(pictures):
                (self.sequence / f'image_{camera}/{i:06}.png').write_bytes(png(1241, 376, colour))
        all_files = {'times_txt': '0.000000e+00\n1.036224e-01\n2.072e-01\n',
                     'calib_txt': 'P0: 718.856 0 607.1928 0 0 718.856 185.2157 0 0 0 1 0\n'
                                  'P2: 707.0 0 601.5 -70.7 0 707.5 183.25 0 0 0 1 0\nTr: 1 0 0 0 0 1 0 0 0 0 1 0\n'} | files
        for name, text in all_files.items():
            if text is not None:
                (self.sequence / name.replace('_', '.')).write_text(text)

    def test_a_flight_fits_its_truth(self):
        # A lens without distortion, as the benchmark's pictures are rectified.
        scenario = re.sub(r'(?m)^distortion = .*$', 'distortion = [0, 0, 0, 0, 0]',
                          (ROOT / 'config/scenarios/street.toml').read_text())
        (self.folder / 'plain.toml').write_text(scenario)
        flown = self.folder / 'sim'
        done = run(GODWIT, 'sim', self.folder / 'plain.toml', '--start', 70, '--frames', FRAMES, '--format', 'png', '--out', flown)
        self.assertEqual(done.returncode, 0, done.stderr)
        camera = dict(line.split(': ', 1) for line in (flown / 'camera.yaml').read_text().splitlines() if ': ' in line)
        (self.sequence / 'image_0').mkdir(parents=True)
        index = [line.split() for line in (flown / 'rgb.txt').read_text().splitlines() if line[0] != '#']
        for i, (_, file) in enumerate(index):
            shutil.copy(flown / file, self.sequence / f'image_0/{i:06}.png')
        times = [float(t) for t, _ in index]
        (self.sequence / 'times.txt').write_text(''.join(f'{t - times[0]:e}\n' for t in times))
        (self.sequence / 'calib.txt').write_text(f"P0: {camera['fx']} 0 {camera['cx']} 0 0 {camera['fy']} {camera['cy']} 0 0 0 1 0\n")
        # The truth in the benchmark's axes: relative to the first camera.
        rows = [[float(x) for x in line.split()] for line in (flown / 'groundtruth.txt').read_text().splitlines() if line[0] != '#']
        poses = []
        for t in times:
            row = min(rows, key=lambda r: abs(r[0] - t))
            poses.append((rotation(row[4:8]), row[1:4]))
        R0, p0 = poses[0]
        lines = []
        for R, p in poses:
            d = [p[i] - p0[i] for i in range(3)]
            lines.append(' '.join(repr(x) for i in range(3) for x in
                                  [*(sum(R0[k][i] * R[k][j] for k in range(3)) for j in range(3)), sum(R0[k][i] * d[k] for k in range(3))]))
        (self.folder / 'dataset/poses').mkdir()
        (self.folder / 'dataset/poses/05.txt').write_text('\n'.join(lines) + '\n')

        done = convert(self.sequence, self.out)
        self.assertEqual((done.returncode, done.stdout), (0, f'{FRAMES} pictures, {FRAMES} poses of the truth: {self.out}\n'), done.stderr)
        done = run(GODWIT, 'replay', self.out, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads(run(ROOT / 'scripts/evaluate', self.out / 'groundtruth.txt', self.folder / 'run', '--json').stdout)
        self.assertEqual(told['frames'], FRAMES)
        self.assertGreater(told['tracked_share_after_first_pose'], 0.9)
        self.assertLess(told['ate_m'], 0.05)
        self.assertGreater(told['path_m'], 2)
        # Wrong axes or a wrong turn would be degrees.
        self.assertLess(told['rpe_1s_deg'], 0.5)

    def test_replay_takes_it_as_it_is(self):
        self.little()
        done = run(GODWIT, 'replay', self.sequence, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads((self.folder / 'run/summary.json').read_text())
        self.assertEqual((told['frames'], told['sequence']), (3, str(self.folder / 'run/sequence')))
        (self.sequence / 'calib.txt').unlink()
        done = run(GODWIT, 'replay', self.sequence, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 2)
        self.assertIn('calib.txt', done.stderr)

    def test_colour_alone_is_taken_too(self):
        self.little()
        shutil.rmtree(self.sequence / 'image_0')
        done = run(GODWIT, 'replay', self.sequence, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(json.loads((self.folder / 'run/summary.json').read_text())['frames'], 3)
        yaml = (self.folder / 'run/sequence/camera.yaml').read_text()
        for line in ('fx: 707.0', 'image_channels: 3', 'camera 2'):
            self.assertIn(line, yaml)

    def test_what_is_written(self):
        self.little(poses_txt='1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 -2 0 0 1 3\n0 0 1 0 0 1 0 0 -1 0 0 5\n')
        done = convert(self.sequence, self.out, '--camera', 2)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.out / 'rgb.txt').read_text(), '# seconds file\n0.000000000 pictures/000000.png\n'
                         '0.103622400 pictures/000001.png\n0.207200000 pictures/000002.png\n')
        yaml = (self.out / 'camera.yaml').read_text()
        for line in ('width: 1241', 'height: 376', 'fx: 707.0', 'fy: 707.5', 'cx: 601.5', 'cy: 183.25', 'image_channels: 3',
                     'distortion: []', 'fps: 9.65251'):
            self.assertIn(line, yaml)
        truth = [[float(x) for x in line.split()] for line in (self.out / 'groundtruth.txt').read_text().splitlines()[1:]]
        # Camera 2 lies 0.1 m to the right of camera 0: in the world y points left, x forward.
        for row, place in zip(truth, ((0, -0.1, 0), (3, -1.1, 2), (4.9, 0, 0))):
            for got, wanted in zip(row[1:4], place):
                self.assertAlmostEqual(got, wanted, places=6)
        R = rotation(truth[0][4:8])
        for got, wanted in zip((x for r in R for x in r), (0, 0, 1, -1, 0, 0, 0, -1, 0)):
            self.assertAlmostEqual(got, wanted, places=6)
        self.assertAlmostEqual(math.dist(truth[2][4:8], (0, 0, 0, 0)), 1)

    def test_without_poses(self):
        self.little()
        self.assertEqual(convert(self.sequence, self.out).returncode, 0)
        self.assertFalse((self.out / 'groundtruth.txt').exists())
        done = run(GODWIT, 'replay', self.out, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 0, done.stderr)

    def refused(self, words, *more, **files):
        if files or not self.sequence.exists():
            self.little(**files)
        done = convert(self.sequence, self.out, *more)
        self.assertEqual((done.returncode, done.stdout), (2, ''), done.stderr)
        self.assertIn(words, done.stderr)
        self.assertEqual(len(done.stderr.splitlines()), 1)

    def test_refuses_what_is_no_such_sequence(self):
        for words, files in (('times.txt:2: "noon" is no time in seconds', {'times_txt': '0\nnoon\n'}),
                             ('times.txt:1: "nan" is no time', {'times_txt': 'nan\n'}),
                             ('times.txt: lists no times', {'times_txt': '\n'}),
                             ('3 pictures, but times.txt has 2 times', {'times_txt': '0\n0.1\n'}),
                             ('calib.txt: has no line "P0:"', {'calib_txt': 'P1: 1\n'}),
                             ('calib.txt:1: 2 numbers, 12 are wanted', {'calib_txt': 'P0: 1 2\n'}),
                             ('a focal length must be above 0', {'calib_txt': 'P0: 0 0 0 0 0 0 0 0 0 0 0 0\n'}),
                             ('2 poses, but times.txt has 3 times', {'poses_txt': '1 0 0 0 0 1 0 0 0 0 1 0\n' * 2})):
            self.refused(words, **files)
            shutil.rmtree(self.sequence)

    def test_refuses_other_folders(self):
        done = convert(self.folder / 'gone', self.out)
        self.assertEqual(done.returncode, 2)
        self.assertIn('there is no such folder', done.stderr)
        (self.folder / 'raw/image_00').mkdir(parents=True)
        self.assertIn("KITTI's raw layout", convert(self.folder / 'raw', self.out).stderr)
        self.little()
        (self.sequence / 'image_0/000000.png').write_text('text')
        self.refused('000000.png: not a PNG')
        self.refused('image_1: there is no such folder', '--camera', 1)

    def test_overwrites_nothing(self):
        self.little()
        self.out.mkdir()
        (self.out / 'mine').write_text('')
        self.refused('not empty')


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
