#!/usr/bin/python3
"""benchmarks/scale_bound on flights whose scale is plain: straight on nobody can know it, with gusts it is known as well as
vision sees the way, and better where the turn that a place errs with is known."""
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
PLACE, TURN = 0.01, 1e-3   # [m, rad], what a picture errs by


def fly(folder, gust, times=1.0, common=0.0):
    """Twelve seconds: ahead at 3 m/s with gusts of that acceleration; places err by PLACE times `times` and by `common` metres
    a radian of the turn that errs beside it."""
    folder.mkdir()
    t = np.arange(0, 12, 0.002)
    w = 2 * np.pi * 0.5
    p = np.stack([3 * t, gust / w ** 2 * np.sin(w * t), gust / w ** 2 * np.cos(0.7 * w * t)], 1)
    level = np.tile([0, 0, 0, 1.0], (len(t), 1))
    np.savetxt(folder / 'groundtruth.txt', np.column_stack([t, p, level]), fmt='%.9f')
    random = np.random.default_rng(1)
    seen = np.arange(0, len(t), 17)
    turns = TURN * random.standard_normal((len(seen), 3))
    places = p[seen] + times * PLACE * random.standard_normal((len(seen), 3)) + common * turns[:, [1, 0, 2]]
    rows = ['t,tracked,tx,ty,tz,qx,qy,qz,qw']
    for i, k in enumerate(seen):
        rows.append(','.join(f'{x:.9f}' for x in (t[k], 1, *places[i], *(turns[i] / 2), 1.0)).replace(',1.000000000', ',1', 1))
    (folder / 'pose.csv').write_text('\n'.join(rows) + '\n')
    done = subprocess.run([sys.executable, str(ROOT / 'benchmarks/scale_bound'), str(folder), str(folder)],
                          capture_output=True, text=True, check=True)
    as_it_is, turn_known = (float(x) for x in re.findall(r'median ([\d.]+) %', done.stdout))
    return as_it_is, turn_known, done.stdout


class ScaleBound(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def test_straight_on_nobody_knows_it_and_gusts_show_it(self):
        straight, _, _ = fly(self.folder / 'straight', 0.01)
        gusts, _, _ = fly(self.folder / 'gusts', 2.0)
        self.assertGreater(straight, 50)
        self.assertLess(gusts, 3)

    def test_is_as_wide_as_what_vision_errs_by(self):
        once, _, told = fly(self.folder / 'once', 2.0)
        thrice, _, _ = fly(self.folder / 'thrice', 2.0, times=3)
        self.assertAlmostEqual(thrice / once, 3, delta=0.6)
        errs = [float(x) for x in re.findall(r'errs by \[ *([\d.]+) +([\d.]+) +([\d.]+)', told)[0]]
        for mm in errs:
            self.assertAlmostEqual(mm, 1e3 * PLACE, delta=1.5)

    def test_who_knows_the_turn_knows_more(self):
        as_it_is, turn_known, _ = fly(self.folder / 'together', 2.0, times=0.2, common=20)
        self.assertGreater(as_it_is, 3 * turn_known)


if __name__ == '__main__':
    unittest.main()
