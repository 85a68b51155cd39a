"""godwit-latency as a program: its JSON keeps the schema that summary.json keeps too, a comparison pairs what it should,
and what is wrong gets a word and an exit code.

  latency_program_test.py GODWIT_LATENCY GODWIT SCHEMA
"""
import json
import os
import pathlib
import resource
import signal
import subprocess
import sys
import tempfile
import unittest

import jsonschema

LATENCY, GODWIT, SCHEMA = sys.argv[1:4]
ROOT = pathlib.Path(SCHEMA).resolve().parent.parent
# Cheap to draw, and enough to be flown: few pictures, forth and back.
SHORT = ['street', '--pictures', '12', '--seconds', '2', '--fps', '30']


def run(*words, **keywords):
    return subprocess.run([str(w) for w in words], capture_output=True, text=True, cwd=ROOT, timeout=200, **keywords)


def fake_program(folder, name, tracker_ms):
    """A program that takes godwit-latency's options and writes figures of its own, a third slower at each call. Its detector
    comes to fewer detections each time, as on a machine that grows busier, and then to smaller ones."""
    program = pathlib.Path(folder) / name
    program.write_text(f'''#!/usr/bin/python3
import json, pathlib, sys
log = pathlib.Path({str(folder)!r}) / 'calls'
calls = log.read_text().split() if log.exists() else []
log.write_text(' '.join(calls + [{name!r}]))
ms = {tracker_ms} * 1.3 ** len(calls)
of = dict(median=ms, p99=2 * ms)
counted = max(len(calls) - 2, 0)  # the first pair only warms up
full, small = max(80 - 9 * counted, 0), 6 * counted
detections = dict(full=dict(samples=full, median=50 * ms), small=dict(samples=small, median=30 * ms))
percent = 100 * (full * 50 * ms + small * 30 * ms) / 1e3 / 8
out = sys.argv[sys.argv.index('--json') + 1]
json.dump(dict(kind='latency', flights=[dict(detector=True, tracker_cpu_ms=of, own_at_pose_ms=of,
                                             seconds=8, frames=dict(processed=240), detection_cpu_ms=detections,
                                             detections=dict(done=full + small),
                                             threads=[dict(name='gw-tracker', cpu_percent=3 * ms),
                                                      dict(name='gw-detector', cpu_percent=percent)])]), open(out, 'w'))
''')
    program.chmod(0o755)
    return program


