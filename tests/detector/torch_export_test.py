"""What needs PyTorch of the training side, part three: checkpoints, export, the comparison, the delivery."""
import contextlib
import io
import pathlib
import sys
import tempfile
import unittest
import unittest.mock

import cv2
import numpy as np
import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import bootstrap  # noqa: E402
import checkpoint  # noqa: E402
import choose  # noqa: E402
import compare  # noqa: E402
import deliver  # noqa: E402
import export  # noqa: E402
import network  # noqa: E402
import soup  # noqa: E402
import through_opencv  # noqa: E402
import train  # noqa: E402
import weights  # noqa: E402
from model import CbamYolov5  # noqa: E402

from torch_training_test import InFolder, MODELS  # noqa: E402


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

    def two_parents(self):
        """Networks that began alike and differ by a twentieth."""
        nets = []
        for seed in (1, 2):
            torch.manual_seed(0)
            net = CbamYolov5('n').eval().fuse()
            torch.manual_seed(seed)
            with torch.no_grad():
                for p in net.parameters():
                    p += 0.05 * p.abs().mean() * torch.randn_like(p)
            nets.append(net)
        return nets

    def test_the_channels_of_a_mean_are_as_busy_as_those_of_its_parents(self):
        parents, held = self.two_parents(), {}
        seen = torch.rand(4, 3, 96, 96, generator=torch.Generator().manual_seed(3))

        def spreads(net):
            held.clear()
            hooks = soup._hooked(net, lambda name, _, said: held.update({name: soup._over(said)}))
            with torch.no_grad():
                net.features(seen)
            for hook in hooks:
                hook.remove()
            return dict(held)
        wanted = [spreads(p) for p in parents]
        net = self.two_parents()[0]
        net.load_state_dict(soup.mean_of(parents))
        off = lambda had: max(float((had[k][i] - (wanted[0][k][i] + wanted[1][k][i]) / 2).abs().max())  # noqa: E731
                              / float(wanted[0][k][1].mean()) for k in had for i in (0, 1))
        self.assertGreater(off(spreads(net)), 0.05)
        soup.repair(net, parents, seen)
        self.assertLess(off(spreads(net)), 0.01)
        same = self.two_parents()[0]
        soup.repair(same, [parents[0], parents[0]], seen)
        for key, value in same.state_dict().items():
            torch.testing.assert_close(value, parents[0].state_dict()[key], atol=1e-4, rtol=1e-3)

    def test_files_have_a_mean_each_as_often_as_it_is_named(self):
        a, b = self.two_parents()
        files = [pathlib.Path(self.folder(), f'{n}.onnx') for n in 'ab']
        for net, file in zip((a, b), files):
            export.export_onnx(net, 64, 64, file)
        mean = export.network_of_files([files[0], files[0], files[1]]).state_dict()
        for key, value in mean.items():
            torch.testing.assert_close(value, (2 * a.state_dict()[key] + b.state_dict()[key]) / 3)
        other = files[0].with_name('plain.onnx')
        export.export_onnx(CbamYolov5('n', attention=False).eval().fuse(), 64, 64, other)
        with self.assertRaisesRegex(ValueError, 'plain.onnx: yolov5n, and .*a.onnx is cbam_yolov5n'):
            export.network_of_files([files[0], other])

    def test_statistics_are_for_a_mean_and_never_of_what_is_scored(self):
        for words in (['--weights', 'A'], ['--weights', 'A', 'B']):
            told = io.StringIO()
            with contextlib.redirect_stderr(told), self.assertRaises(SystemExit), \
                    unittest.mock.patch.object(sys, 'argv', ['export.py', *words, '--out', 'O', '--simulated', 'S']):
                export.main()
            self.assertIn('--simulated is for a mean of several, with --data', told.getvalue())
        scored = pathlib.Path(self.folder())
        (scored / 'purpose.json').write_text('{"for": "scoring", "scenarios": ["street"]}')
        with self.assertRaisesRegex(ValueError, 'not to be trained on'):
            export.repaired(*([None] * 3), scored)

    def folder(self):
        made = tempfile.TemporaryDirectory()
        self.addCleanup(made.cleanup)
        return made.name

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
        self.assertNotIn('SIM', started[2][1])
        code, started = self.delivered('--simulated', 'SIM', '--vehicles', 'SIM2')
        self.assertEqual((code, [p for p, _ in started[:5]]), (0, [*['train.py'] * 4, 'export.py']))
        self.assertEqual([w[w.index('--method') + 1:] for _, w in started[2:4]],
                         [['vehicles', '--seed', '1'], ['vehicles-quarter', '--seed', '2']])
        self.assertEqual(len([w for w in started[4][1] if w.endswith('weights.pt')]), 4)
        self.assertEqual(started[4][1][started[4][1].index('--simulated') + 1], 'SIM2')
        self.assertIn('--vehicles is for --simulated', self.refused(deliver.parse, '--vehicles', 'SIM2'))
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
