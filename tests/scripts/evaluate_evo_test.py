"""scripts/evaluate against evo (Grupp, github.com/MichaelGrupp/evo), which shares no line with it: ATE after a similarity,
and RPE over a second, of trajectories that are wrong in place, attitude and scale. Run by tests/link/with_peers.sh."""
import importlib.machinery
import importlib.util
import pathlib
import sys
import tempfile
import unittest

import numpy as np
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

ROOT = pathlib.Path(__file__).resolve().parents[2]
loader = importlib.machinery.SourceFileLoader('evaluate', str(ROOT / 'scripts' / 'evaluate'))
evaluate = importlib.util.module_from_spec(importlib.util.spec_from_loader('evaluate', loader))
sys.modules['evaluate'] = evaluate
loader.exec_module(evaluate)

FPS = 30


def quaternions(rotation_vectors):
    """x y z w."""
    angle = np.linalg.norm(rotation_vectors, axis=1, keepdims=True)
    return np.hstack([rotation_vectors / np.maximum(angle, 1e-12) * np.sin(angle / 2), np.cos(angle / 2)])


def product(a, b):
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack([aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
                     aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz], 1)


class AgainstEvo(unittest.TestCase):
    def compare(self, seed, scale, metres, degrees):
        rng = np.random.default_rng(seed)
        n = 600
        t = 100 + np.arange(n) / FPS
        p_truth = np.stack([3 * np.cos(0.4 * t), 2 * np.sin(0.5 * t), 0.3 * np.sin(1.1 * t)], 1)
        q_truth = quaternions(np.stack([0.3 * np.sin(0.7 * t), 0.2 * np.cos(0.3 * t), 0.4 * t % 2 - 1], 1))
        # Seen in another frame, in other units, with errors of its own.
        turn = quaternions(rng.normal(0, 1, (1, 3)))
        R = evaluate.rotation(turn)[0]
        p = (p_truth + rng.normal(0, metres, p_truth.shape)) @ R.T / scale + rng.normal(0, 5, 3)
        wrong = quaternions(np.radians(rng.normal(0, degrees, (n, 3))))
        q = product(np.repeat(turn, n, axis=0), product(q_truth, wrong))
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            np.savetxt(folder / 'truth.txt', np.column_stack([t, p_truth, q_truth]), fmt='%.12f')
            np.savetxt(folder / 'trajectory.tum', np.column_stack([t, p, q, np.ones(n)]), fmt='%.12f')
            (folder / 'frames.csv').write_text('t,tracked\n' + ''.join(f'{ti:.9f},1\n' for ti in t))
            ours, _ = evaluate.evaluate(folder / 'truth.txt', folder)

        truth = PoseTrajectory3D(p_truth, np.roll(q_truth, 1, axis=1), t)
        estimate = PoseTrajectory3D(p, np.roll(q, 1, axis=1), t)
        _, _, their_scale = estimate.align(truth, correct_scale=True)
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data((truth, estimate))
        self.assertAlmostEqual(ours['scale'], their_scale, delta=1e-6 * scale)
        self.assertAlmostEqual(ours['ate_m'], ape.get_statistic(metrics.StatisticsType.rmse), delta=1e-7)
        self.assertAlmostEqual(ours['ate_max_m'], ape.get_statistic(metrics.StatisticsType.max), delta=1e-7)
        # Pairs a second apart; at the end ours takes one more, of a frame less.
        for relation, key in ((metrics.PoseRelation.translation_part, 'rpe_1s_m'),
                              (metrics.PoseRelation.rotation_angle_deg, 'rpe_1s_deg')):
            rpe = metrics.RPE(relation, delta=FPS, delta_unit=metrics.Unit.frames, all_pairs=True)
            rpe.process_data((truth, estimate))
            theirs = rpe.get_statistic(metrics.StatisticsType.rmse)
            self.assertAlmostEqual(ours[key], theirs, delta=0.01 * theirs)

    def test_small_errors(self):
        self.compare(1, 1.0, 0.005, 0.2)

    def test_large_errors_in_other_units(self):
        self.compare(2, 7.3, 0.2, 5.0)

    def test_of_nearly_nothing(self):
        self.compare(3, 0.01, 1e-4, 0.01)


if __name__ == '__main__':
    unittest.main()
