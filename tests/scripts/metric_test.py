"""scripts/evaluate --metric against made-up flights whose errors are known, and benchmarks/metric with a stand-in for the
program."""
import importlib.machinery
import importlib.util
import pathlib
import subprocess
import sys
import tempfile
import unittest

import numpy as np

sys.dont_write_bytecode = True
import stand_in  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('evaluate', str(ROOT / 'scripts' / 'evaluate'))
evaluate = importlib.util.module_from_spec(importlib.util.spec_from_loader('evaluate', loader))
loader.exec_module(evaluate)

RATE, FRAMES, FIRST = 20.0, 400, 25  # frames a second
PLACE_SIGMA, TURN_SIGMA = np.array([4e-3, 1e-3, 2e-3]), np.array([1e-3, 3e-3, 2e-3])  # along the camera's axes
NAMES = (['t', 'tracked', 'map_id', 'tx', 'ty', 'tz', 'qx', 'qy', 'qz', 'qw'] +
         [f'c{i}{j}' for i in range(6) for j in range(i, 6)] + ['vx', 'vy', 'vz', 'scale_sigma'] +
         [f'{n}_{a}' for n in ('gyro_bias', 'accel_bias', 'mounting') for a in 'xyz'] + ['time_offset'])


def exp_so3(w):
    angle = max(np.linalg.norm(w), 1e-12)
    W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / angle
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def pose(t, rest_after=1e9):
    s = min(t, rest_after)
    p = np.array([1.5 * np.cos(s), np.sin(1.3 * s), 0.5 * np.sin(2.1 * s)])
    return exp_so3(np.array([0.9 + 0.3 * np.sin(0.5 * s), 0.8 * np.cos(0.7 * s), 1.2 * np.sin(0.2 * s)])), p


def speed(t, rest_after=1e9):
    return (pose(t + 1e-4, rest_after)[1] - pose(t - 1e-4, rest_after)[1]) / 2e-4


