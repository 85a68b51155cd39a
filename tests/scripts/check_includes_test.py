"""scripts/check_includes finds what breaks the rules, and only that."""
import importlib.machinery
import importlib.util
import pathlib
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]


def load(path):
    loader = importlib.machinery.SourceFileLoader('check_includes', str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader('check_includes', loader))
    loader.exec_module(module)
    return module


check = load(ROOT / 'scripts' / 'check_includes')

ALLOWED = [
    ('firmware_app/a.cpp', '"', 'vo_core/tracking/tracker.h'),
    ('firmware_app/a.cpp', '<', 'opencv2/core.hpp'),
    ('hal/camera/a.cpp', '"', 'hal/rt/time.h'),
    ('hal/camera/a.cpp', '"', 'hal/camera/camera.h'),
    ('vo_core/a.cpp', '"', 'hal/rt/image.h'),
    ('vo_core/a.cpp', '<', 'Eigen/Core'),
    ('vo_core/a.cpp', '<', 'hwy/highway.h'),
    ('vo_core/image/patch.h', '<', 'hwy/highway.h'),
    ('vo_core/a.cpp', '<', 'cmath'),
    ('hal/rt/a.cpp', '<', 'pthread.h'),
    ('hal/rt/alloc_hook.cpp', '"', 'hal/rt/alloc_hook.h'),
    ('tests/rt/a.cpp', '"', 'hal/rt/alloc_hook.h'),
    ('detector/a.cpp', '<', 'opencv2/dnn.hpp'),
    ('firmware_app/godwit_main.cpp', '"', 'firmware_app/commands/a.h'),
    ('firmware_app/flight/a.cpp', '"', 'firmware_app/config/config.h'),
    ('firmware_app/flight/a.cpp', '"', 'firmware_app/flight/b.h'),
    ('tests/app/a.cpp', '"', 'firmware_app/sim/a.h'),
    ('hal/camera/v4l2/a.cpp', '"', 'hal/camera/device/a.h'),
    ('hal/camera/libcamera/a.cpp', '"', 'hal/camera/camera.h'),
    ('hal/camera/device/a.cpp', '"', 'hal/camera/pixels/a.h'),
    ('firmware_app/flight/a.cpp', '"', 'hal/camera/v4l2/a.h'),
    ('vo_core/tracking/a.cpp', '"', 'vo_core/map/a.h'),
    ('vo_core/inertial/a.cpp', '"', 'vo_core/inertial/b.h'),
    ('hal/sim/flight/a.cpp', '"', 'hal/sim/world/a.h'),
]
FORBIDDEN = [
    ('vo_core/a.cpp', '"', 'hal/camera/camera.h'),
    ('vo_core/a.cpp', '"', 'detector/mask.h'),
    ('vo_core/a.cpp', '"', 'firmware_app/config/config.h'),
    ('vo_core/a.cpp', '<', 'opencv2/core.hpp'),
    ('vo_core/a.cpp', '<', 'thread'),
    ('vo_core/a.cpp', '<', 'chrono'),
    ('vo_core/a.cpp', '<', 'fstream'),
    ('vo_core/a.cpp', '<', 'time.h'),
    ('vo_core/a.cpp', '<', 'sys/mman.h'),
    ('vo_core/a.cpp', '<', 'fmt/format.h'),
    ('detector/a.cpp', '"', 'vo_core/tracking/tracker.h'),
    ('detector/a.cpp', '"', 'hal/camera/camera.h'),
    ('hal/camera/a.cpp', '"', 'vo_core/geometry/camera_model.h'),
    ('hal/rt/a.cpp', '"', 'hal/camera/camera.h'),
    ('hal/rt/a.cpp', '<', 'Eigen/Core'),
    ('hal/can/a.cpp', '"', 'firmware_app/config/config.h'),
    ('firmware_app/a.cpp', '"', 'hal/rt/alloc_hook.h'),
    ('firmware_app/a.cpp', '"', 'tests/support/temp_folder.h'),
    ('firmware_app/pipeline/a.cpp', '"', '../config.h'),
    ('firmware_app/pipeline/a.cpp', '"', 'pipeline.h'),
    ('firmware_app/config/a.cpp', '"', 'firmware_app/flight/a.h'),
    ('firmware_app/pipeline/a.cpp', '"', 'firmware_app/daemon/a.h'),
    ('firmware_app/pipeline/a.cpp', '"', 'firmware_app/godwit_main.h'),
    ('firmware_app/daemon/a.cpp', '"', 'firmware_app/cellar/a.h'),
    ('firmware_app/cellar/a.cpp', '"', 'firmware_app/config/config.h'),
    ('hal/camera/libcamera/a.cpp', '"', 'hal/camera/v4l2/a.h'),
    ('hal/camera/device/a.cpp', '"', 'hal/camera/v4l2/a.h'),
    ('hal/camera/pixels/a.cpp', '"', 'hal/camera/device/a.h'),
    ('hal/camera/a.cpp', '"', 'hal/camera/device/a.h'),
    ('hal/camera/cellar/a.cpp', '"', 'hal/camera/device/a.h'),
    ('vo_core/map/a.cpp', '"', 'vo_core/tracking/a.h'),
    ('vo_core/inertial/a.cpp', '"', 'vo_core/tracking/a.h'),
    ('vo_core/a.cpp', '"', 'vo_core/map/a.h'),
    ('hal/sim/world/a.cpp', '"', 'hal/sim/flight/a.h'),
    ('vo_core/map/a.h', '<', 'hwy/cache_control.h'),
    ('hal/sim/render/a.h', '<', 'hwy/highway.h'),
]


