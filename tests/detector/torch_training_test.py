"""What needs PyTorch of the training side, part two: runs, how they begin, go on and end."""
import contextlib
import io
import json
import os
import pathlib
import shutil
import signal
import sys
import tempfile
import unittest
import unittest.mock

import numpy as np
import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import batches  # noqa: E402
import checkpoint  # noqa: E402
import choose  # noqa: E402
import compare  # noqa: E402
import data  # noqa: E402
import export  # noqa: E402
import families  # noqa: E402
import methods  # noqa: E402
import network  # noqa: E402
import tiny_set  # noqa: E402
import train  # noqa: E402

MODELS = pathlib.Path(network.__file__).resolve().parents[1] / 'models'
TINY = ['--people', 'none', '--view', '64', '--window', '64', '--batch', '4', '--steps', '4', '--choose-every', '2',
        '--device', 'cpu']


class InFolder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)


class Runs(InFolder):
    def setUp(self):
        super().setUp()
        tiny_set.make(self.root)
        small = unittest.mock.patch.object(choose, 'GATE_INPUT', (96, 64))
        small.start()
        self.addCleanup(small.stop)

    def run_to_its_end(self, name, *more):
        told = io.StringIO()
        with contextlib.redirect_stdout(told):
            code = train.train(train.parse(['--data', str(self.root), '--out', str(self.root / name), *TINY, *more]))
        return code, told.getvalue()

    def held(self, name):
        return checkpoint.load(self.root / name / 'checkpoint.pt')

    def assert_same(self, a, b, where=''):
        self.assertIs(type(a), type(b), where)
        if isinstance(a, torch.Tensor):
            self.assertTrue(torch.equal(a, b), where)
        elif isinstance(a, dict):
            self.assertEqual(a.keys(), b.keys(), where)
            for key in a:
                self.assert_same(a[key], b[key], f'{where}/{key}')
        elif isinstance(a, list):
            self.assertEqual(len(a), len(b), where)
            for i, (x, y) in enumerate(zip(a, b)):
                self.assert_same(x, y, f'{where}/{i}')
        else:
            self.assertEqual(a, b, where)

    def interrupted_after(self, steps, name, *more):
        """A run that gets a signal while it learns its step number `steps`."""
        learn = train.Run.learn

        def then_stop(run, *tensors):
            learn(run, *tensors)
            if run.step == steps:
                os.kill(os.getpid(), signal.SIGTERM)

        with unittest.mock.patch.object(train.Run, 'learn', then_stop):
            return self.run_to_its_end(name, *more)

    def test_a_run_that_was_stopped_ends_with_the_same_bits(self):
        tiny_set.make_coco_arrays(self.root)
        tiny_set.make_yolox(self.root)
        for run, words in (('scratch', ['--start', 'scratch']), ('coco', ['--start', 'coco']),
                           ('yolox', ['--family', 'yolox', '--permissive'])):
            # With a teacher, and views drawn by other processes.
            more = words if run == 'scratch' else [*words, '--workers', '2']
            code, told = self.run_to_its_end(f'whole_{run}', *words)
            self.assertEqual(code, 0)
            self.assertIn('step 4 chooses', told)
            self.assertIn('spread of the gates', told)
            code, told = self.interrupted_after(3, f'cut_{run}', *more)
            self.assertEqual((code, self.held(f'cut_{run}')['step']), (train.INTERRUPTED, 3))
            code, told = self.run_to_its_end(f'cut_{run}', *more)
            self.assertIn('goes on from step 3', told)
            self.assertEqual(code, 0)
            whole, cut = self.held(f'whole_{run}'), self.held(f'cut_{run}')
            self.assert_same(whole, cut)
            self.assertEqual(whole['step'], 4)
            net, _, gates = export.network_of_run(self.root / f'whole_{run}' / 'checkpoint.pt', newest=True)
            self.assertEqual(net.name(), 'cbam_yolox_nano' if run == 'yolox' else 'cbam_yolov5n')
            begun = families.make(whole['family'], whole['size'], True).state_dict()
            self.assertFalse(all(torch.equal(whole['net'][k], v) for k, v in begun.items()))

    def test_what_ended_is_not_repeated_and_needs_its_weights_alone(self):
        self.run_to_its_end('run', '--start', 'scratch')
        chosen, _, gates = export.network_of_run(self.root / 'run' / 'checkpoint.pt', newest=False)
        (self.root / 'run' / 'checkpoint.pt').unlink()
        with unittest.mock.patch.object(train, 'load_pictures', side_effect=AssertionError('trained again')):
            code, told = self.run_to_its_end('run', '--start', 'scratch')
            self.assertEqual((code, 'which has ended' in told), (0, True))
            with self.assertRaisesRegex(checkpoint.OtherRun, 'seed 0 there, 1 here'):
                self.run_to_its_end('run', '--start', 'scratch', '--seed', '1')
        again, what, told = export.network_of_run(self.root / 'run' / train.WEIGHTS, newest=False)
        self.assertEqual(told, gates)
        self.assert_same(dict(again.state_dict()), dict(chosen.state_dict()))
        with self.assertRaisesRegex(ValueError, 'weights.pt: holds what was chosen alone'):
            export.network_of_run(self.root / 'run' / train.WEIGHTS, newest=True)

    def test_of_runs_that_began_alike_the_mean_is_exported(self):
        for name, more in (('a', []), ('b', ['--lr', '0.01']), ('other', ['--seed', '1']), ('plain', ['--no-attention'])):
            self.run_to_its_end(name, '--start', 'scratch', *more)
        path = lambda name: self.root / name / train.WEIGHTS  # noqa: E731
        a, b = (export.network_of_run(path(n), False)[0].state_dict() for n in 'ab')
        net, what, gates = export.network_of_runs([path('a'), path('b')], False)
        self.assertEqual((what, gates, net.training), ('mean of 2 runs', {}, False))
        moved = 0
        for key, value in net.state_dict().items():
            if value.dtype.is_floating_point:
                torch.testing.assert_close(value, (a[key] + b[key]) / 2)
                moved += int(not torch.equal(a[key], b[key]))
        self.assertGreater(moved, 50)
        for name, why in (('other', 'seed'), ('plain', 'attention')):
            with self.assertRaisesRegex(ValueError, f'{name}/weights.pt: differs from .*a/weights.pt in {why}'):
                export.network_of_runs([path('a'), path(name)], False)

    def test_a_method_says_what_is_drawn(self):
        ways = {'single': 0, 'cut': 0, 'nothing': 0, 'mosaic': 0}

        def counted(name):
            def draw(*_):
                ways[name] += 1
            return draw
        pictures = {s: [s] for s in (*data.SETS, 'simulated')}
        share = {}
        for method in methods.METHODS:
            ways.update(dict.fromkeys(ways, 0))
            with unittest.mock.patch.multiple(batches, **{name: counted(name) for name in ways}):
                for step in range(150):
                    batches.draw(pictures, batches.Recipe(0, 32, 64, 64, method=method), step)
            share[method] = {k: v / sum(ways.values()) for k, v in ways.items()}
        # Of the views of one COCO picture, which are 3/8 of what is no mosaic; in the other methods of rendered ones as well.
        self.assertAlmostEqual(share['delivered']['cut'], 0.6 * 3 / 8 * 0.25, delta=0.01)
        self.assertEqual(share['delivered']['nothing'], 0)
        for method, eighths in (('moving-gates', 4), ('vehicles', 4), ('vehicles-quarter', 5)):
            self.assertAlmostEqual(share[method]['cut'], 0.6 * eighths / 8 * 0.25, delta=0.01)
            self.assertAlmostEqual(share[method]['nothing'], 0.6 * 3 / 8 * 0.1, delta=0.01)

    def test_gates_that_begin_by_what_they_see_move_from_the_first_step_on(self):
        tiny_set.make_coco_arrays(self.root)
        spread = {}
        for method in methods.METHODS:
            self.run_to_its_end(method, '--method', method, '--steps', '1')
            _, _, gates = export.network_of_run(self.root / method / train.WEIGHTS, False)
            spread[method] = choose.spread(gates)
        self.assertGreater(spread['moving-gates'], 10 * spread['delivered'])
        self.assertGreater(spread['moving-gates'], 0.02)
        for method in methods.VEHICLES:
            self.assertAlmostEqual(spread[method], spread['delivered'], delta=0.2 * spread['delivered'])

    def test_from_published_weights_other_seeds_begin_alike(self):
        tiny_set.make_coco_arrays(self.root)
        for seed in '01':
            self.run_to_its_end(f'seed{seed}', '--seed', seed)
        runs = [self.root / f'seed{seed}' / train.WEIGHTS for seed in '01']
        a, b = (export.network_of_run(r, False)[0].state_dict() for r in runs)
        self.assertFalse(torch.equal(a['model.24.m.0.weight'], b['model.24.m.0.weight']))  # other views
        # What is not learnt, and what is learnt slowly, is still where both began.
        torch.testing.assert_close(a['cbam.4.spatial.weight'], b['cbam.4.spatial.weight'], atol=5e-3, rtol=0.1)
        self.assertEqual(export.network_of_runs(runs, False)[1], 'mean of 2 runs')

    def test_the_teacher_sees_pictures_in_their_own_colours(self):
        tiny_set.make_coco_arrays(self.root)
        seen = []
        make = train.Run._make

        def watched(run, attention):
            net = make(run, attention)
            if not attention:  # the teacher
                raw = net.raw
                net.raw = lambda x: (seen.append(x.clone()), raw(x))[1]
            return net

        drawn = []
        draw = batches.draw
        with unittest.mock.patch.object(train.Run, '_make', watched), \
                unittest.mock.patch.object(batches, 'draw', lambda *words: (drawn.append(draw(*words)), drawn[-1])[1]):
            self.run_to_its_end('run', '--start', 'coco')
        self.assertEqual(len(seen), 4)
        for views, x in zip(drawn, seen):
            plain = np.stack([v.plain for v in views if v is views[0] or v is views[1]]).transpose(0, 3, 1, 2)
            self.assertTrue(np.array_equal(np.round(x.numpy() * 255), plain))
            self.assertFalse(all(np.array_equal(v.plain, v.image) for v in views))

    def test_who_learns_from_free_pictures_opens_no_others(self):
        tiny_set.make_yolox(self.root)
        for lost in ('cats_topdown', 'visdrone_mini'):
            shutil.rmtree(self.root / lost)
        for i in range(1, 9):  # of a licence that binds: in the folder, but not looked at
            (self.root / 'aerial_cars' / 'images' / f'DJI_{i}.jpg').write_text('no picture')
        self.run_to_its_end('run', '--family', 'yolox', '--permissive')
        told = json.loads((self.root / 'run' / 'run.json').read_text())
        self.assertEqual(set(told['pictures']), {'coco', 'aerial_cars'})
        self.assertTrue(all(n.startswith('MOS') for n in told['pictures']['aerial_cars']))

    def test_another_run_is_refused(self):
        self.interrupted_after(1, 'run', '--start', 'scratch')
        with self.assertRaisesRegex(checkpoint.OtherRun, 'lr 0.0005 there, 0.001 here.*give it another folder'):
            self.run_to_its_end('run', '--start', 'scratch', '--lr', '0.001')
        label = self.root / 'cats_topdown' / 'labels' / '0_1.txt'
        label.write_text(label.read_text().replace('0 0.', '0 0.0', 1))
        with self.assertRaisesRegex(checkpoint.OtherRun, 'pictures_sha256'):
            self.run_to_its_end('run', '--start', 'scratch')

    def test_what_is_unseen_or_chooses_or_is_scored_is_not_trained_on(self):
        drawn = []
        draw = batches.draw

        def watched(pictures, *rest):
            drawn.extend(p.name for of in pictures.values() for p in of)
            return draw(pictures, *rest)

        with unittest.mock.patch.object(batches, 'draw', watched):
            self.run_to_its_end('run', '--start', 'scratch')
        told = json.loads((self.root / 'run' / 'run.json').read_text())
        names = {n for of in told['pictures'].values() for n in of}
        self.assertEqual(names, set(drawn))
        self.assertFalse([n for n in names if n.startswith(('5_', '6_', 'MunichStreet'))])
        self.assertFalse(names & {f'{i:012}' for i in (8, 16, 101, 102, 103)} | names & {'v7', 'v8', '0_10', '0_11', '0_12'})
        self.assertIn('0_1', names)

    def test_both_arms_of_the_comparison_see_the_same_views(self):
        tensors = []
        for attention in ([], ['--no-attention']):
            args = train.parse(['--data', str(self.root), '--out', '-', *TINY, *attention])
            pictures = train.load_pictures(args)
            recipe = batches.Recipe(args.seed, args.batch, args.window, args.view)
            tensors.append([t for step in batches.steps(pictures, recipe, 0, 3, 0) for t in step])
        self.assertEqual(len(tensors[0]), 12)
        self.assertTrue(all(torch.equal(a, b) for a, b in zip(*tensors)))

    def test_the_comparison_repeats_nothing_and_refuses_figures_of_other_options(self):
        words = ['--data', str(self.root), '--out', str(self.root / 'cmp'), '--seeds', '1', '--resamples', '40',
                 '--start', 'scratch', *TINY[:-4], '--choose-every', '1', '--device', 'cpu', '--steps', '1']
        args, rest = compare.parse(words)
        first = compare.figures_of(args, rest, True, 0)
        self.assertEqual(set(first['gates']), {f'{k} {g}' for k in (4, 6, 9) for g in ('channel', 'spatial')})
        self.assertIn('cats_topdown unseen', first['tables'])
        with unittest.mock.patch.object(compare, 'python', side_effect=AssertionError('trained again')):
            self.assertEqual(compare.figures_of(args, rest, True, 0), first)
            args, rest = compare.parse([*words[:-1], '2'])
            with self.assertRaisesRegex(SystemExit, 'figures of other options .*steps 1 there, 2 here'):
                compare.figures_of(args, rest, True, 0)


if __name__ == '__main__':
    unittest.main()
