"""What needs PyTorch of the training side, part two: runs and their checkpoints, export, the comparison."""
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

import cv2
import numpy as np
import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import batches  # noqa: E402
import bootstrap  # noqa: E402
import checkpoint  # noqa: E402
import choose  # noqa: E402
import compare  # noqa: E402
import deliver  # noqa: E402
import export  # noqa: E402
import families  # noqa: E402
import network  # noqa: E402
import through_opencv  # noqa: E402
import tiny_set  # noqa: E402
import train  # noqa: E402
import weights  # noqa: E402
from model import CbamYolov5  # noqa: E402

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


class Checkpoints(InFolder):
    def test_a_write_that_is_cut_off_leaves_the_file_before(self):
        path = self.root / 'checkpoint.pt'
        checkpoint.save(path, step=1)
        with unittest.mock.patch.object(torch, 'save', side_effect=lambda _, file: (file.write(b'half'), 1 / 0)):
            with self.assertRaises(ZeroDivisionError):
                checkpoint.save(path, step=2)
        self.assertEqual(checkpoint.load(path)['step'], 1)
        checkpoint.save(path, step=3)  # over the half that was left
        self.assertEqual(checkpoint.load(path)['step'], 3)
        self.assertEqual([p.name for p in self.root.iterdir()], ['checkpoint.pt'])

    def test_what_is_written_is_read(self):
        content = {'step': 3, 'best': None, 'rate': 0.1 + 0.2, 'state': {0: {'step': torch.tensor(2.0)}, 'x': [1, torch.eye(2)]}}
        checkpoint.save(self.root / 'checkpoint.pt', **content)
        held = checkpoint.load(self.root / 'checkpoint.pt')
        self.assertEqual((held['step'], held['best'], held['rate'], list(held['state'])), (3, None, 0.1 + 0.2, [0, 'x']))
        self.assertTrue(torch.equal(held['state']['x'][1], torch.eye(2)))

    def test_what_is_none_is_told(self):
        torch.save({'step': 1}, self.root / 'other.pt')
        with self.assertRaisesRegex(ValueError, 'other.pt: not a checkpoint'):
            checkpoint.load(self.root / 'other.pt')


