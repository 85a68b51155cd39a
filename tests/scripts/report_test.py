"""scripts/godwit-report: the figures in its page are those of summary.json, every picture is in it and can be decoded, and
a browser opens it without a word.

  report_test.py GODWIT [unittest's arguments]
"""
import base64
import csv
import html.parser
import io
import json
import os
import pathlib
import random
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import types
import unittest

from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
REPORT = ROOT / 'scripts' / 'godwit-report'
sys.dont_write_bytecode = True
sys.path.insert(0, str(ROOT / 'scripts'))
from report import views  # noqa: E402
GODWIT = pathlib.Path(sys.argv[1]).resolve()
BROWSER = 'chromium-headless-shell'
# The street is flown from its 70th picture on, where it moves, with and without threads.
FLIGHTS = {
    'alone': ['--sequential', '--start', '70', '--frames', '80', '--view-every', '20', '--gate', 'on'],
    'threads': ['--start', '70', '--frames', '60', '--pace', 'real', '--render-ahead'],
    'metric': ['--sequential', '--frames', '130', '--imu', 'on'],
}


class Page(html.parser.HTMLParser):
    """What a page shows: figures by run and key, as exact value and text; pictures; anything it would load."""

    def __init__(self, text):
        super().__init__()
        self.figures, self.exact, self.images, self.loaded, self.open = {}, {}, [], [], None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        a = dict(attributes)
        if tag == 'img':
            self.images.append(a)
        self.loaded += [a[k] for k in ('src', 'href') if k in a and not a[k].startswith(('data:', '#'))]
        if tag == 'script':
            self.loaded.append('script')
        self.open = None
        if 'data-key' in a:
            self.open = (int(a['data-run']), a['data-key'])
            self.figures[self.open] = [json.loads(a['data-value']), '']
        elif 'data-all' in a:
            self.exact[int(a['data-run']), a['data-all']] = json.loads(a['data-value'])

    def handle_data(self, data):
        if self.open:
            self.figures[self.open][1] += data

    def handle_endtag(self, tag):
        self.open = None


def report(*arguments):
    return subprocess.run([str(REPORT), *map(str, arguments)], capture_output=True, text=True, check=False)


def at(summary, key):
    for part in key.split('.'):
        summary = summary.get(part) if isinstance(summary, dict) else None
    return summary


def leaves(value, key=''):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if items is None:
        yield key, value
        return
    for k, v in items:
        if key or k != 'events':
            yield from leaves(v, f'{key}.{k}' if key else str(k))


