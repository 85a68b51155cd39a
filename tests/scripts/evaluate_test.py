"""scripts/evaluate against trajectories whose error is known."""
import importlib.machinery
import importlib.util
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import unittest

import numpy as np
from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('evaluate', str(ROOT / 'scripts' / 'evaluate'))
evaluate = importlib.util.module_from_spec(importlib.util.spec_from_loader('evaluate', loader))
loader.exec_module(evaluate)


def curve(n):
    t = np.linspace(0, 10, n)
    return t, np.stack([np.cos(t), np.sin(1.3 * t), 0.3 * np.sin(2.1 * t)], 1)


def write_run(folder, t, p, map_ids, untracked_before=0):
    with open(folder / 'trajectory.tum', 'w') as out:
        for ti, pi, m in zip(t, p, map_ids):
            out.write(f'{ti:.9f} {pi[0]} {pi[1]} {pi[2]} 0 0 0 1 {m}\n')
    with open(folder / 'frames.csv', 'w') as out:
        out.write('t,tracked\n')
        out.writelines(f'{-1 + 0.01 * i:.9f},0\n' for i in range(untracked_before))
        out.writelines(f'{ti:.9f},1\n' for ti in t)


class Evaluate(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        t, p = curve(1001)
        np.savetxt(self.folder / 'truth.txt', np.column_stack([t, p, np.tile([0, 0, 0, 1], (len(t), 1))]), fmt='%.9f')

    def tearDown(self):
        self.temp.cleanup()

    def test_similarity_is_taken_out(self):
        t, p = curve(301)
        angle = 0.7
        R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        write_run(self.folder, t, 0.25 * p @ R.T + [5, -3, 2], [1] * len(t), untracked_before=4)
        result, _ = evaluate.evaluate(self.folder / 'truth.txt', self.folder)
        self.assertLess(result['ate_m'], 1e-4)
        self.assertAlmostEqual(result['scale'], 4.0, places=3)
        self.assertEqual(result['first_pose_after_frames'], 4)
        self.assertEqual(result['tracked_share_after_first_pose'], 1.0)
        self.assertAlmostEqual(result['tracked_share'], 301 / 305)

    def test_a_picture_of_it(self):
        t, p = curve(301)
        write_run(self.folder, t, p, [1] * len(t))
        picture = self.folder / 'trajectory.png'
        subprocess.run([str(ROOT / 'scripts/evaluate'), str(self.folder / 'truth.txt'), str(self.folder), '--plot', str(picture)],
                       check=True, stdout=subprocess.DEVNULL)
        with Image.open(picture) as opened:
            opened.load()
            self.assertGreater(opened.width, 300)

    def test_a_reader_that_leaves_early_is_no_trace(self):
        t, p = curve(301)
        write_run(self.folder, t, p, [1] * len(t))
        # Nobody reads: the very first line finds the pipe closed.
        reader, writer = os.pipe()
        os.close(reader)
        with os.fdopen(writer, 'w') as out:
            done = subprocess.run([sys.executable, str(ROOT / 'scripts/evaluate'), str(self.folder / 'truth.txt'), str(self.folder)],
                                  stdout=out, stderr=subprocess.PIPE, text=True, check=False)
        self.assertEqual(done.stderr, '')
        self.assertEqual(done.returncode, -signal.SIGPIPE)

    def test_known_error_is_found(self):
        t, p = curve(301)
        noise = np.random.default_rng(1).normal(0, 0.02, p.shape)
        write_run(self.folder, t, p + noise, [1] * len(t))
        result, _ = evaluate.evaluate(self.folder / 'truth.txt', self.folder)
        self.assertAlmostEqual(result['ate_m'], np.sqrt((noise ** 2).sum(1).mean()), delta=0.001)

    def test_relative_error_of_a_drift_is_the_drift_of_a_second(self):
        # Along x at 0.5 m/s; the estimate turns away from it by 0.02 rad/s about z.
        t = np.linspace(0, 10, 301)
        p = np.stack([0.5 * t, 0 * t, 0 * t], 1)
        angle = 0.02 * t
        q = np.stack([0 * t, 0 * t, np.sin(angle / 2), np.cos(angle / 2)], 1)
        metres, degrees = evaluate.relative_error(t, p, evaluate.rotation(q), p,
                                                  evaluate.rotation(np.tile([0, 0, 0, 1.0], (len(t), 1))))
        self.assertAlmostEqual(degrees, np.degrees(0.02), delta=0.01)
        # In the turned frame half a metre lies off by half a metre times the angle, 0 to 0.18 rad.
        self.assertAlmostEqual(metres, 0.5 * np.sqrt((angle[:271] ** 2).mean()), delta=0.002)
        self.assertIsNone(evaluate.relative_error(t[:10], p[:10], np.tile(np.eye(3), (10, 1, 1)), p[:10],
                                                  np.tile(np.eye(3), (10, 1, 1))))

    def test_a_truth_of_the_body_gives_the_cameras_rotation(self):
        (self.folder / 'sensor.yaml').write_text('T_BS: {data: [0,-1,0,0, 1,0,0,0, 0,0,1,0, 0,0,0,1]}\n')
        (self.folder / 'data.csv').write_text('#t\n0,0,0,0,1,0,0,0\n1000000000,1,0,0,0,0,0,1\n')
        q = evaluate.load_truth_quaternions(self.folder / 'data.csv', self.folder / 'sensor.yaml')
        R = evaluate.rotation(q)
        quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        np.testing.assert_allclose(R[0], quarter, atol=1e-9)
        np.testing.assert_allclose(R[1], np.diag([-1, -1, 1]) @ quarter, atol=1e-9)

    def test_only_the_longest_map_counts(self):
        t, p = curve(300)
        q = p.copy()
        q[:50] += 7  # another map with its own frame
        write_run(self.folder, t, q, [1] * 50 + [2] * 250)
        result, _ = evaluate.evaluate(self.folder / 'truth.txt', self.folder)
        self.assertLess(result['ate_m'], 1e-4)
        self.assertEqual(result['maps'], 2)
        self.assertAlmostEqual(result['longest_map_share_after_first_pose'], 250 / 300)

    def test_a_mirror_image_is_not_aligned_away(self):
        t, p = curve(301)
        write_run(self.folder, t, p * [1, 1, -1], [1] * len(t))
        result, _ = evaluate.evaluate(self.folder / 'truth.txt', self.folder)
        self.assertGreater(result['ate_m'], 0.1)

    def test_what_is_no_run_and_no_truth_is_said_with_file_and_line(self):
        t, p = curve(301)
        run = self.folder / 'run'
        run.mkdir()
        truth = self.folder / 'truth.txt'

        def told(words, truth=truth):
            done = subprocess.run([str(ROOT / 'scripts/evaluate'), str(truth), str(run)], capture_output=True, text=True, check=False)
            self.assertEqual((done.returncode, done.stdout), (1, ''))
            self.assertIn(words, done.stderr)
            self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)
        told('run: holds no whole run of godwit: frames.csv is not there')
        write_run(run, t, p, [1] * len(t))
        told('gone.txt: No such file', self.folder / 'gone.txt')
        (self.folder / 'empty.txt').write_text('# nothing\n')
        told('empty.txt: 0 poses are no truth', self.folder / 'empty.txt')
        (self.folder / 'camera.yaml').write_text('# a camera\nmodel: pinhole\n')
        told('camera.yaml:2: could not convert', self.folder / 'camera.yaml')
        (run / 'trajectory.tum').write_text('1 2 3\n')
        told('trajectory.tum:1: 3 numbers, 9 are wanted')
        (run / 'trajectory.tum').write_text('0 0 0 0 0 0 0 1 1\n')
        for text, words in (('', 'not of one run'), ('x,y\n1,2\n', 'tracked is not 0 or 1')):
            (run / 'frames.csv').write_text(text)
            told(words)

    def test_no_pose_at_all(self):
        write_run(self.folder, [], [], [], untracked_before=5)
        result, curves = evaluate.evaluate(self.folder / 'truth.txt', self.folder)
        self.assertEqual(result, {'frames': 5, 'tracked_share': 0.0})
        self.assertIsNone(curves)


if __name__ == '__main__':
    unittest.main()
