"""What needs PyTorch of the training side, part three: the network without anchors, its start, its loss, its export."""
import os
import pathlib
import sys
import tempfile
import unittest

import cv2
import numpy as np
import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import data  # noqa: E402
import export  # noqa: E402
import families  # noqa: E402
import network  # noqa: E402
import through_opencv  # noqa: E402
import tiny_set  # noqa: E402
import train  # noqa: E402
import weights  # noqa: E402
import yolox  # noqa: E402
import yolox_loss  # noqa: E402

MODELS = pathlib.Path(network.__file__).resolve().parents[1] / 'models'
CLASSES = 6
SHAPES = ((8, 8), (4, 4), (2, 2))  # of an input of 64 x 64


def rows(*of):
    return torch.tensor(of, dtype=torch.float32).reshape(len(of), -1)


class Assignment(unittest.TestCase):
    def setUp(self):
        self.at, self.strides = yolox.cells(SHAPES, torch.device('cpu'))

    def said(self, box=(500.0, 500.0, 2.0, 2.0)):
        return rows(*[box] * len(self.at)).clone()

    def cell(self, level, row, column):
        return sum(ny * nx for ny, nx in SHAPES[:level]) + row * SHAPES[level][1] + column

    def assign(self, said, boxes, labels, kinds=None):
        kinds = torch.full((len(said), CLASSES), 0.5) if kinds is None else kinds
        cell, box, iou = yolox_loss.assign(said, kinds, self.at, self.strides, boxes, torch.tensor(labels))
        return dict(zip(cell.tolist(), zip(box.tolist(), iou.tolist())))

    def test_a_box_that_nobody_says_is_learnt_by_one_cell_at_its_centre(self):
        learnt = self.assign(self.said(), rows((30, 44, 14, 20)), [0])
        self.assertEqual(len(learnt), 1)
        centre = (self.at + 0.5) * self.strides[:, None]
        (cell, (box, iou)), = learnt.items()
        self.assertEqual((box, iou), (0, 0))
        self.assertLess(float((centre[cell] - torch.tensor([30.0, 44])).abs().max()), 1.5 * float(self.strides[cell]))

    def test_as_many_cells_learn_it_as_their_overlaps_add_up_to_and_the_best_of_them(self):
        said, wanted = self.said(), (30.0, 44.0, 14.0, 20.0)
        exact = [self.cell(0, 5, 3), self.cell(0, 5, 4), self.cell(1, 2, 1)]
        for c in exact:
            said[c] = torch.tensor(wanted)
        said[self.cell(0, 5, 2)] = torch.tensor((30.0, 44.0, 7.0, 20.0))  # half: 3.5 in all
        learnt = self.assign(said, rows(wanted), [0])
        self.assertEqual(set(learnt), set(exact))
        self.assertTrue(all(iou > 0.999 for _, iou in learnt.values()))

    def test_between_equal_boxes_the_class_decides(self):
        said, wanted = self.said(), (30.0, 44.0, 14.0, 20.0)
        a, b = self.cell(0, 5, 3), self.cell(1, 2, 1)
        said[a] = said[b] = torch.tensor((30.0, 44.0, 9.0, 20.0))  # 0.64 each: one cell
        kinds = torch.full((len(said), CLASSES), 0.1)
        kinds[b, 4] = 0.9
        self.assertEqual(set(self.assign(said, rows(wanted), [4], kinds)), {b})
        kinds[a, 4] = 0.95
        self.assertEqual(set(self.assign(said, rows(wanted), [4], kinds)), {a})

    def test_of_two_boxes_that_want_one_cell_the_cheaper_has_it(self):
        said = self.said()
        cell = self.cell(0, 5, 3)
        said[cell] = torch.tensor((30.0, 44.0, 14.0, 20.0))
        boxes = rows((30, 44, 14, 20), (28, 44, 8, 12))
        for order, wanted in ((boxes, 0), (boxes.flip(0), 1)):
            learnt = self.assign(said, order, [2, 2])
            self.assertEqual(learnt[cell][0], wanted)

    def test_a_box_that_no_cell_is_near_is_learnt_nowhere(self):
        self.assertEqual(self.assign(self.said(), rows((300, 300, 20, 20)), [0]), {})
        self.assertEqual(self.assign(self.said(), torch.zeros(0, 4), []), {})

    def test_cells_far_from_the_centre_do_not_learn_it_however_well_they_say_it(self):
        wanted = (32.0, 32.0, 60.0, 60.0)
        learnt = self.assign(rows(*[wanted] * len(self.at)), rows(wanted), [0])
        self.assertEqual(len(learnt), 10)
        centre = (self.at + 0.5) * self.strides[:, None]
        for cell in learnt:
            self.assertLess(float((centre[cell] - 32).abs().max()), 1.5 * float(self.strides[cell]))


