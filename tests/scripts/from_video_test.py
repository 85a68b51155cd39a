"""scripts/from_video: a simulated flight is filmed, made a sequence again, and flown in it; times, sizes and calibrations come
out as they should; what cannot be used is refused with a word.

  from_video_test.py GODWIT
"""
import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
GODWIT = pathlib.Path(sys.argv[1]).resolve()
FRAMES = 75
CAMERA = 'model: pinhole\nwidth: 320\nheight: 240\nfx: 300\nfy: 301\ncx: 159.5\ncy: 119.5\ndistortion_model: none\ndistortion: []\n'


def run(*words):
    return subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)


def convert(*words):
    return run(ROOT / 'scripts/from_video', *words)


def film(file, pictures, fps=30):
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*'MJPG'), fps, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture)
    writer.release()


def index(out):
    return [(float(t), out / file) for t, file in
            (line.split() for line in (out / 'rgb.txt').read_text().splitlines() if line[0] != '#')]


def values(out):
    """The numbers of camera.yaml."""
    return {k: float(v) for k, v in re.findall(r'(?m)^(width|height|fx|fy|cx|cy): (\S+)$', (out / 'camera.yaml').read_text())}


class FromVideo(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        self.video, self.out, self.camera = self.folder / 'film.avi', self.folder / 'out', self.folder / 'camera.yaml'
        self.camera.write_text(CAMERA)

    def tearDown(self):
        self.temp.cleanup()

    def little(self, pictures=30, width=320, height=240):
        """Picture i is of grey 5 i + 20."""
        film(self.video, [np.full((height, width, 3), 5 * i + 20, np.uint8) for i in range(pictures)])

    def refused(self, word, *words):
        done = convert(*words)
        self.assertEqual((done.returncode, done.stdout), (2, ''), done.stderr)
        self.assertIn(word, done.stderr)
        self.assertNotIn('Traceback', done.stderr)
        self.assertNotIn('OpenCV(', done.stderr)  # what OpenCV says of its tries
        self.assertFalse((self.out / 'rgb.txt').exists())

    def test_a_film_of_a_flight_is_flown(self):
        flown = self.folder / 'sim'
        done = run(GODWIT, 'sim', 'street', '--scenarios', ROOT / 'config/scenarios', '--start', 70, '--frames', FRAMES, '--format', 'png',
                   '--out', flown)
        self.assertEqual(done.returncode, 0, done.stderr)
        times = [t for t, _ in index(flown)]
        film(self.video, [cv2.imread(str(file)) for _, file in index(flown)], 1 / np.median(np.diff(times)))
        done = convert(self.video, self.out, '--camera', flown / 'camera.yaml')
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn(f'{FRAMES} pictures', done.stdout)
        self.assertEqual((self.out / 'camera.yaml').read_text(), (flown / 'camera.yaml').read_text())
        # The truth's clock is the simulation's.
        shift = times[0] - index(self.out)[0][0]
        rows = [line.split() for line in (flown / 'groundtruth.txt').read_text().splitlines() if line[0] != '#']
        (self.out / 'groundtruth.txt').write_text(''.join(' '.join([f'{float(r[0]) - shift:.9f}', *r[1:]]) + '\n' for r in rows))
        done = run(GODWIT, 'replay', self.out, '--sequential', '--out', self.folder / 'run')
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads(run(ROOT / 'scripts/evaluate', self.out / 'groundtruth.txt', self.folder / 'run', '--json').stdout)
        self.assertGreater(told['tracked_share_after_first_pose'], 0.9)
        self.assertLess(told['ate_m'], 0.05)
        self.assertGreater(told['path_m'], 2)

    def test_replay_takes_a_film_as_it_is(self):
        self.little()
        flown = self.folder / 'run'
        done = run(GODWIT, 'replay', self.video, '--camera', self.camera, '--sequential', '--out', flown)
        self.assertEqual(done.returncode, 0, done.stderr)
        told = json.loads((flown / 'summary.json').read_text())
        self.assertEqual((told['frames'], told['sequence']), (30, str(flown / 'sequence')))
        # Again, with another camera: the earlier sequence makes way.
        done = run(GODWIT, 'replay', self.folder / 'gone.mp4', '--fov', 70, '--out', self.folder / 'other')
        self.assertEqual(done.returncode, 2)
        self.assertIn('gone.mp4: No such file or folder', done.stderr)
        done = run(GODWIT, 'replay', self.video, '--fov', 70, '--frames', 3, '--out', flown)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('Guessed', (flown / 'sequence/camera.yaml').read_text())
        for words, word in (((), 'add --camera'), (('--camera', self.folder / 'gone.yaml'), 'gone.yaml'), (('--fov', 9), '--fov'),
                            (('--fov', 70, '--camera', self.camera), 'one of them')):
            done = run(GODWIT, 'replay', self.video, '--out', self.folder / 'other', *words)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn(word, done.stderr)
        done = run(GODWIT, 'replay', self.camera, '--fov', 70, '--out', self.folder / 'other')
        self.assertEqual(done.returncode, 2)
        self.assertIn('no video', done.stderr)
        done = run(GODWIT, 'replay', flown / 'sequence', '--fov', 70, '--out', self.folder / 'other')
        self.assertEqual(done.returncode, 2)
        # Where the tools are a package of their own, and not installed.
        (self.folder / 'bin').mkdir()
        shutil.copy2(GODWIT, self.folder / 'bin/godwit')
        done = run(self.folder / 'bin/godwit', 'replay', self.video, '--fov', 70, '--out', self.folder / 'other')
        self.assertEqual(done.returncode, 2)
        self.assertIn('install the package godwit-tools', done.stderr)
        shutil.copy2(self.video, flown / 'sequence')
        done = run(GODWIT, 'replay', flown / 'sequence' / self.video.name, '--fov', 70, '--out', flown)
        self.assertEqual(done.returncode, 2)
        self.assertTrue((flown / 'sequence' / self.video.name).is_file())
        # What was not made there by an earlier run is not taken away, be it a sequence or not; what was begun in vain is.
        mine = self.folder / 'mine/sequence'
        mine.mkdir(parents=True)
        for name in ('thesis.txt', 'rgb.txt'):
            (mine / name).write_text('years of work')
            done = run(GODWIT, 'replay', self.video, '--fov', 70, '--out', self.folder / 'mine')
            self.assertEqual(done.returncode, 2)
            self.assertIn('in the way', done.stderr)
            self.assertTrue((mine / name).exists())
        self.assertFalse((self.folder / 'other/sequence').exists())

    def test_times_and_pictures(self):
        self.little()
        done = convert(self.video, self.out, '--camera', self.camera)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = index(self.out)
        self.assertEqual(len(rows), 30)
        for i, (t, file) in enumerate(rows):
            self.assertAlmostEqual(t, 0.1 + i / 30, delta=2e-3)
            self.assertAlmostEqual(cv2.imread(str(file)).mean(), 5 * i + 20, delta=2)

    def test_a_part_of_it(self):
        self.little()
        done = convert(self.video, self.out, '--camera', self.camera, '--start', 0.49, '--seconds', 0.32, '--every', 3)
        self.assertEqual(done.returncode, 0, done.stderr)
        rows = index(self.out)
        self.assertEqual([round((cv2.imread(str(f)).mean() - 20) / 5) for _, f in rows], [15, 18, 21, 24])
        self.assertAlmostEqual(rows[1][0] - rows[0][0], 0.1, delta=2e-3)

    def test_a_calibration_shrinks_with_the_pictures(self):
        self.little(3)
        done = convert(self.video, self.out, '--camera', self.camera, '--width', 160)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(cv2.imread(str(index(self.out)[0][1])).shape, (120, 160, 3))
        self.assertEqual(values(self.out), {'width': 160, 'height': 120, 'fx': 150, 'fy': 150.5, 'cx': 79.5, 'cy': 59.5})

    def test_a_calibration_of_the_shrunk_size_stays(self):
        self.little(3, 640, 480)
        done = convert(self.video, self.out, '--camera', self.camera, '--width', 320)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual((self.out / 'camera.yaml').read_text(), CAMERA)

    def test_a_field_of_view_is_a_guess_and_says_so(self):
        self.little(3)
        done = convert(self.video, self.out, '--fov', 90)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('a guess', done.stdout)
        self.assertEqual(values(self.out), {'width': 320, 'height': 240, 'fx': 160, 'fy': 160, 'cx': 159.5, 'cy': 119.5})

    def test_what_cannot_be_used(self):
        self.little(3)
        self.refused('there is no such file', self.folder / 'none.mp4', self.out, '--fov', 90)
        (self.folder / 'text.mp4').write_text('not a video\n')
        self.refused('no video that this machine can decode', self.folder / 'text.mp4', self.out, '--fov', 90)
        self.refused('cannot be read', self.video, self.out, '--camera', self.folder / 'none.yaml')
        self.camera.write_text(CAMERA.replace('320', '640'))
        self.refused('is of a 640 x 240 camera; the video is 320 x 240', self.video, self.out, '--camera', self.camera)
        self.camera.write_text(CAMERA.replace('fx: 300\n', ''))
        self.refused('has no line "fx: number"', self.video, self.out, '--camera', self.camera, '--width', 160)
        self.refused('from 10 to 150', self.video, self.out, '--fov', 200)
        self.refused('--width 640', self.video, self.out, '--fov', 90, '--width', 640)
        self.refused('--every 0', self.video, self.out, '--fov', 90, '--every', 0)
        for _ in range(2):  # nothing is left that would be in the way of the next attempt
            self.refused('no picture between', self.video, self.out, '--fov', 90, '--start', 20)

    def test_nothing_is_overwritten(self):
        self.little(3)
        self.out.mkdir()
        (self.out / 'kept').write_text('mine')
        self.refused('not an empty folder', self.video, self.out, '--fov', 90)
        self.assertEqual([p.name for p in self.out.iterdir()], ['kept'])

    def test_too_large_pictures_are_shrunk_and_that_is_told(self):
        self.little(2, 1920, 1080)
        self.refused('--width 1280 or less', self.video, self.out, '--fov', 60, '--width', 1900)
        done = convert(self.video, self.out, '--fov', 60)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn('pictures of 1920 x 1080 are larger than 1280 x 1024: shrunk to a width of 1280', done.stderr)
        words = dict(line.split(': ', 1) for line in (self.out / 'camera.yaml').read_text().splitlines() if ': ' in line)
        self.assertEqual((words['width'], words['height']), ('1280', '720'))


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