class Latency(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.validator = jsonschema.Draft202012Validator(json.loads(pathlib.Path(SCHEMA).read_text()))
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.folder.name)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_figures_keep_the_schema(self):
        done = run(LATENCY, *SHORT, '--exposure-ms', 8, '--readout-ms', 15, '--transfer-ms', 5, '--json',
                   self.out / 'a.json', '--plot', self.out / 'a.png')
        # 1: no pose was found in so short a flight; everything is written all the same.
        self.assertIn(done.returncode, (0, 1), done.stderr)
        figures = json.loads((self.out / 'a.json').read_text())
        self.validator.validate(figures)
        self.assertEqual(figures['camera_delays_ms']['delivery'], 16.5)
        self.assertEqual([f['detector'] for f in figures['flights']], [True, False])
        for flight in figures['flights']:
            self.assertEqual(flight['frames']['due'], 60)
            self.assertIn('gw-tracker', [t['name'] for t in flight['threads']])
            for thread in flight['threads']:
                self.assertEqual(thread.get('heap_operations', 0), 0, thread)
            if flight['frames']['tracked']:
                self.assertGreaterEqual(flight['age_at_pose_ms']['median'], 16.5)
                self.assertGreaterEqual(flight['delivery_ms']['median'], 16.5)
            self.assertIsNone(flight['age_at_bus_ms'])
        self.assertTrue((self.out / 'a.png').read_bytes().startswith(b'\x89PNG'))
        self.assertIn('our own share', done.stdout)

    def test_a_recorded_sequence_is_flown_and_its_poses_go_on_the_bus(self):
        made = run(GODWIT, 'sim', 'street', '--frames', 45, '--out', self.out / 'recorded')
        self.assertEqual(made.returncode, 0, made.stderr)
        done = run(LATENCY, self.out / 'recorded', '--seconds', 4, '--detector', 'off', '--can', 'multicast:9:127.0.0.1',
                   '--json', self.out / 'bus.json')
        self.assertIn(done.returncode, (0, 1), done.stderr)
        figures = json.loads((self.out / 'bus.json').read_text())
        self.validator.validate(figures)
        self.assertEqual(figures['input'], str(self.out / 'recorded'))
        flight = figures['flights'][0]
        self.assertEqual(flight['frames']['due'], 120)
        self.assertIn('gw-link', [t['name'] for t in flight['threads']])
        # On a machine that others use there may be no pose.
        if flight['frames']['tracked'] > 20:
            self.assertGreater(flight['age_at_bus_ms']['samples'], 0)
            self.assertGreaterEqual(flight['age_at_bus_ms']['median'], flight['age_at_pose_ms']['median'])

    def test_summary_keeps_the_schema(self):
        done = run(GODWIT, 'fly', 'street', '--frames', 3, '--out', self.out / 'fly')
        self.assertEqual(done.returncode, 0, done.stderr)
        summary = json.loads((self.out / 'fly' / 'summary.json').read_text())
        self.validator.validate(summary)
        # And the schema is not one that takes anything.
        del summary['tracked_share']
        with self.assertRaises(jsonschema.ValidationError):
            self.validator.validate(summary)

    def test_comparison_takes_turns_and_is_blind_to_a_machine_that_slows_down(self):
        with tempfile.TemporaryDirectory() as folder:
            a, b = fake_program(folder, 'a', 1.2), fake_program(folder, 'b', 1.0)
            done = run(LATENCY, 'street', '--compare', a, b, '--pairs', 10, '--json', f'{folder}/ratio.json')
            self.assertEqual(done.returncode, 0, done.stderr)
            ratio = json.loads(pathlib.Path(folder, 'ratio.json').read_text())
            self.validator.validate(ratio)
            self.assertEqual(pathlib.Path(folder, 'calls').read_text().split(), ['a', 'b'] + ['b', 'a', 'a', 'b'] * 5)
            of = {r['figure']: r for r in ratio['ratios']}
            # 1.2 * 1.3 and 1.2 / 1.3 in turn: the slowing down cancels.
            tracker = of['detector on: tracker CPU time, median']
            self.assertAlmostEqual(tracker['median'], 1.2, places=6)
            self.assertAlmostEqual(tracker['spread'], 0, places=6)
            # And so in the sum, though one side always had more detections, or larger ones.
            threads = of['detector on: CPU time of all threads, as many detections']
            self.assertAlmostEqual(threads['median'], 1.2, places=6)
            self.assertEqual(threads['pairs'], 10)
            full = of["detector on: a detection's CPU time, full input, median"]
            self.assertAlmostEqual(full['median'], 1.2, places=6)
            self.assertEqual(full['pairs'], 4)  # the fifth had two of them: too few to tell

    def test_as_many_pairs_begin_with_one_as_with_the_other(self):
        with tempfile.TemporaryDirectory() as folder:
            a, b = fake_program(folder, 'a', 1), fake_program(folder, 'b', 1)
            done = run(LATENCY, 'street', '--compare', a, b, '--pairs', 5, '--json', f'{folder}/ratio.json')
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(json.loads(pathlib.Path(folder, 'ratio.json').read_text())['pairs'], 6)
            self.assertEqual(pathlib.Path(folder, 'calls').read_text().split(), ['a', 'b'] + ['b', 'a', 'a', 'b'] * 3)

    def test_figures_of_an_older_build_are_named(self):
        with tempfile.TemporaryDirectory() as folder:
            old = pathlib.Path(folder) / 'old'
            old.write_text("#!/bin/sh\nwhile [ \"$1\" != --json ]; do shift; done\n"
                           "echo '{\"kind\": \"latency\", \"flights\": [{\"detector\": true}]}' > \"$2\"\n")
            old.chmod(0o755)
            done = run(LATENCY, 'street', '--compare', old, old, '--pairs', 3)
            self.assertEqual(done.returncode, 1)
            self.assertIn('A: has no CPU time of a detection', done.stderr)

    def test_a_side_that_fails_is_named(self):
        done = run(LATENCY, 'street', '--compare', '/bin/false', '/bin/true', '--pairs', 3)
        self.assertEqual(done.returncode, 1)
        self.assertIn('/bin/false: ended with 1', done.stderr)

    def test_without_a_pose_the_reason_is_said_in_a_comparison_too(self):
        done = run(LATENCY, 'street', '--pictures', 2, '--seconds', 1, '--detector', 'off', '--compare', LATENCY, LATENCY)
        self.assertEqual(done.returncode, 1)
        self.assertIn('godwit-latency: no pose was found: ', done.stderr)

    def test_no_such_sequence(self):
        done = run(LATENCY, '/nowhere/at/all', '--seconds', 1)
        self.assertEqual(done.returncode, 2)
        self.assertIn('/nowhere/at/all: neither the folder of a sequence nor a scenario', done.stderr)

    def test_output_that_cannot_be_made_is_told_before_flying(self):
        for option, name in (('--json', 'folder.json'), ('--plot', 'folder.png')):
            done = run(LATENCY, *SHORT, option, self.out / 'no' / 'such' / name)
            self.assertEqual(done.returncode, 2)
            self.assertIn(name + ': cannot be created: No such file or directory', done.stderr)
            self.assertEqual(done.stdout, '')

    def test_a_flight_that_is_kept_and_shown_as_the_daemon_does(self):
        config, folder = self.out / 'watched.toml', self.out / 'watched'
        folder.mkdir()
        config.write_text(f'[flight_log]\nfolder = "{folder}/log"\n[recorder]\nfolder = "{folder}/events"\n'
                          f'[live]\nsocket = "{folder}/live"\n')
        for words, log in (([], False), (['--watched'], True)):
            done = run(LATENCY, *SHORT, '--detector', 'off', '--config', config, *words, '--json', self.out / 'watched.json')
            self.assertIn(done.returncode, (0, 1), done.stderr)  # so short a flight may find no pose
            self.assertEqual((folder / 'log' / '000001.ulg').exists(), log)
            self.assertEqual('live: ' in done.stderr, log)
            names = {t['name'] for t in json.loads((self.out / 'watched.json').read_text())['flights'][0]['threads']}
            self.assertEqual({'gw-live', 'gw-flightlog', 'gw-events'} <= names, log, names)

    def test_nothing_to_fly_is_told(self):
        done = run(LATENCY, '--seconds', 1)
        self.assertEqual(done.returncode, 2)
        self.assertIn('INPUT, or --camera FILE, is needed', done.stderr)

    def test_a_camera_that_is_none_is_told(self):
        config = self.out / 'camera.toml'
        config.write_text('[camera]\nsource = "sim"\n')
        done = run(LATENCY, '--camera', config, '--seconds', 1)
        self.assertEqual(done.returncode, 2)
        self.assertIn('camera.source: "v4l2" or "libcamera" is what --camera flies', done.stderr)
        config.write_text('[camera]\nsource = "v4l2"\ncalibration = "/nowhere.yaml"\n')
        done = run(LATENCY, '--camera', config, '--seconds', 1)
        self.assertEqual(done.returncode, 2)
        self.assertIn('/nowhere.yaml', done.stderr)
        self.assertEqual(run(LATENCY, 'street', '--camera', config).returncode, 2)

    def test_a_camera_that_does_not_come_is_told_and_ends_in_time(self):
        calibration, config = self.out / 'camera.yaml', self.out / 'camera.toml'
        calibration.write_text('model: pinhole\nwidth: 320\nheight: 240\nfx: 225\nfy: 225\ncx: 160\ncy: 120\n'
                               'distortion_model: radtan\ndistortion: [0, 0, 0, 0]\nimage_channels: 1\nfps: 30\n')
        config.write_text(f'[camera]\nsource = "v4l2"\ndevice = "/dev/no_such_camera"\ncalibration = "{calibration}"\n')
        done = run(LATENCY, '--camera', config, '--seconds', 1, '--detector', 'off', '--json', self.out / 'camera.json')
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn('/dev/no_such_camera', done.stderr)
        self.assertIn('no pose was found', done.stdout)
        figures = json.loads((self.out / 'camera.json').read_text())
        self.validator.validate(figures)
        self.assertIsNone(figures['camera_delays_ms'])
        self.assertEqual(figures['flights'][0]['frames']['due'], 0)

    def test_a_full_disc_leaves_no_half_figures(self):
        def no_room():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
        for option, name in (('--json', 'full.json'), ('--plot', 'full.png')):
            done = run(LATENCY, *SHORT, '--detector', 'off', option, self.out / name, preexec_fn=no_room)
            self.assertEqual(done.returncode, 1, done.stderr)
            self.assertIn(name, done.stderr)
            self.assertIn('File too large', done.stderr)
        self.assertEqual([p for p in os.listdir(self.out) if p.startswith('full')], [])

    def test_no_right_to_lock_is_said(self):
        def few_rights():
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        # As root the limit would not count: the capability goes too, and with the user's name all else would.
        less = ['setpriv', '--bounding-set', '-ipc_lock', '--inh-caps', '-ipc_lock'] if os.geteuid() == 0 else []
        with tempfile.TemporaryDirectory() as folder:
            done = run(*less, LATENCY, *SHORT, '--detector', 'off', '--json', f'{folder}/l.json', preexec_fn=few_rights)
            self.assertIn(done.returncode, (0, 1), done.stderr)
            refused = json.loads(pathlib.Path(folder, 'l.json').read_text())['flights'][0]['refused']
            self.assertIn('flying on without', refused)
            self.assertIn('warning: ' + refused, done.stdout)

    def test_wrong_options(self):
        for words in (['--seconds', '0'], ['--pairs', '1'], ['--detector', 'maybe'], ['--compare', 'one'],
                      ['--seconds', 'nan'], ['--fps', 'inf'], ['--exposure-ms', 'nan'], ['--readout-ms', '-1'],
                      ['--seed', '-5'], ['--pictures', '1e3'], ['--compare', 'a.toml', 'b.toml', '--plot', 'p.png']):
            done = run(LATENCY, 'street', *words)
            self.assertEqual(done.returncode, 2, words)
            self.assertIn(words[0], done.stderr)

    def test_pictures_that_have_no_room_are_told_before_they_are_drawn(self):
        done = run(LATENCY, 'street', '--pictures', 1000000000, '--seconds', 86400, '--fps', 240)
        self.assertEqual(done.returncode, 2)
        self.assertRegex(done.stderr, r'--pictures: 20736000 pictures need \d+ MB, and \d+ MB of memory are free; hold fewer')
        # No more than are flown: a second of them has room.
        done = run(LATENCY, 'street', '--pictures', 1000000000, '--seconds', 1, '--detector', 'off', '--quiet')
        self.assertIn(done.returncode, (0, 1), done.stderr)
        self.assertNotIn('--pictures', done.stderr)

    def test_an_output_that_is_no_file_is_told_before_flying(self):
        pipe = self.out / 'pipe'
        os.mkfifo(pipe)
        for name, why in ((pipe, 'is no plain file'), ('/dev/stdout', 'is no plain file'), (self.out, 'is a folder')):
            done = run(LATENCY, *SHORT, '--json', name)
            self.assertEqual(done.returncode, 2)
            self.assertIn(f'{name}: {why}', done.stderr)
        self.assertTrue(pipe.is_fifo())


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
