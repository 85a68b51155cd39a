"""scripts/godwit-report: what is no whole run is refused with a word that says why."""
import json
import pathlib
import subprocess
import tempfile
import unittest

REPORT = pathlib.Path(__file__).resolve().parents[2] / 'scripts' / 'godwit-report'


def report(*arguments):
    return subprocess.run([str(REPORT), *map(str, arguments)], capture_output=True, text=True, check=False)


class Refused(unittest.TestCase):
    """Folders that hold no whole run: exit code 2, and a word that says what is wrong."""

    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.run = pathlib.Path(self.temp.name) / 'run'
        self.run.mkdir()
        summary = {'version': '1', 'sequence': 's', 'mode': 'sequential', 'pace': 'max', 'frames': 1, 'processed': 1,
                   'tracked': 0, 'tracked_share': 0, 'maps': 0, 'ms': {}}
        self.files = {'summary.json': json.dumps(summary), 'trajectory.tum': '', 'pose.csv': 't,state\n',
                      'frames.csv': 't,ms,tracked,map_id,state,features,fate,reason\n0.0,1.0,0,,INITIALISING,0,processed,\n'}

    def tearDown(self):
        self.temp.cleanup()

    def refused(self, words, *more, **files):
        for name, text in (self.files | {k.replace('_', '.', 1): v for k, v in files.items()}).items():
            if text is not None:
                (self.run / name).write_text(text)
        self.told(words, self.run, *more)

    def told(self, words, *arguments):
        done = report(*arguments)
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertEqual(done.stdout, '')
        self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)
        self.assertIn(words, done.stderr)

    def test_that_is_not_there(self):
        self.told('there is no such folder', self.run / 'gone')

    def test_that_is_a_file(self):
        (self.run / 'file').write_text('')
        self.told('not a folder', self.run / 'file')

    def test_empty(self):
        self.told('empty, no run was written there', self.run)

    def test_foreign(self):
        (self.run / 'holiday.jpg').write_text('')
        self.told('holds no run of godwit (neither summary.json', self.run)

    def test_half_written(self):
        for name in ('summary.json', 'frames.csv', 'pose.csv', 'trajectory.tum'):
            (self.run / (name + '.part')).write_text('')
        self.told('half written: summary.json.part is there', self.run)

    def test_not_whole(self):
        self.refused('not whole: pose.csv missing', pose_csv=None)

    def test_summary_cut_off(self):
        self.refused('summary.json: not JSON', summary_json='{"version": ')

    def test_summary_of_something_else(self):
        self.refused('not the summary of a run: it has no "version"', summary_json='{"kind": "latency"}')

    def test_summary_that_is_no_table(self):
        self.refused('not the summary of a run', summary_json='[1, 2]')

    def test_events_that_are_none(self):
        summary = json.loads(self.files['summary.json'])
        self.refused('"events" is no list of events', summary_json=json.dumps(summary | {'events': [1]}))

    def test_figures_that_are_none(self):
        summary = json.loads(self.files['summary.json'])
        self.refused('"ms" holds no figures', summary_json=json.dumps(summary | {'ms': {'median': 'fast'}}))

    def test_a_pose_that_is_none(self):
        frames = self.files['frames.csv'].replace(',0,,INIT', ',1,1,INIT')
        summary = json.loads(self.files['summary.json'])
        self.refused('no pose: not finite', frames_csv=frames, trajectory_tum='0 nan 0 0 0 0 0 1 1\n',
                     summary_json=json.dumps(summary | {'tracked': 1}))

    def test_frames_of_something_else(self):
        self.refused('no column "ms"', frames_csv='t,x\n1,2\n')

    def test_frames_cut_off(self):
        self.refused('frames.csv:3: the line is cut off', frames_csv=self.files['frames.csv'] + '0.1,1.0,0')

    def test_frames_of_another_run(self):
        self.refused('summary.json tells 1 frames, frames.csv 2', frames_csv=self.files['frames.csv'] +
                     '0.1,1.0,0,,INITIALISING,0,processed,\n')

    def test_poses_of_another_run(self):
        self.refused('trajectory.tum has 1 poses', trajectory_tum='0 0 0 0 0 0 0 1 1\n')

    def test_poses_cut_off(self):
        self.refused('trajectory.tum:1: 3 numbers, not 9', trajectory_tum='0 0 0\n')

    def test_frames_that_are_no_text(self):
        for name, text in self.files.items():
            (self.run / name).write_text(text)
        (self.run / 'frames.csv').write_bytes(bytes(range(128, 256)))
        self.told('cannot be read', self.run)

    def test_truth_that_is_not_there(self):
        self.refused('cannot be judged by the truth', '--truth', self.run / 'gone.txt')

    def test_one_bad_folder_among_good_ones(self):
        self.told('there is no such folder', self.run / 'gone', self.run)

    def test_cannot_be_written(self):
        for name, text in self.files.items():
            (self.run / name).write_text(text)
        (self.run / 'report').write_text('in the way')
        done = report(self.run)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertIn('cannot be written', done.stderr)


if __name__ == '__main__':
    unittest.main()