class Loss(unittest.TestCase):
    def raw(self, batch=1, dtype=torch.float32):
        return [torch.zeros(batch, ny, nx, 5 + CLASSES, dtype=dtype, requires_grad=True) for ny, nx in SHAPES]

    def gradients(self, targets, ignore=(), raw=None, teacher=None, taught=0):
        raw = self.raw() if raw is None else raw
        total, parts = yolox_loss.detection_loss(raw, torch.tensor(targets, dtype=torch.float32).reshape(-1, 6),
                                                 torch.tensor(ignore, dtype=torch.float32).reshape(-1, 5), teacher, taught)
        total.backward()
        return [y.grad for y in raw], {k: float(v) for k, v in parts.items()}

    def test_its_gradient_is_that_of_small_steps(self):
        torch.manual_seed(3)
        raw = [(0.5 * torch.randn(2, ny, nx, 5 + CLASSES)).double().requires_grad_() for ny, nx in SHAPES]
        teacher = [torch.randn(1, ny, nx, 5 + CLASSES).double() for ny, nx in SHAPES]
        targets = torch.tensor([[0, 0, 30.0, 44, 14, 25], [0, 2, 12, 20, 12, 9], [1, data.VEHICLE, 40, 20, 22, 12]])
        ignore = torch.tensor([[1, 0, 0, 20.0, 20]])
        loss = lambda of: yolox_loss.detection_loss(of, targets, ignore, teacher, 1)[0]  # noqa: E731
        loss(raw).backward()
        # Objectness, classes and boxes; the classes' goal is the overlap, which is held still, so that of a cell that learns a
        # box only what it says of the box is stepped where nothing else follows from it.
        gradients = [y.grad.clone() for y in raw]
        checked = 0
        for level, y in enumerate(raw):
            for value in (4, 5, 7, 10):
                for _ in range(6):
                    at = tuple(int(torch.randint(n, (1,))) for n in y.shape[:3]) + (value,)
                    values = []
                    for step in (1e-5, -1e-5):
                        moved = [v.detach().clone() for v in raw]
                        moved[level][at] += step
                        values.append(float(loss(moved)))
                    self.assertAlmostEqual((values[0] - values[1]) / 2e-5, float(gradients[level][at]), places=5)
                    checked += abs(float(gradients[level][at])) > 1e-4
        self.assertGreater(checked, 30)

    def test_a_box_is_drawn_to_what_is_wanted(self):
        raw = self.raw()
        g, parts = self.gradients([[0, 0, 36, 44, 16, 16]], raw=raw)
        self.assertGreater(parts['box'], 0)
        moved = [(y - 0.02 * d).detach() for y, d in zip(raw, g)]
        targets = torch.tensor([[0, 0, 36.0, 44, 16, 16]])
        after = yolox_loss.detection_loss(moved, targets, torch.zeros(0, 5), None, 0)[1]
        for part in ('box', 'object', 'class'):
            self.assertLess(float(after[part]), parts[part], part)

    def test_without_boxes_everything_is_background(self):
        gradients, parts = self.gradients([])
        self.assertEqual((parts['box'], parts['class'], parts['distil']), (0, 0, 0))
        for g in gradients:
            self.assertGreater(float(g[..., 4].min()), 0)
            self.assertEqual(float(g[..., :4].abs().max()), 0)

    def test_a_box_outside_is_background_and_no_failure(self):
        gradients, parts = self.gradients([[0, 2, 300, 300, 10, 10]])
        self.assertEqual((parts['box'], parts['class']), (0, 0))
        self.assertTrue(all(torch.isfinite(g).all() for g in gradients))

    def test_a_vehicle_of_unknown_kind_may_be_a_bus(self):
        gradients, _ = self.gradients([[0, data.VEHICLE, 36, 44, 8, 8]])
        flat = torch.cat([g.reshape(-1, 5 + CLASSES) for g in gradients])
        learnt = flat[flat[:, 4] < 0]
        self.assertGreater(len(learnt), 0)
        self.assertTrue((learnt[:, [5 + 4, 5 + 5]] == 0).all())
        self.assertTrue((learnt[:, 5] > 0).all())

    def test_nothing_is_learnt_in_an_ignored_region_but_what_is_labelled(self):
        gradients, _ = self.gradients([[0, 0, 28, 44, 8, 8]], ignore=[[0, 0, 32, 32, 64]])
        objectness = gradients[0][0, :, :, 4]
        self.assertGreater(float(objectness[:4].min()), 0)
        inside = objectness[4:, :4]
        self.assertTrue((inside <= 0).all())
        self.assertLess(float(torch.cat([g[..., 4].flatten() for g in gradients]).min()), 0)

    def test_what_the_teacher_sees_is_an_object_and_is_repeated(self):
        teacher = [torch.full((1, ny, nx, 5 + CLASSES), -9.0) for ny, nx in SHAPES]
        teacher[0][0, 2, 3, 4:6] = 4.0
        gradients, parts = self.gradients([], raw=self.raw(2), teacher=teacher, taught=1)
        self.assertLess(float(gradients[0][0, 2, 3, 4]), 0)
        self.assertGreater(float(gradients[0][1, 2, 3, 4]), 0)
        self.assertLess(float(gradients[0][0, 2, 3, 5]), 0)
        self.assertEqual(float(gradients[0][1, ..., 5:].abs().max()), 0)
        self.assertGreater(parts['distil'], 0)

    def test_it_falls_where_boxes_are_learnt(self):
        torch.manual_seed(0)
        raw = self.raw()
        optimiser = torch.optim.Adam(raw, lr=0.1)
        targets, values = torch.tensor([[0, 0, 30.0, 44, 14, 25], [0, 4, 12, 14, 18, 10]]), []
        for _ in range(80):
            total, _ = yolox_loss.detection_loss(raw, targets, torch.zeros(0, 5), None, 0)
            optimiser.zero_grad()
            total.backward()
            optimiser.step()
            values.append(float(total))
        self.assertLess(values[-1], 0.2 * values[0])
        y = torch.cat([v.reshape(-1, 5 + CLASSES) for v in raw]).detach()
        boxes = yolox.decode(y[:, :4], *yolox.cells(SHAPES, y.device))
        score = y[:, 4:5].sigmoid() * y[:, 5:].sigmoid()
        for label, wanted in ((0, [30, 44, 14, 25]), (4, [12, 14, 18, 10])):
            best = int(score[:, label].argmax())
            self.assertGreater(float(score[best, label]), 0.6)
            np.testing.assert_allclose(boxes[best].numpy(), wanted, atol=1.5)


