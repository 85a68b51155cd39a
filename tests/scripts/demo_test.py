"""scripts/demo --fast with a stand-in for the program: what it flies with and without a sequence, and that it ends with a
report whose path is the last thing it prints."""
import os
import pathlib
import re
import subprocess
import sys
import unittest

sys.dont_write_bytecode = True
import stand_in  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]

# A run of one picture in which nothing was tracked.
FLYER = r'''#!/usr/bin/python3
import json, pathlib, sys
a = sys.argv
with open(pathlib.Path(__file__).parent / 'flown', 'a') as log:
    log.write(' '.join(a[1:]) + chr(10))
(pathlib.Path(__file__).parent / 'stood').write_text(str(pathlib.Path.cwd()))
out = pathlib.Path(a[a.index('--out') + 1])
out.mkdir(parents=True)
(out / 'frames.csv').write_text('t,ms,tracked,map_id,state,features,fate,reason\n0.0,1.0,0,,INITIALISING,0,processed,first view\n')
(out / 'pose.csv').write_text('t,state\n')
(out / 'trajectory.tum').write_text('')
(out / 'summary.json').write_text(json.dumps({'version': '1', 'sequence': a[2], 'mode': 'threads', 'pace': 'max', 'frames': 1,
    'processed': 1, 'tracked': 0, 'tracked_share': 0, 'maps': 0, 'ms': {}}))
if a[1] == 'fly':
    (out / 'groundtruth.txt').write_text('0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n')
if '--view' in a:
    pathlib.Path(a[a.index('--view') + 1]).mkdir(parents=True, exist_ok=True)
'''