class Report(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temp = tempfile.TemporaryDirectory()
        cls.folder = pathlib.Path(cls.temp.name)
        for name, options in FLIGHTS.items():
            view = ['--view', str(cls.folder / name / 'view')] if '--view-every' in options else []
            subprocess.run([str(GODWIT), 'fly', 'street', '--out', str(cls.folder / name), *options, *view], check=True,
                           stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        done = report(*(cls.folder / name for name in FLIGHTS), '--out', cls.folder / 'page')
        assert done.returncode == 0, done.stderr
        cls.told = done.stdout
        cls.page = Page((cls.folder / 'page' / 'report.html').read_text())
        cls.summaries = [json.loads((cls.folder / name / 'summary.json').read_text()) for name in FLIGHTS]

    @classmethod
    def tearDownClass(cls):
        cls.temp.cleanup()

    def test_tells_where_the_page_is(self):
        self.assertEqual(self.told, f'3 runs: {self.folder}/page/report.html\n')

    def test_figures_are_those_of_summary(self):
        compared = 0
        for (n, key), (value, text) in self.page.figures.items():
            if key.startswith('judged.'):
                continue
            self.assertEqual(value, at(self.summaries[n], key), (n, key))
            if value is None:
                self.assertEqual(text, '–')
                continue
            shown = float(re.match(r'-?[0-9.]+(e-?[0-9]+)?', text.replace('\u202f', '')).group())
            shown = shown / 100 if text.endswith(' %') else shown
            self.assertAlmostEqual(shown, value, delta=max(0.006 * abs(value), 0.00006), msg=(key, text))
            compared += 1
        self.assertGreater(compared, 60)
        self.assertIn((1, 'age_ms.p99'), self.page.figures)
        self.assertIn((1, 'scheduler.late'), self.page.figures)

    def test_all_of_summary_is_there(self):
        for n, summary in enumerate(self.summaries):
            wanted = dict(leaves(summary))
            self.assertEqual({k: v for (run, k), v in self.page.exact.items() if run == n}, wanted)

    def test_all_that_a_run_writes_is_documented(self):
        formats = (ROOT / 'docs/formats.md').read_text()
        told = set(re.findall(r'`([^`]+)`', formats))
        for first, last in re.findall(r'`([a-z])00` .. `[a-z](\d\d)`', formats):
            told |= {f'{first}{i}{j}' for i in range(int(last[0]) + 1) for j in range(i, int(last[0]) + 1)}
        schema = json.loads((ROOT / 'docs/figures.schema.json').read_text())['$defs']['summary']['properties']
        for n, name in enumerate(FLIGHTS):
            for file in ('frames.csv', 'pose.csv'):
                columns = (self.folder / name / file).read_text().partition('\n')[0].split(',')
                self.assertEqual([c for c in columns if c not in told], [], (file, 'columns that docs/formats.md lacks'))
            self.assertEqual([k for k in self.summaries[n] if 'description' not in schema.get(k, {})], [])
            files = {p.name for p in (self.folder / name).iterdir() if p.is_file()}
            self.assertEqual(files - told, set(), 'files that docs/formats.md lacks')

    def test_errors_are_those_of_evaluate(self):
        for n, name in enumerate(FLIGHTS):
            run = self.folder / name
            for extra, prefix in (([], 'judged.'), (['--metric'], 'judged.metric_')):
                if name != 'metric' and extra:
                    continue
                told = subprocess.run([str(ROOT / 'scripts/evaluate'), str(run / 'groundtruth.txt'), str(run), '--json', *extra],
                                      capture_output=True, text=True, check=True)
                told = json.loads(told.stdout)
                shared = [k for k in told if (n, prefix + k) in self.page.figures]
                # At real pace a busy machine may not have tracked a frame.
                self.assertGreater(len(shared), 3 if self.summaries[n]['tracked'] > 30 else -1)
                for key in shared:
                    self.assertAlmostEqual(self.page.figures[n, prefix + key][0], told[key], places=9, msg=key)
        self.assertEqual(self.page.figures[0, 'judged.false_sure'][0], 0)

    def test_needs_no_other_file_and_every_picture_decodes(self):
        self.assertEqual(self.page.loaded, [])
        self.assertGreaterEqual(len(self.page.images), 3 + 4 + 3)  # ways, curves, views
        for a in self.page.images:
            head, _, code = a['src'].partition(',')
            self.assertIn(head, ('data:image/png;base64', 'data:image/jpeg;base64'))
            with Image.open(io.BytesIO(base64.b64decode(code, validate=True))) as picture:
                picture.load()
                self.assertGreater(picture.width, 300)
            self.assertTrue(a['alt'])

    def test_pictures_lie_beside_the_page(self):
        names = {p.name for p in (self.folder / 'page').glob('*.png')}
        self.assertEqual(names, {*(f'trajectory-{n + 1}-{name}.png' for n, name in enumerate(FLIGHTS)), 'rpe.png', 'scale.png',
                                 'consistency.png', 'timeline.png', 'latency.png'})

    def test_a_browser_shows_it_all(self):
        if not shutil.which(BROWSER):
            if os.environ.get('CI') == 'true':
                self.fail(f'{BROWSER} is not there: scripts/setup installs it')
            self.skipTest(f'{BROWSER} is not there (scripts/setup): the page was not opened')
        # The page itself has no script: a copy gets one that tells what was shown.
        text = (self.folder / 'page' / 'report.html').read_text()
        count = '''<script>addEventListener('load', () => {
  const all = [...document.images];
  document.body.dataset.shown = all.filter(i => i.complete && i.naturalWidth > 0).length + ' of ' + all.length;
  document.body.dataset.wide = document.documentElement.scrollWidth <= innerWidth;
});</script></body>'''
        copy = self.folder / 'copy.html'
        copy.write_text(text.replace('</body>', count))
        done = subprocess.run([BROWSER, '--no-sandbox', '--disable-gpu', '--enable-logging=stderr', '--window-size=1200,900',
                               '--disable-background-networking', '--disable-dev-shm-usage', '--no-first-run',
                               f'--user-data-dir={self.folder}/browser', '--dump-dom', f'file://{copy}'],
                              capture_output=True, text=True, timeout=240, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        n = len(self.page.images)
        self.assertIn(f'data-shown="{n} of {n}"', done.stdout[-400:] + done.stdout[:6000])
        self.assertIn('data-wide="true"', done.stdout)
        self.assertEqual([line for line in done.stderr.splitlines() if 'CONSOLE' in line], [])

    def test_pictures_of_what_was_seen_cost_no_time_of_a_frame(self):
        # Drawing one takes some fifty times what tracking does.
        with open(self.folder / 'alone/frames.csv', newline='', encoding='ascii') as file:
            rows = list(csv.DictReader(file))
        drawn = {int(p.stem) for p in (self.folder / 'alone/view').glob('*.png')}
        cost = {seen: [float(r['thread_cpu_ms']) for n, r in enumerate(rows) if r['tracked'] == '1' and (n in drawn) == seen]
                for seen in (True, False)}
        self.assertGreater(len(cost[True]), 1)
        self.assertLess(statistics.median(cost[True]), 10 * statistics.median(cost[False]))

    def test_an_ate_says_whether_it_was_scaled(self):
        words = ('ATE in metres, not scaled', 'ATE, after a similarity')
        for run, told in (('metric', [True, False]), ('alone', [False, True])):
            self.assertEqual(report(self.folder / run, '--out', self.folder / 'scaled').returncode, 0)
            text = (self.folder / 'scaled/report.html').read_text()
            self.assertEqual([w in text[text.index('class="tile'):text.index('id="figures"')] for w in words], told)

    def test_a_picture_of_a_run_that_began_later_has_the_words_of_its_own_frame(self):
        # Pictures and lines are both numbered from the first that was flown, wherever in the sequence that was.
        frames = [{'state': 'TRACKING', 'features': str(n), 'reason': ''} for n in range(121)]
        run = types.SimpleNamespace(summary={'start': 75}, frames=frames, tracked=[True] * 121, t=[n / 30 for n in range(121)])
        for number in (0, 60, 80, 120):
            self.assertEqual(views.caption(run, number), f'{number / 30:.2f} s: TRACKING, {number} features')
        self.assertEqual(views.caption(run, 121), 'picture 121')

    def test_runs_of_the_same_name_are_told_apart(self):
        runs = [self.folder / 'twice' / day / 'street' for day in ('monday', 'tuesday')]
        for run in runs:
            shutil.copytree(self.folder / 'alone', run, ignore=shutil.ignore_patterns('view'))
        names = ['monday/street', 'tuesday/street (1)', 'tuesday/street (2)']
        done = report(*runs, runs[1], '--out', self.folder / 'told_apart')
        self.assertEqual(done.returncode, 0, done.stderr)
        text = (self.folder / 'told_apart/report.html').read_text()
        self.assertIn(f'<h1>{", ".join(names)}</h1>', text)
        for name in names:
            for place in (f'</span>{name}</h3>', f'</span>{name}</th>', f'<figcaption>{name}</figcaption>', f'<summary>{name}: all of'):
                self.assertIn(place, text)
        self.assertEqual({p.name for p in (self.folder / 'told_apart').glob('trajectory*')},
                         {'trajectory-1-monday-street.png', 'trajectory-2-tuesday-street-1.png', 'trajectory-3-tuesday-street-2.png'})

    def test_without_a_truth_nothing_is_said_of_errors(self):
        run = self.folder / 'untrue'
        shutil.copytree(self.folder / 'alone', run)
        (run / 'groundtruth.txt').unlink()
        done = report(run)
        self.assertEqual(done.returncode, 0, done.stderr)
        page = Page((run / 'report' / 'report.html').read_text())
        self.assertEqual(page.figures[0, 'judged.false_sure'], [None, '–'])
        self.assertEqual(page.figures[0, 'tracked'][0], self.summaries[0]['tracked'])

    def test_pictures_of_a_folder_that_is_named(self):
        run, other = self.folder / 'threads', self.folder / 'pictures'
        # Another run's: its own words; nobody's: numbers.
        for view, words in ((self.folder / 'alone' / 'view', 'TRACKING, '), (other, 'picture 60')):
            if view == other:
                shutil.copytree(self.folder / 'alone' / 'view', other)
            done = report(run, '--view', view, '--out', self.folder / 'seen')
            self.assertEqual(done.returncode, 0, done.stderr)
            text = (self.folder / 'seen/report.html').read_text()
            self.assertIn(words, text[text.index('id="views"'):text.index('id="figures"')])
            self.assertEqual(sum('jpeg' in a['src'][:20] for a in Page(text).images), 4)
        done = report(run, '--view', self.folder / 'gone')
        self.assertEqual(done.returncode, 2)
        self.assertIn('there is no such folder of pictures', done.stderr)

    def test_damaged_files_are_refused_or_shown_never_a_trace(self):
        run, random_numbers = self.folder / 'damaged', random.Random(1)
        words = ('nan', '-inf', '1e999', '', 'x', '0', '\x00', '-1', '""', '[', 'null')
        for turn in range(12):
            shutil.rmtree(run, ignore_errors=True)
            shutil.copytree(self.folder / 'metric', run)
            file = run / ('pose.csv', 'trajectory.tum', 'frames.csv', 'summary.json')[turn % 4]
            pieces = re.split(r'([, \n])', file.read_text())
            if turn < 4:
                pieces = pieces[:random_numbers.randrange(len(pieces))]
            else:
                for _ in range(3):
                    pieces[2 * random_numbers.randrange(len(pieces) // 2)] = random_numbers.choice(words)
            file.write_text(''.join(pieces))
            done = report(run)
            self.assertIn(done.returncode, (0, 2), done.stderr)
            self.assertNotIn('Traceback', done.stderr, (turn, file.name))
            self.assertEqual(len(done.stderr.splitlines()), 1 if done.returncode else 0, done.stderr)

    def test_wrong_frames_come_first(self):
        run = self.folder / 'wrong'
        shutil.copytree(self.folder / 'alone', run, ignore=shutil.ignore_patterns('view'))
        lines = (run / 'trajectory.tum').read_text().splitlines()
        for i in (-1, -2):
            row = lines[i].split()
            row[3] = str(float(row[3]) + 40)
            lines[i] = ' '.join(row)
        (run / 'trajectory.tum').write_text('\n'.join(lines) + '\n')
        done = report(run)
        self.assertEqual(done.returncode, 0, done.stderr)
        text = (run / 'report' / 'report.html').read_text()
        self.assertGreaterEqual(Page(text).figures[0, 'judged.false_sure'][0], 2)
        self.assertLess(text.index('off by'), text.index('The way flown'))

    def test_many_dropped_pictures_are_told_first(self):
        run, said = self.folder / 'busy', 'were dropped: the machine was too slow'
        shutil.copytree(self.folder / 'alone', run, ignore=shutil.ignore_patterns('view'))
        self.assertEqual(report(run, '--out', self.folder / 'idle').returncode, 0)
        self.assertNotIn(said, (self.folder / 'idle/report.html').read_text())
        summary, lines = json.loads((run / 'summary.json').read_text()), (run / 'frames.csv').read_text().splitlines()
        fate, taken = lines[0].split(',').index('fate'), 0
        for n, line in enumerate(lines):
            cells = line.split(',')
            if n and taken < 4 and cells[fate] == 'processed' and cells[lines[0].split(',').index('tracked')] == '0':
                cells[fate] = 'dropped_late'
                lines[n], taken = ','.join(cells), taken + 1
        (run / 'frames.csv').write_text('\n'.join(lines) + '\n')
        summary['processed'] -= taken
        summary['dropped_late'] += taken
        (run / 'summary.json').write_text(json.dumps(summary))
        done = report(run)
        self.assertEqual(done.returncode, 0, done.stderr)
        text = (run / 'report/report.html').read_text()
        self.assertIn(f'{taken} of 80 pictures {said}', text[:text.index('The way flown')])

    def test_the_features_that_a_frame_needs_are_those_of_the_run(self):
        least = int(re.search(r'int min_measurements = (\d+);', (ROOT / 'vo_core/tracking/health.h').read_text()).group(1))
        words = f'counts as tracked with at least {least} features (dashed)'
        self.assertTrue(words in (self.folder / 'page/report.html').read_text(), words)
        for page in ('docs/formats.md', 'docs/figures.schema.json', 'benchmarks/conditions'):
            self.assertRegex((ROOT / page).read_text(), rf'at least {least} (image )?measurements', page)

    def test_a_run_without_one_tracked_frame(self):
        run = self.folder / 'blind'
        subprocess.run([str(GODWIT), 'fly', 'street', '--sequential', '--frames', '3', '--out', str(run)], check=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        done = report(run)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(Page((run / 'report' / 'report.html').read_text()).figures[0, 'tracked'], [0, '0'])


if __name__ == '__main__':
    outcome = unittest.main(argv=[sys.argv[0], *sys.argv[2:]], verbosity=2, exit=False).result
    for test, why in outcome.skipped:
        print(f'SKIPPED: {test}: {why}')
    sys.exit(1 if not outcome.wasSuccessful() else 77 if outcome.skipped else 0)