class InFolder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)

    def published(self):
        return tiny_set.make_yolox(self.root)


class Start(InFolder):
    def test_every_convolution_finds_its_place(self):
        path = self.published()
        full, six = yolox.CbamYolox(classes=80, attention=False), yolox.CbamYolox(attention=False)
        weights.load_yolox(full, str(path))
        weights.load_yolox(six, str(path))
        x = torch.rand(1, 3, 64, 96)
        a, b = full.eval()(x).detach(), six.eval()(x).detach()
        torch.testing.assert_close(b, a[..., [0, 1, 2, 3, 4, *(5 + i for i in (0, 1, 2, 3, 5, 7))]], atol=1e-6, rtol=1e-5)

    def test_blocks_of_pixels_are_a_larger_convolution(self):
        torch.manual_seed(1)
        blocks, x = torch.randn(16, 12, 3, 3), torch.rand(1, 3, 32, 48)  # red, green, blue of 0 to 1
        theirs = x.flip(1) * 255
        corners = [theirs[..., dy::2, dx::2] for dy, dx in ((0, 0), (1, 0), (0, 1), (1, 1))]
        wanted = torch.nn.functional.conv2d(torch.cat(corners, 1), blocks, padding=1)
        found = torch.nn.functional.conv2d(x, weights._whole_pixels(blocks), stride=2, padding=2)
        torch.testing.assert_close(found, wanted, atol=2e-3, rtol=1e-5)

    def test_another_file_is_told(self):
        import onnx
        import onnx.numpy_helper
        path = self.published()
        model = onnx.load(str(path))
        kept = list(model.graph.node)[:-1]
        del model.graph.node[:]
        model.graph.node.extend(kept)
        onnx.save(model, str(self.root / 'short.onnx'))
        with self.assertRaisesRegex(ValueError, 'short.onnx: 112 convolutions, YOLOX-Nano has 113'):
            weights.load_yolox(yolox.CbamYolox(), str(self.root / 'short.onnx'))
        model.graph.initializer[2].CopyFrom(onnx.numpy_helper.from_array(np.zeros((8, 1, 3, 3), np.float32),
                                                                        model.graph.initializer[2].name))
        model.graph.node.append(kept[-1])
        onnx.save(model, str(self.root / 'other.onnx'))
        with self.assertRaisesRegex(ValueError, r'other.onnx: convolution 1 is \(8, 1, 3, 3\), must be \(16, 1, 3, 3\)'):
            weights.load_yolox(yolox.CbamYolox(), str(self.root / 'other.onnx'))

    def test_with_attention_it_begins_as_nearly_the_same(self):
        path = self.published()
        torch.manual_seed(0)
        outputs = []
        for attention in (False, True):
            net = yolox.CbamYolox(attention=attention)
            weights.load_yolox(net, str(path))
            if attention:  # gates of a half everywhere: only a constant, which the next layers take up
                for block in net.cbam.values():
                    torch.nn.init.zeros_(block.mlp[2].weight)
                    torch.nn.init.zeros_(block.spatial.weight)
            outputs.append(net.eval()(torch.rand(1, 3, 64, 96, generator=torch.Generator().manual_seed(2))).detach())
        torch.testing.assert_close(outputs[1], outputs[0], atol=1e-4, rtol=1e-3)

    def test_its_attention_learns_at_ten_times_the_rate_and_the_first_layers_not(self):
        net = families.make('yolox', 'nano', True)
        rate = {id(p): g['lr'] for g in train.parameter_groups(net, 3, 1e-3, False, 10.0) for p in g['params']}
        self.assertAlmostEqual(rate[id(net.cbam['9'].spatial.weight)], 1e-2)
        self.assertAlmostEqual(rate[id(net.model[24].m[0].class_out.weight)], 1e-3)
        self.assertNotIn(id(net.model[1][0].conv.weight), rate)

    def test_the_published_file_says_the_same_through_opencv(self):
        shared = pathlib.Path(os.environ.get('GODWIT_SHARED_DIR', '')) / 'data' / 'detection'
        if not shared.is_dir():
            self.assertNotEqual(os.environ.get('CI'), 'true', 'shared data is missing')
            self.skipTest('GODWIT_SHARED_DIR has no weights of YOLOX')
        path = shared / 'models' / 'yolox_nano_416.onnx'
        net, theirs = yolox.CbamYolox(classes=80, attention=False), cv2.dnn.readNetFromONNX(str(path))
        weights.load_yolox(net, str(path))
        net.eval()
        for picture in sorted((shared / 'coco256' / 'images' / 'val2017').glob('*.jpg'))[:6]:
            image = cv2.resize(cv2.imread(str(picture)), (416, 416))
            theirs.setInput(np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32))
            with torch.no_grad():
                ours = net(torch.from_numpy(image[:, :, ::-1].copy()).permute(2, 0, 1)[None].float() / 255).numpy()
            np.testing.assert_allclose(ours, theirs.forward(), atol=2e-3, rtol=1e-3)