class Demo(stand_in.StandInTest):
    FLYER = FLYER

    def setUp(self):
        super().setUp()
        self.root = self.folder / 'place' / 'godwit'
        program = self.root / 'build/release/firmware_app/godwit'
        program.parent.mkdir(parents=True)
        self.flyer.rename(program)
        self.flown = program.parent / 'flown'
        (self.root / 'scripts').mkdir()
        for file in (ROOT / 'scripts').iterdir():
            (self.root / 'scripts' / file.name).symlink_to(file)

    def run_it(self, *arguments):
        return subprocess.run(['sh', str(self.root / 'scripts/demo'), *arguments], capture_output=True, text=True, check=False,
                              cwd=self.folder, env=os.environ | {'MPLCONFIGDIR': str(self.folder)})

    def ends_with_a_report(self, done):
        self.assertEqual(done.returncode, 0, done.stderr)
        last = done.stdout.splitlines()[-1]
        self.assertTrue(last.startswith('The report, for a browser: '), last)
        page = pathlib.Path(last.partition(': ')[2])
        self.assertEqual(page, self.root / 'out/demo/report/report.html')
        self.assertIn('<h1>demo</h1>', page.read_text())

    def test_a_street_where_there_is_no_sequence(self):
        self.ends_with_a_report(self.run_it('--fast'))
        flown = self.flown.read_text().splitlines()
        self.assertEqual(len(flown), 2)
        for words in ('fly street', '--pace real', '--detector on', '--gate on', '--imu on', '--frames 450'):
            self.assertIn(words, flown[0])
        self.assertIn(f'--view {self.root}/out/demo/seen/view', flown[1])

    def test_the_sequence_beside_it(self):
        (self.folder / 'place/shared/data/tum_fr1_xyz').mkdir(parents=True)
        out = self.root / 'out/demo'
        self.ends_with_a_report(self.run_it('--fast'))
        self.assertRegex(self.flown.read_text(), rf'^replay .*tum_fr1_xyz --out {out} --view {out}/view .*--frames 450\n$')

    def test_a_sequence_of_ones_own(self):
        (self.folder / 'mine').mkdir()
        done = self.run_it('--fast', 'mine', '--pace', 'real')
        self.ends_with_a_report(done)
        self.assertIn('No ground truth lies beside the sequence', done.stdout)
        self.assertEqual(self.flown.read_text(), f'replay mine --out {self.root}/out/demo --frames 450 --pace real\n')

    def test_what_replay_makes_a_sequence_of(self):
        (self.folder / 'mine/image_0').mkdir(parents=True)
        (self.folder / 'film.mp4').write_text('moving')
        for words in (('mine',), ('film.mp4', '--fov', '70')):
            self.flown.unlink(missing_ok=True)
            self.ends_with_a_report(self.run_it('--fast', *words))
            self.assertTrue(self.flown.read_text().startswith(f'replay {words[0]} --out {self.root}/out/demo '))

    def test_a_file_that_is_named_is_looked_for_where_the_caller_stands(self):
        (self.folder / 'film.mp4').write_text('moving')
        (self.folder / 'mine.yaml').write_text('model: pinhole\n')
        self.ends_with_a_report(self.run_it('--fast', 'film.mp4', '--camera', 'mine.yaml'))
        words = self.flown.read_text().split()
        stood = pathlib.Path((self.flown.parent / 'stood').read_text())
        self.assertTrue((stood / words[words.index('--camera') + 1]).is_file(), words)
        self.assertTrue((stood / words[1]).is_file(), words)

    def asked_for(self, *arguments):
        """The packages that scripts/setup would install on a machine that has none."""
        tools = self.folder / 'tools'
        tools.mkdir(exist_ok=True)
        for name, does in (('dpkg-query', 'true'), ('apt-get', 'case "$1" in install) shift; echo "$@" >"$0.told" ;; esac; exit 1'), ('id', 'echo 0'), ('sleep', 'true')):
            (tools / name).write_text(f'#!/bin/sh\n{does}\n')
            (tools / name).chmod(0o755)
        subprocess.run(['sh', str(ROOT / 'scripts/setup'), *arguments], capture_output=True, check=False,
                       env=os.environ | {'PATH': f'{tools}:{os.environ["PATH"]}'})
        return [p for p in (tools / 'apt-get.told').read_text().split() if not p.startswith('-')]

    def test_few_packages_are_asked_for(self):
        packages = re.search(r'PACKAGES="\n(.*?)"', (ROOT / 'scripts/setup').read_text(), re.DOTALL).group(1).split()
        self.assertLessEqual(len(packages), 40)
        self.assertNotIn('clang-14', packages)

    def test_a_video_needs_opencv_for_python(self):
        few = self.asked_for('--demo')
        self.assertNotIn('python3-opencv', few)
        self.assertEqual(set(self.asked_for('--video')) - set(few), {'python3-opencv'})
        demo = (ROOT / 'scripts/demo').read_text()
        self.assertIn('if [ -f "$sequence" ]; then "$root/scripts/setup" --video', demo)

    def test_what_an_earlier_one_left_is_not_shown(self):
        old = self.root / 'out/demo/view'
        old.mkdir(parents=True)
        (old / '000000.png').write_text('no picture')
        (self.folder / 'mine').mkdir()
        self.ends_with_a_report(self.run_it('--fast', 'mine', '--pace=real'))
        self.assertFalse(old.exists())

    def test_what_an_earlier_one_made_is_not_flown_and_lost(self):
        made = self.root / 'out/demo/sequence'
        made.mkdir(parents=True)
        (self.folder / 'link').symlink_to(made)
        for name in (str(made), 'link'):
            done = self.run_it('--fast', name)
            self.assertEqual(done.returncode, 2, done.stderr)
            self.assertIn('move it elsewhere first', done.stderr)
            self.assertTrue(made.is_dir())

    def test_a_folder_that_is_not_there(self):
        done = self.run_it('--fast', 'gone')
        self.assertEqual(done.returncode, 2)
        self.assertIn('there is no sequence at', done.stderr)

    def test_a_tree_that_is_not_built(self):
        (self.root / 'build/release/firmware_app/godwit').unlink()
        done = self.run_it('--fast')
        self.assertEqual(done.returncode, 2)
        self.assertIn('is not there: scripts/demo without --fast builds it', done.stderr)


if __name__ == '__main__':
    unittest.main()