class Export(InFolder):
    def pictures(self, count, width, height):
        rng = np.random.default_rng(3)
        for _ in range(count):
            image = np.full((height, width, 3), rng.integers(0, 255, 3), np.uint8)
            for _ in range(12):
                x, y, w, h = rng.integers(0, (width, height, width // 2, height // 2))
                image[y:y + h, x:x + w] = rng.integers(0, 255, 3)
            yield cv2.GaussianBlur(image, (5, 5), float(rng.uniform(0.3, 2)))

    def worst(self, net, file, width, height, count):
        return through_opencv.worst_difference(net, file, self.pictures(count, width, height))

    def test_a_network_says_the_same_through_opencv_whatever_its_input(self):
        for size, attention in (('n', True), ('n', False), ('s', True)):
            torch.manual_seed(1)
            net = CbamYolov5(size, attention=attention)
            net.train()(torch.rand(2, 3, 64, 96))  # norms that are not those of the start
            net.eval()
            trained = {k: v.clone() for k, v in net.state_dict().items()}
            unfused = CbamYolov5(size, attention=attention).eval()
            unfused.load_state_dict(trained)
            net.fuse()
            for width, height in ((96, 64), (64, 128)):
                file = self.root / f'{width}x{height}.onnx'
                export.export_onnx(net, width, height, file)
                export.write_metadata(file, width, height)
                self.assertLess(self.worst(unfused, file, width, height, 16), 1e-3)
                read = network.Network(file)
                self.assertEqual((read.width, read.height), (width, height))
            again = weights.load_exported(str(file))
            self.assertEqual(again.name(), ('cbam_' if attention else '') + f'yolov5{size}')
            for key, value in net.state_dict().items():
                self.assertTrue(torch.equal(again.state_dict()[key], value), key)

    def test_the_delivered_files_are_one_network(self):
        first = None
        for name, (width, height) in (('416', (416, 416)), ('320', (320, 320)), ('480x352', (480, 352))):
            file = MODELS / f'cbam_yolov5n_{name}.onnx'
            net = weights.load_exported(str(file))
            first = net.state_dict() if first is None else first
            self.assertTrue(all(torch.equal(first[k], v) for k, v in net.state_dict().items()))
            self.assertLess(self.worst(net, file, width, height, 12), 1e-3)
        copy = self.root / 'copy.onnx'
        export.export_onnx(net, 480, 352, copy)
        self.assertLess(self.worst(net, copy, 480, 352, 2), 1e-3)
        with self.assertRaisesRegex(ValueError, 'not those of a network'):
            broken = export.onnx.load(str(copy))
            del broken.graph.initializer[:5]
            export.onnx.save(broken, str(copy))
            weights.load_exported(str(copy))

    def test_sizes_are_read_as_they_are_written(self):
        self.assertEqual((export.parse_input('416'), export.parse_input('480x352')), ((416, 416), (480, 352)))
        self.assertEqual((export.input_name(416, 416), export.input_name(480, 352)), ('416', '480x352'))
        for wrong in ('480x350', '0', '4096', '480x', 'x', '480x352x3', '-32', '16'):
            with self.assertRaises(export.argparse.ArgumentTypeError, msg=wrong):
                export.parse_input(wrong)


class Comparison(unittest.TestCase):
    def figures(self, hits, spread, digest='a'):
        table = bootstrap.Table(np.arange(len(hits)), np.array(hits, bool), np.ones(len(hits)))
        gates = {f'{k} {g}': spread for k in (4, 6, 9) for g in ('channel', 'spatial')}
        return {'gates': gates, 'pictures_sha256': digest, 'tables': {'coco held_out': {'person all': table.to_json()}}}

    def test_gates_that_stand_still_test_nothing(self):
        good = self.figures([1] * 8, 0.2)
        lines = compare.verdict([good, good], [good, self.figures([1] * 8, 0.049)], 40)
        self.assertIn('CBAM: not tested', lines[-1])
        self.assertFalse([line for line in lines if line.startswith('|')])

    def test_gates_that_move_give_a_table_seed_by_seed(self):
        without, with_it = self.figures([1, 0, 0, 0], 0.0), self.figures([1, 1, 1, 0], choose.LEAST_SPREAD)
        line = compare.verdict([without, without], [with_it, without | {'gates': with_it['gates']}], 200)[-1]
        cells = [c.strip() for c in line.split('|')]
        self.assertEqual(cells[1:3], ['COCO val2017 (4)', 'person all'])
        first, second = (float(v) for v in cells[5].split(','))
        self.assertGreater(first, 0.2)
        self.assertEqual(second, 0)
        low, high = (float(v) for v in cells[7].split(' to '))
        self.assertLess(low, first / 2)
        self.assertGreater(high, first / 2)

    def test_runs_of_other_pictures_are_not_compared(self):
        with self.assertRaisesRegex(SystemExit, 'same pictures'):
            compare.verdict([self.figures([1], 0.2)], [self.figures([1], 0.2, 'b')], 40)

    def delivered(self, *words, fails=None):
        """The programs that deliver.py starts, with their words; the one that is named ends with 7."""
        started = []

        def python(program, *rest, **_):
            started.append((program.name, [str(w) for w in rest]))
            return 7 if program.name == fails else 0

        with tempfile.TemporaryDirectory() as folder, unittest.mock.patch.object(deliver, 'python', python), \
                unittest.mock.patch.object(sys, 'argv', ['deliver.py', '--data', 'D', '--out', folder, *words]):
            pathlib.Path(folder, 'figures.txt').touch()
            return deliver.main(), started

    def test_delivered_files_are_replaced_last_and_only_when_asked(self):
        code, started = self.delivered('--steps', '5')
        self.assertEqual((code, [p for p, _ in started]), (0, ['train.py', 'export.py', *['evaluate.py'] * 4]))
        self.assertIn('--steps', started[0][1])
        code, started = self.delivered('--take', '--models', 'M', '--reference', 'R')
        self.assertEqual((code, len(started), started[-1][0]), (0, 7, 'export.py'))
        self.assertEqual(started[-1][1][-4:], ['--out', 'M', '--reference', 'R'])
        code, started = self.delivered('--simulated', 'SIM')
        self.assertEqual((code, [p for p, _ in started[:3]]), (0, ['train.py', 'train.py', 'export.py']))
        self.assertNotIn('SIM', started[0][1])
        self.assertIn('SIM', started[1][1])
        self.assertEqual([pathlib.Path(w).parent.name for w in started[2][1] if w.endswith('weights.pt')], ['without', 'with'])
        for fails, count in (('train.py', 1), ('export.py', 2), ('evaluate.py', 3)):
            code, started = self.delivered('--take', fails=fails)
            self.assertEqual((code, len(started)), (7, count))

    def refused(self, parse, *words):
        told = io.StringIO()
        with contextlib.redirect_stderr(told), self.assertRaises(SystemExit) as ended:
            parse(['--data', 'D', '--out', 'O', *words])
        self.assertEqual(ended.exception.code, 2)
        return told.getvalue()

    def test_abbreviated_and_foreign_options_are_refused(self):
        for words in (['--step', '5'], ['--se', '2'], ['--batc', '8'], ['--nonsense', '1']):
            self.assertIn('unrecognized arguments', self.refused(compare.parse, *words), words)
            self.assertIn('unrecognized arguments', self.refused(deliver.parse, *words), words)
        self.assertIn('--seed is for compare.py', self.refused(compare.parse, '--seed', '3'))
        self.assertIn('--no-attention is for compare.py', self.refused(compare.parse, '--no-attention'))
        self.assertIn('--seeds must be', self.refused(compare.parse, '--seeds', '0'))
        self.assertIn('multiple of 4', self.refused(compare.parse, '--batch', '6'))
        self.assertIn('multiple of 8', self.refused(train.parse, '--batch', '12', '--simulated', 'S'))
        self.assertIn('multiple of 4', self.refused(train.parse, '--batch', '6', '--simulated', 'S', '--permissive'))
        self.assertIn('yolox has nano', self.refused(train.parse, '--family', 'yolox', '--size', 'n'))
        self.assertIn('yolov5 has n and s', self.refused(train.parse, '--size', 'nano'))
        args, rest = compare.parse(['--data', 'D', '--out', 'O', '--steps', '5'])
        self.assertEqual((args.seeds, rest), (3, ['--steps', '5']))


if __name__ == '__main__':
    unittest.main()