class Export(InFolder):
    def worst(self, net, file, width, height, count):
        rng = np.random.default_rng(5)
        return through_opencv.worst_difference(net, file, (
            cv2.GaussianBlur(cv2.resize(rng.integers(0, 255, (12, 16, 3), dtype=np.uint8), (width, height),
                                        interpolation=cv2.INTER_NEAREST), (5, 5), 1) for _ in range(count)))

    def test_a_network_says_the_same_through_opencv_whatever_its_input(self):
        for attention in (True, False):
            torch.manual_seed(1)
            net = yolox.CbamYolox(attention=attention)
            net.train()(torch.rand(2, 3, 64, 96))
            net.eval()
            held = {k: v.clone() for k, v in net.state_dict().items()}
            unfused = yolox.CbamYolox(attention=attention).eval()
            unfused.load_state_dict(held)
            net.fuse()
            for width, height in ((96, 64), (64, 128)):
                file = self.root / f'{width}x{height}.onnx'
                export.export_onnx(net, width, height, file)
                export.write_metadata(file, width, height, net.layout)
                self.assertLess(self.worst(unfused, file, width, height, 8), 1e-3)
                read = network.Network(file)
                self.assertEqual((read.width, read.height, read.yolox, read.centred), (width, height, True, True))
            again = weights.load_exported(str(file))
            self.assertEqual((again.name(), again.layout), (('cbam_' if attention else '') + 'yolox_nano', 'yolox'))
            for key, value in net.state_dict().items():
                self.assertTrue(torch.equal(again.state_dict()[key], value), key)

    def test_what_is_read_from_the_file_is_what_the_network_says(self):
        net = yolox.CbamYolox()
        net.train()(torch.rand(2, 3, 64, 96))
        net.eval()
        image = np.random.default_rng(0).integers(0, 255, (64, 96, 3), dtype=np.uint8)
        file = self.root / 'own.onnx'
        with torch.no_grad():
            for head in net.model[24].m:
                head.object_out.bias.fill_(2)
                head.class_out.bias.fill_(2)
            y = net.boxes(torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255)[0].numpy()
        net.fuse()
        export.export_onnx(net, 96, 64, file)
        export.write_metadata(file, 96, 64, 'yolox')
        boxes, scores = network.Network(file).detect(image, 0.0)
        self.assertEqual(len(boxes), len(y))
        np.testing.assert_allclose(scores, y[:, 4:5] * y[:, 5:], atol=1e-4)
        corners = np.concatenate((y[:, :2] - y[:, 2:4] / 2, y[:, :2] + y[:, 2:4] / 2), 1)
        np.testing.assert_allclose(boxes, np.clip(corners, 0, (96, 64, 96, 64)), atol=1e-2)

    def test_the_delivered_files_are_one_network(self):
        first = None
        for side in (416, 320):
            file = MODELS / f'yolox_nano_{side}.onnx'
            net = weights.load_exported(str(file))
            self.assertEqual((net.name(), net.layout), ('yolox_nano', 'yolox'))
            first = net.state_dict() if first is None else first
            self.assertTrue(all(torch.equal(first[k], v) for k, v in net.state_dict().items()))
            self.assertLess(self.worst(net, file, side, side, 12), 1e-3)

    def test_the_delivered_file_with_attention_says_the_same(self):
        file = MODELS / 'cbam_yolox_nano_416.onnx'
        net = weights.load_exported(str(file))
        self.assertEqual((net.name(), net.layout), ('cbam_yolox_nano', 'yolox'))
        self.assertLess(self.worst(net, file, 416, 416, 12), 1e-3)

    def test_the_delivered_files_are_what_was_published(self):
        shared = pathlib.Path(os.environ.get('GODWIT_SHARED_DIR', '')) / 'data' / 'detection'
        if not shared.is_dir():
            self.assertNotEqual(os.environ.get('CI'), 'true', 'shared data is missing')
            self.skipTest('GODWIT_SHARED_DIR has no weights of YOLOX')
        net = yolox.CbamYolox(attention=False)
        weights.load_yolox(net, str(shared / 'models' / 'yolox_nano_416.onnx'))
        net.eval().fuse()
        for key, value in weights.load_exported(str(MODELS / 'yolox_nano_416.onnx')).state_dict().items():
            torch.testing.assert_close(value, net.state_dict()[key], atol=1e-6, rtol=1e-6)


if __name__ == '__main__':
    unittest.main()