class CheckIncludes(unittest.TestCase):
    def test_allowed(self):
        for case in ALLOWED:
            self.assertIsNone(check.check_include(*case), case)

    def test_forbidden(self):
        for case in FORBIDDEN:
            self.assertIsNotNone(check.check_include(*case), case)

    def test_tree_names_file_and_line(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            (root / 'vo_core').mkdir()
            (root / 'vo_core' / 'bad.cpp').write_text('// a comment\n#include <cmath>\n  #  include <thread>\n')
            (root / 'vo_core' / 'notes.txt').write_text('#include <thread>\n')
            self.assertEqual([(f, n) for f, n, _ in check.check_tree(root)], [('vo_core/bad.cpp', 3)])

    def test_folders_that_include_each_other_are_named_with_the_files(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)

            def write(file, includes):
                (root / file).parent.mkdir(parents=True, exist_ok=True)
                (root / file).write_text(f'#include "{includes}"\n')
            write('hal/a/one.h', 'hal/rt/time.h')
            write('hal/b/two.h', 'hal/a/one.h')
            self.assertEqual(list(check.check_circles(root)), [])
            write('hal/a/other.cpp', 'hal/a/deep/three.h')
            write('hal/a/deep/three.h', 'hal/b/two.h')
            (folder, reason), = check.check_circles(root)
            self.assertEqual(folder, 'hal/a')
            self.assertIn('hal/a -> hal/a/deep -> hal/b -> hal/a', reason)
            self.assertIn('hal/a/deep/three.h', reason)

    def test_a_file_that_is_too_long_is_named_unless_listed(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            for name, lines in (('long.cpp', 5), ('listed.h', 5), ('just.py', 4), ('program', 5), ('build/made.cpp', 9), ('data.csv', 9)):
                (root / name).parent.mkdir(exist_ok=True)
                (root / name).write_text('#!/bin/sh\n' * lines)
            said = dict(check.check_lengths(root, 4, {'listed.h': 'a reason', 'just.py': 'no longer', 'gone.h': 'was split'}))
            self.assertEqual(sorted(said), ['gone.h', 'just.py', 'long.cpp', 'program'])

    def test_each_long_file_has_a_reason(self):
        for file, reason in check.LONG.items():
            self.assertGreater(len(reason.split()), 3, file)

    def test_this_tree_keeps_the_rules(self):
        self.assertEqual(list(check.check_lengths(ROOT)), [])
        self.assertEqual(list(check.check_circles(ROOT)), [])
        self.assertEqual(list(check.check_tree(ROOT)), [])


if __name__ == '__main__':
    unittest.main()