class Metric(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        self.rng = np.random.default_rng(3)
        self.gauge = exp_so3(np.array([0, 0, 2.2])), np.array([5.0, -3, 1])

    def tearDown(self):
        self.temp.cleanup()

    def write_truth(self, lag=0.0, rest_after=1e9):
        lines = []
        for i in range(int(FRAMES / RATE * 100) + 20):
            t = i / 100
            p = pose(t - lag, rest_after)[1]
            lines.append(' '.join(f'{v:.9f}' for v in (t, *p, *evaluate.quaternion(pose(t, rest_after)[0]))) + '\n')
        (self.folder / 'truth.txt').write_text(''.join(lines))

    def write_run(self, scale=1.0, tilt=np.zeros(3), stated=1.0, noise=1.0, rest_after=1e9, velocity_error=0.0):
        G, shift = self.gauge
        lines, frames = [','.join(NAMES) + '\n'], ['t,tracked\n']
        sigma = np.concatenate([PLACE_SIGMA, TURN_SIGMA])
        for i in range(FRAMES):
            t = i / RATE
            frames.append(f'{t:.9f},{int(i >= FIRST)}\n')
            if i < FIRST:
                # A pose in map units: a run tells these before it is metric.
                lines.append(f'{t:.9f},0,1' + ',0' * 31 + ',' * (len(NAMES) - 34) + '\n')
                continue
            R, p = pose(t, rest_after)
            x = noise * sigma * self.rng.normal(size=6) * (i > FIRST)  # the gauge is fixed by a pose without error
            R_est = exp_so3(tilt) @ G @ R @ exp_so3(x[3:])
            p_est = scale * exp_so3(tilt) @ G @ (p + R @ x[:3]) + shift
            v = exp_so3(tilt) @ G @ speed(t, rest_after) + velocity_error * np.array([0, 0.6, 0.8])
            values = [1, 1, *p_est, *evaluate.quaternion(R_est), *np.diag(stated * sigma ** 2)[np.triu_indices(6)],
                      *v, 0.01, *map(float, range(9)), 0.004]
            lines.append(f'{t:.9f},' + ','.join(repr(a if isinstance(a, int) else float(a)) for a in values) + '\n')
        (self.folder / 'pose.csv').write_text(''.join(lines))
        (self.folder / 'frames.csv').write_text(''.join(frames))

    def judge(self, lag=0.0):
        return evaluate.metric(self.folder / 'truth.txt', self.folder, None, lag, None)

    def test_a_true_covariance_is_found_true_in_whatever_heading_it_began(self):
        self.write_truth()
        self.write_run(stated=1.0)
        r = self.judge()
        for part in ('position', 'attitude'):
            self.assertAlmostEqual(r[f'nees_{part}'], 1.0, delta=0.15)
            self.assertAlmostEqual(r[f'coverage_95_{part}'], 0.95, delta=0.04)
        self.assertLess(r['beyond_3_sigma_share'], 0.01)
        self.assertAlmostEqual(r['metric_after_s'], FIRST / RATE)
        self.assertEqual(r['metric_poses'], FRAMES - FIRST)
        self.assertAlmostEqual(r['ate_m'], np.sqrt((PLACE_SIGMA ** 2).sum()), delta=5e-4)
        self.assertAlmostEqual(r['time_offset_s'], 0.004)
        self.assertEqual(r['accel_bias'], [3.0, 4.0, 5.0])
        self.assertEqual(r['tracked_share_after_metric'], 1.0)

    def test_what_is_printed_is_for_people(self):
        self.write_truth()
        self.write_run()
        done = subprocess.run([sys.executable, str(ROOT / 'scripts/evaluate'), str(self.folder / 'truth.txt'), str(self.folder), '--metric'],
                              capture_output=True, text=True, check=True)
        self.assertIn(f'{"accel_bias":36s} 3.0000 4.0000 5.0000\n', done.stdout)
        self.assertNotIn('[', done.stdout)

    def test_a_sigma_half_as_large_is_found_out(self):
        self.write_truth()
        self.write_run(stated=0.25)
        r = self.judge()
        self.assertAlmostEqual(r['nees_position'], 4.0, delta=0.6)
        # The sums over tens of seconds are those of the whole: whoever pools flights adds them up.
        numbers, poses, place, place_in = np.array([w[:4] for w in r['windows']]).T
        self.assertEqual(list(numbers), [0, 1])
        self.assertAlmostEqual(place.sum() / poses.sum(), r['nees_position'])
        self.assertAlmostEqual(place_in.sum() / poses.sum(), r['coverage_95_position'])
        self.assertAlmostEqual(r['nees_attitude'], 4.0, delta=0.6)
        self.assertGreater(r['beyond_3_sigma_share'], 0.02)

    def test_scale_is_an_error_and_has_its_sign(self):
        self.write_truth()
        self.write_run(scale=1.03, noise=0)
        r = self.judge()
        self.assertAlmostEqual(r['scale_error'], 0.03, delta=1e-3)
        self.assertAlmostEqual(r['scale_error_begin'], 0.03, delta=1e-3)
        self.assertGreater(r['ate_m'], 0.02)

    def test_a_tilt_is_an_error_and_the_heading_none(self):
        self.write_truth()
        self.write_run(tilt=np.array([0.01, 0, 0]), noise=0)
        r = self.judge()
        self.assertAlmostEqual(r['gravity_deg'], np.degrees(0.01), delta=1e-3)
        self.assertLess(r['ate_m'], 1e-4, 'ATE is blind to it')
        self.assertGreater(r['nees_attitude'], 2)
        self.assertGreater(r['nees_position'], 2)

    def test_velocities_are_judged_along_the_same_axes(self):
        self.write_truth()
        self.write_run(noise=0)
        self.assertLess(self.judge()['velocity_rms_m_s'], 2e-3)
        self.write_run(noise=0, velocity_error=0.07)
        self.assertAlmostEqual(self.judge()['velocity_rms_m_s'], 0.07, delta=2e-3)

    def test_the_lag_of_the_truths_positions_is_taken_out(self):
        self.write_truth(lag=0.03)
        self.write_run(noise=0)
        self.assertGreater(self.judge()['ate_m'], 0.01)
        self.assertLess(self.judge(lag=0.03)['ate_m'], 1e-3)

    def test_rest_and_motion_are_told_apart(self):
        self.write_truth(rest_after=10.0)
        self.write_run(rest_after=10.0)
        r = self.judge()
        self.assertAlmostEqual(r['still_m'], np.sqrt((PLACE_SIGMA ** 2).sum()), delta=1e-3)
        self.assertAlmostEqual(r['still_deg'], np.degrees(np.sqrt((TURN_SIGMA ** 2).sum())), delta=0.05)
        # By itself, the truth here stands and what is told has its noise.
        self.assertAlmostEqual(r['stands_told_deg'], r['still_deg'], delta=0.1)
        self.assertLess(r['stands_truth_deg'], 1e-3)
        self.assertLess(r['stands_truth_m'], 1e-4)
        self.write_truth()
        self.write_run()
        self.assertNotIn('still_m', self.judge())
        self.assertNotIn('stands_told_m', self.judge())

    def test_a_run_without_metric_poses_says_so(self):
        self.write_truth()
        self.write_run()
        lines = (self.folder / 'pose.csv').read_text().splitlines()
        (self.folder / 'pose.csv').write_text('\n'.join(lines[:FIRST + 1]) + '\n')
        self.assertEqual(self.judge()['metric_poses'], 0)
        (self.folder / 'pose.csv').write_text('t,tracked\n0.1,1\n')
        with self.assertRaises(ValueError):
            self.judge()


# Hands out the run that the test wrote, and remembers what it was asked for.
FLYER = '''#!/usr/bin/python3
import pathlib, shutil, sys
a = sys.argv
here, out = pathlib.Path(__file__).parent, pathlib.Path(a[a.index('--out') + 1])
sequence = here / 'sequence' if a[1] == 'fly' else pathlib.Path(a[2])
with open(here / 'flown', 'a') as log:
    rows = [line for line in (sequence / 'imu.txt').read_text().splitlines() if line[0] != '#']
    log.write(' '.join(a[3:]) + ' ' + rows[0] + chr(10))
out.mkdir(parents=True)
for name in ('pose.csv', 'frames.csv'):
    shutil.copy(here / name, out / name)
(out / 'summary.json').write_text('{}')
if a[1] == 'fly':
    (here / 'scenarios').open('a').write(' '.join(a[2:]) + chr(10))
    shutil.copy(sequence / 'groundtruth.txt', out / 'groundtruth.txt')
'''


class Benchmark(stand_in.StandInTest):
    FLYER = FLYER

    def setUp(self):
        super().setUp()
        maker = Metric()
        maker.setUp()
        maker.write_truth(lag=0.008)  # euroc's
        maker.write_run()
        sequence = self.folder / 'sequence'
        sequence.mkdir()
        (maker.folder / 'truth.txt').rename(sequence / 'groundtruth.txt')
        for name in ('pose.csv', 'frames.csv'):
            (maker.folder / name).rename(self.folder / name)
        maker.tearDown()
        (sequence / 'rgb').mkdir()
        (sequence / 'rgb.txt').write_text('')
        (sequence / 'imu.txt').write_text('# t\n1.000000000 0.1 0.2 0.3 0 0 9.8\n1.005000000 0.1 0.2 0.3 0 0 9.8\n')
        (sequence / 'camera.yaml').write_text('T_body_cam: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n')

    def run_it(self, *what):
        done = subprocess.run([sys.executable, str(ROOT / 'benchmarks' / 'metric'), *what, '--tool', str(self.flyer),
                               '--sequence', str(self.folder / 'sequence'), '--out', str(self.folder / 'out')],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def flown(self):
        return (self.folder / 'flown').read_text().splitlines()

    def test_flies_thirteen_starts_once(self):
        said = self.run_it('starts')
        self.assertEqual(len(self.flown()), 13)
        self.assertIn('worst of 13 (0 never metric): 1.25 s', said)
        self.run_it('starts')
        self.assertEqual(len(self.flown()), 13, 'they are there already')

    def test_shifts_move_the_sensors_times_and_biases_its_readings(self):
        said = self.run_it('shifts')
        times = {line.split()[-7] for line in self.flown()}
        self.assertEqual(times, {'1.000000000', '0.980000000', '0.995000000', '1.005000000', '1.020000000'})
        self.assertIn('| -20 ms | +0.00, +0.00, +0.00 ms |', said)
        self.run_it('biases')
        readings = {line.split()[-6] for line in self.flown()}
        self.assertEqual(len(readings), 6, 'five draws and the sensor itself')

    def test_the_mounting_is_turned_by_two_degrees(self):
        self.run_it('mounting')
        text = (self.folder / 'out' / 'sequence-mounting2' / 'camera.yaml').read_text()
        T = np.array([float(x) for x in text.split('[')[1].split(']')[0].split(',')]).reshape(4, 4)
        self.assertAlmostEqual(np.degrees(np.arccos((np.trace(T[:3, :3]) - 1) / 2)), 2.0, places=6)

    def test_the_simulators_seeds_are_flown_and_judged_together(self):
        said = self.run_it('simulator', '--scenarios', 'street,night', '--seeds', '2', '--first-seed', '7', '--frames', '900', '--imu-faults')
        flown = [line.partition(' --sequential')[0] for line in (self.folder / 'scenarios').read_text().splitlines()]
        self.assertEqual(flown, [f'{s} --seed {n} --frames 900 --imu-faults' for s in ('street', 'night') for n in (7, 8)])
        self.assertIn('| night, 8 ', said)
        self.assertIn('street: worst of 2 (0 never metric)', said)
        self.assertRegex(said, r'all poses: mean NEES [\d.]+; [\d.]+, inside 95 %')

    def test_a_flight_that_fails_says_why(self):
        self.flyer.write_text('#!/bin/sh\necho "godwit: no such scenario" >&2\nexit 2\n')
        done = subprocess.run([sys.executable, str(ROOT / 'benchmarks' / 'metric'), 'simulator', '--tool', str(self.flyer), '--scenarios',
                               'street', '--out', str(self.folder / 'out')], capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertRegex(done.stderr, r'fly street --seed 1 .*: godwit: no such scenario$')
        self.assertNotIn('Traceback', done.stderr)


if __name__ == '__main__':
    unittest.main()
