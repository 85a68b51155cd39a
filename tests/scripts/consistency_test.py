"""scripts/evaluate --consistency against made-up flights whose covariance is known: what it must find true and what not."""
import importlib.machinery
import importlib.util
import json
import pathlib
import subprocess
import tempfile
import unittest

import numpy as np
from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('evaluate', str(ROOT / 'scripts' / 'evaluate'))
evaluate = importlib.util.module_from_spec(importlib.util.spec_from_loader('evaluate', loader))
loader.exec_module(evaluate)
TruthNoise = evaluate.pose_consistency.TruthNoise

FRAMES = 1500
RATE = 20.0
AGE_FRAMES = 16  # 0.8 s
SCALE = 0.37     # map units a metre
# Of the left twist of T_cam_ref, metres and rad: very different along the camera's axes, with correlations.
SIGMA = np.array([2e-3, 4e-4, 1e-3, 3e-4, 2e-3, 6e-4])


def hat(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def exp_so3(w):
    angle = np.linalg.norm(w)
    W = hat(w)
    if angle < 1e-9:
        return np.eye(3) + W
    return np.eye(3) + np.sin(angle) / angle * W + (1 - np.cos(angle)) / angle ** 2 * W @ W


def exp_se3(x):
    w = x[3:]
    angle = max(np.linalg.norm(w), 1e-9)
    W = hat(w)
    V = np.eye(3) + (1 - np.cos(angle)) / angle ** 2 * W + (angle - np.sin(angle)) / angle ** 3 * W @ W
    return exp_so3(w), V @ x[:3]


def compose(A, B):
    return A[0] @ B[0], A[0] @ B[1] + A[1]


def inverse(A):
    return A[0].T, -A[0].T @ A[1]


def covariance():
    rng = np.random.default_rng(5)
    Q, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    mixed = np.diag(SIGMA) @ (np.eye(6) + 0.3 * (Q + Q.T)) @ np.diag(SIGMA)
    return mixed @ np.diag(SIGMA ** -2) @ mixed  # positive definite, sigmas about SIGMA


def adjoint(T):
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = T[0]
    ad[:3, 3:] = hat(T[1]) @ T[0]
    return ad


def pose(t):
    """Camera to world: a bent path, the camera looks well away from where it flies and turns."""
    p = np.array([1.5 * t, 3 * np.sin(0.4 * t), 2 * np.cos(0.3 * t)])
    return exp_so3(np.array([0.9 + 0.3 * np.sin(0.5 * t), 0.8 * np.cos(0.7 * t), 1.2 * np.sin(0.2 * t)])), p


class Consistency(unittest.TestCase):
    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        self.rng = np.random.default_rng(1)
        self.C = covariance()

    def tearDown(self):
        self.temp.cleanup()

    def write_truth(self, noise=TruthNoise()):
        lines = []
        for i in range(FRAMES):
            p = pose(i / RATE - noise.lag_s)[1] + noise.position_m * self.rng.normal(size=3)
            q = evaluate.quaternion(pose(i / RATE - noise.turn_lag_s)[0] @ exp_so3(noise.rotation_rad * self.rng.normal(size=3)))
            lines.append(' '.join(f'{v:.9f}' for v in (i / RATE, *p, *q)) + '\n')
        (self.folder / 'truth.txt').write_text(''.join(lines))

    def write_run(self, disturb=None, stated=None, age=AGE_FRAMES, depth=2.0):
        """disturb(T_cam_ref, x): the estimate; by default T_true = exp(x) T_est, as it should be."""
        disturb = disturb or (lambda T, x: compose(exp_se3(-x), T))
        L = np.linalg.cholesky(self.C)
        D = np.diag([SCALE] * 3 + [1] * 3)
        names = ['t', 'tracked', 'map_id', 'ref_id', 'ref_t', 'rtx', 'rty', 'rtz', 'rqx', 'rqy', 'rqz', 'rqw']
        names += [f'r{i}{j}' for i in range(6) for j in range(i, 6)] + ['median_depth']
        lines = [','.join(names) + '\n']
        for i in range(age, FRAMES):
            T = compose(inverse(pose(i / RATE)), pose((i - age) / RATE))
            R, t = inverse(disturb(T, L @ self.rng.normal(size=6)))
            C = D @ (self.C if stated is None else stated(T, self.C)) @ D
            values = [i / RATE, 1, 1, 1, (i - age) / RATE, *(SCALE * t), *evaluate.quaternion(R),
                      *C[np.triu_indices(6)], SCALE * depth]
            lines.append(','.join(repr(float(v)) if k not in (1, 2, 3) else str(v)
                                  for k, v in enumerate(values)) + '\n')
        (self.folder / 'pose.csv').write_text(''.join(lines))

    def judge(self, noise=TruthNoise()):
        return evaluate.consistency(self.folder / 'truth.txt', self.folder, None, noise, None)

    def assert_true(self, result):
        for name in ('', 'rotation_', 'direction_'):
            self.assertAlmostEqual(result[name + 'nees_per_dof'], 1.0, delta=0.12, msg=name)
            self.assertAlmostEqual(result[name + 'coverage_95'], 0.95, delta=0.02, msg=name)

    def test_a_true_covariance_is_found_true_whatever_the_maps_unit(self):
        self.write_truth()
        self.write_run()
        result = self.judge()
        self.assert_true(result)
        self.assertEqual(result['judged_frames'], FRAMES - AGE_FRAMES)
        self.assertEqual(result['judged_share'], 1.0)
        self.assertEqual(result['direction_judged_share'], 1.0)

    def test_a_sigma_half_as_large_is_found_out(self):
        self.write_truth()
        self.write_run(stated=lambda T, C: C / 4)
        result = self.judge()
        self.assertAlmostEqual(result['nees_per_dof'], 4.0, delta=0.5)
        self.assertLess(result['coverage_95'], 0.5)

    def test_a_covariance_along_the_keyframes_axes_is_found_wrong(self):
        self.write_truth()
        self.write_run(stated=lambda T, C: adjoint(inverse(T)) @ C @ adjoint(inverse(T)).T)
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)
        self.write_run(disturb=lambda T, x: compose(T, exp_se3(-x)))
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)

    def test_a_covariance_without_the_adjoints_lever_is_found_wrong(self):
        def no_lever(T, C):
            turned = adjoint((T[0].T, np.zeros(3)))
            return turned @ C @ turned.T
        self.write_truth()
        self.write_run(disturb=lambda T, x: compose(T, exp_se3(-x)))
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)
        # The same errors, stated with the whole adjoint, are true.
        self.write_run(disturb=lambda T, x: compose(T, exp_se3(-x)), stated=lambda T, C: adjoint(T) @ C @ adjoint(T).T)
        self.assert_true(self.judge())
        # 30 m away from the keyframe the lever is what matters.
        self.write_run(disturb=lambda T, x: compose(T, exp_se3(-x)), stated=no_lever, age=400)
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)

    def test_the_order_of_the_twist_matters(self):
        self.write_truth()
        swap = [3, 4, 5, 0, 1, 2]
        self.write_run(stated=lambda T, C: C[np.ix_(swap, swap)])
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)

    def test_an_error_of_scale_is_no_error(self):
        self.write_truth()
        self.write_run(disturb=lambda T, x: (lambda E: (E[0], E[1] * self.rng.uniform(0.5, 2)))(
            compose(exp_se3(-x), T)), stated=lambda T, C: C)
        # Lengths half or twice as large make directions' sigmas as much too large or small, and no more than that.
        self.assertLess(self.judge()['direction_nees_per_dof'], 2.5)
        self.assertAlmostEqual(self.judge()['rotation_nees_per_dof'], 1.0, delta=0.12)

    def test_the_truths_own_errors_are_added(self):
        noise = TruthNoise(2e-3, 2e-3, 0.0)
        self.write_truth(noise)
        self.write_run()
        self.assertGreater(self.judge()['nees_per_dof'], 2.0)
        self.assert_true(self.judge(noise))

    def test_a_lag_of_the_truth_is_covered_by_its_sigma(self):
        self.write_truth(TruthNoise(lag_s=0.03))
        self.write_run()
        without, allowed = self.judge(), self.judge(TruthNoise(lag_s=0.03))
        self.assertGreater(without['direction_nees_per_dof'], 2.0)
        self.assertLess(allowed['direction_nees_per_dof'], 1.6)
        self.assertAlmostEqual(allowed['rotation_nees_per_dof'], 1.0, delta=0.12)

    def test_a_lag_of_the_truths_rotations_is_covered_by_its_sigma(self):
        noise = TruthNoise(turn_lag_s=0.01)
        self.write_truth(noise)
        self.write_run()
        without, allowed = self.judge(), self.judge(noise)
        self.assertGreater(without['rotation_nees_per_dof'], 2.0)
        self.assertLess(allowed['rotation_nees_per_dof'], 1.4)
        self.assertLess(allowed['direction_nees_per_dof'], 1.4)

    def test_a_young_map_is_told_apart(self):
        self.write_truth()
        self.write_run()
        result = self.judge()
        self.assertAlmostEqual(result['young_map_nees_per_dof'], 1.0, delta=0.5)
        self.assertAlmostEqual(result['old_map_nees_per_dof'], 1.0, delta=0.12)

    def test_young_references_and_short_baselines_are_not_judged(self):
        self.write_truth()
        self.write_run(age=9)  # 0.45 s
        self.assertEqual(self.judge()['judged_frames'], 0)
        self.write_run(depth=1000.0)
        result = self.judge()
        self.assertEqual(result['direction_judged_share'], 0.0)
        self.assertNotIn('direction_nees_per_dof', result)
        self.assertAlmostEqual(result['nees_per_dof'], result['rotation_nees_per_dof'])

    def test_as_a_command_with_a_truth_by_name_and_a_picture(self):
        self.write_truth()
        self.write_run()
        for name in ('frames.csv', 'trajectory.tum'):
            (self.folder / name).write_text('t,tracked\n0.0,1\n' if name == 'frames.csv' else '0 0 0 0 0 0 0 1 1\n')
        picture = self.folder / 'consistency.png'
        told = subprocess.run([str(ROOT / 'scripts/evaluate'), str(self.folder / 'truth.txt'), str(self.folder), '--consistency',
                               '--truth', 'tum', '--plot', str(picture), '--json'], capture_output=True, text=True, check=True)
        told = json.loads(told.stdout)
        self.assertEqual(told['judged_frames'], FRAMES - AGE_FRAMES)
        self.assertLess(told['nees_per_dof'], 0.5)  # with the truth's own errors added to a covariance that was true
        with Image.open(picture) as opened:
            opened.load()
            self.assertGreater(opened.width, 300)

    def test_a_run_that_names_no_references_is_refused(self):
        self.write_truth()
        (self.folder / 'pose.csv').write_text('t,tracked\n0.1,1\n')
        with self.assertRaises(ValueError):
            self.judge()


if __name__ == '__main__':
    unittest.main()
