"""What needs PyTorch of the training side, part one: loss, attention, where weights come from."""
import pathlib
import sys
import tempfile
import unittest
import unittest.mock

import numpy as np
import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import choose  # noqa: E402
import data  # noqa: E402
import loss  # noqa: E402
import model  # noqa: E402
import tiny_set  # noqa: E402
import train  # noqa: E402
import weights  # noqa: E402
from model import CbamYolov5  # noqa: E402

CLASSES = 6


def box(*values):
    return torch.tensor([values], dtype=torch.float32)


class Assignment(unittest.TestCase):
    def places(self, b, level=0, ny=8, nx=8):
        _, anchor, row, column = loss.assign(b, level, ny, nx)
        return set(zip(anchor.tolist(), row.tolist(), column.tolist()))

    def test_a_box_has_its_cell_and_its_two_nearest_neighbours(self):
        # 12 x 14 at (26, 45), stride 8: cell (row 5, column 3), 0.25 of it from the left, 0.625 from the top.
        anchors = [i for i, (w, h) in enumerate(model.ANCHORS[0]) if max(12 / w, w / 12, 14 / h, h / 14) < loss.SHAPE_RATIO]
        self.assertEqual(anchors, [0, 1, 2])
        wanted = {(a, r, c) for a in anchors for r, c in ((5, 3), (5, 2), (6, 3))}
        self.assertEqual(self.places(box(26, 45, 12, 14)), wanted)

    def test_neighbours_outside_the_map_are_left_out(self):
        self.assertEqual({(r, c) for _, r, c in self.places(box(1, 63, 12, 14))}, {(7, 0)})

    def test_a_box_is_learnt_where_its_shape_is(self):
        small, large = box(30, 30, 6, 6), box(200, 200, 300, 300)
        self.assertTrue(self.places(small))
        self.assertFalse(self.places(small, level=2))
        self.assertTrue(self.places(large, level=2, ny=13, nx=13))
        self.assertFalse(self.places(large, ny=52, nx=52))

    def test_boxes_that_match_no_anchor_are_passed_over(self):
        thin = box(100, 100, 2, 300)
        for level in range(3):
            self.assertFalse(self.places(thin, level, 20, 20))
        self.assertEqual([len(v) for v in loss.assign(torch.zeros(0, 4), 0, 8, 8)], [0] * 4)

    def test_the_complete_overlap_is_one_on_itself_and_falls_with_distance(self):
        a = box(50, 50, 20, 30)
        self.assertAlmostEqual(float(loss.complete_iou(a, a)), 1, places=5)
        values = [float(loss.complete_iou(a, box(50 + d, 50, 20, 30))) for d in (0, 5, 30, 60)]
        self.assertEqual(values, sorted(values, reverse=True))
        self.assertLess(values[3], 0)
        # Overlap 1/2 at one centre, diagonal shared: only the aspect is paid for beyond it.
        self.assertLess(float(loss.complete_iou(box(50, 50, 40, 30), a)), 0.5)


class Loss(unittest.TestCase):
    def raw(self, batch=1, size=64, value=0.0):
        return [torch.full((batch, 3, size // s, size // s, 5 + CLASSES), value, requires_grad=True) for s in (8, 16, 32)]

    def gradients(self, targets, ignore=(), raw=None, teacher=None, taught=0):
        raw = self.raw() if raw is None else raw
        total, parts = loss.detection_loss(raw, torch.tensor(targets, dtype=torch.float32).reshape(-1, 6),
                                           torch.tensor(ignore, dtype=torch.float32).reshape(-1, 5), teacher, taught)
        total.backward()
        return [y.grad for y in raw], {k: float(v) for k, v in parts.items()}

    def wanted_objectness(self, gradient, level, value=0.0):
        """What the loss wants at each anchor, read from its gradient."""
        share = loss.OBJECT_GAIN * loss.OBJECT_BALANCE[level] / gradient[..., 4].numel() * gradient.shape[0]
        return torch.sigmoid(torch.tensor(value)) - gradient[..., 4] / share

    def test_without_boxes_everything_is_background(self):
        gradients, parts = self.gradients([])
        self.assertEqual((parts['box'], parts['class'], parts['distil']), (0, 0, 0))
        for level, g in enumerate(gradients):
            torch.testing.assert_close(self.wanted_objectness(g, level), torch.zeros_like(g[..., 4]), atol=1e-5, rtol=0)

    def test_a_box_without_anchor_is_background_and_no_failure(self):
        gradients, parts = self.gradients([[0, 2, 32, 32, 1.5, 60]])
        self.assertEqual((parts['box'], parts['class']), (0, 0))
        self.assertTrue(all(torch.isfinite(g).all() for g in gradients))

    def test_two_boxes_on_one_cell_both_count_and_the_better_fit_sets_the_objectness(self):
        # At zero, the anchor of 10 x 13 says a box of just that size half a cell beyond its cell's corner: (28, 44).
        exact, other = [0, 2, 28, 44, 10, 13], [0, 0, 28, 44, 22, 28]
        results = [self.gradients(rows) for rows in ([exact, other], [other, exact])]
        for gradients, parts in results:
            self.assertAlmostEqual(float(self.wanted_objectness(gradients[0], 0)[0, 0, 5, 3]), 1, places=3)
            g = gradients[0][0, 0, 5, 3, 5:]
            # Person and car are both wanted and both unwanted: neither moves, all others go down.
            self.assertAlmostEqual(float(g[0]), 0, places=6)
            self.assertAlmostEqual(float(g[2]), 0, places=6)
            self.assertGreater(float(g[3]), 0)
        for a, b in zip(results[0][0], results[1][0]):
            torch.testing.assert_close(a, b, atol=1e-7, rtol=1e-5)
        self.assertAlmostEqual(results[0][1]['box'], results[1][1]['box'], places=5)

    def test_a_vehicle_of_unknown_kind_may_be_a_bus(self):
        gradients, _ = self.gradients([[0, data.VEHICLE, 28, 44, 10, 13]])
        g = gradients[0][0, 0, 5, 3, 5:]
        self.assertLess(float(g[2]), 0)
        self.assertEqual((float(g[4]), float(g[5])), (0, 0))
        self.assertGreater(float(g[0]), 0)

    def test_nothing_is_learnt_in_an_ignored_region_but_what_is_labelled(self):
        gradients, _ = self.gradients([[0, 0, 28, 44, 10, 13]], ignore=[[0, 0, 32, 32, 64]])
        objectness = gradients[0][0, :, :, :, 4]
        self.assertEqual(float(objectness[:, 4:, :2].abs().sum()), 0)
        self.assertGreater(float(objectness[:, :4].abs().min()), 0)
        self.assertLess(float(objectness[0, 5, 3]), 0)

    def test_what_the_teacher_sees_is_an_object(self):
        teacher = [torch.full(y.shape, -9.0) for y in self.raw(2)]
        teacher[0][0, 1, 2, 3, 4] = 4.0
        gradients, parts = self.gradients([], raw=self.raw(2), teacher=teacher[:1] and [t[:1] for t in teacher], taught=1)
        wanted = self.wanted_objectness(gradients[0], 0)
        self.assertAlmostEqual(float(wanted[0, 1, 2, 3]), 0.982, places=3)
        self.assertAlmostEqual(float(wanted[1, 1, 2, 3]), 0, places=3)
        self.assertGreater(parts['distil'], 0)

    def test_it_falls_where_a_box_is_learnt(self):
        torch.manual_seed(0)
        raw = self.raw()
        optimiser = torch.optim.Adam(raw, lr=0.1)
        targets, ignore = torch.tensor([[0, 0, 30.0, 44, 14, 25]]), torch.zeros(0, 5)
        values = []
        for _ in range(40):
            total, _ = loss.detection_loss(raw, targets, ignore, None, 0)
            optimiser.zero_grad()
            total.backward()
            optimiser.step()
            values.append(float(total))
        self.assertLess(values[-1], 0.2 * values[0])
        best = torch.cat([model.decode_level(y, i).reshape(-1, 5 + CLASSES) for i, y in enumerate(raw)]).detach()
        sure = best[best[:, 4].argmax()]
        np.testing.assert_allclose(sure[:4].numpy(), [30, 44, 14, 25], atol=1.5)
        self.assertEqual(int(sure[5:].argmax()), 0)


class Attention(unittest.TestCase):
    def test_its_gates_begin_with_a_slope_of_their_own(self):
        # With zero last layers nothing before them was learnt, and the gates stayed constants.
        torch.manual_seed(0)
        block = model.Cbam(64)
        block(torch.rand(2, 64, 8, 8)).square().mean().backward()
        for name, p in block.named_parameters():
            if name != 'mlp.0.bias':
                self.assertGreater(float(p.grad.abs().max()), 0, name)

    def test_it_begins_by_what_is_seen(self):
        # With weights of a guessed size the units between were silent for every picture, and the gates stayed constants.
        rng = np.random.default_rng(1)
        for level in (0.01, 1.0, 30.0):  # whatever size the maps are of
            torch.manual_seed(0)
            block = model.Cbam(64)
            x = torch.from_numpy(rng.gamma(0.5, level, (8, 64, 12, 16)).astype(np.float32))
            x *= torch.from_numpy(rng.uniform(0.5, 1.5, (8, 64, 1, 1)).astype(np.float32))  # pictures differ
            block.begin(x, 0.25)
            channel, spatial = block.gates(x)
            self.assertAlmostEqual(float(channel.std(0, unbiased=False).mean()), 0.25 / 4, delta=0.004)
            self.assertAlmostEqual(float(spatial.std(unbiased=False)), 0.25 / 4, delta=0.004)
            np.testing.assert_allclose(channel.mean(0).flatten().detach(), 0.5, atol=0.01)
            self.assertAlmostEqual(float(spatial.mean()), 0.5, delta=0.01)
            pools = torch.cat((x.mean((2, 3)), x.amax((2, 3))))[:, :, None, None]
            units = torch.relu(block.mlp[0](pools)).flatten(1)
            self.assertGreater(float(units.std(0).min()), 0.1)  # none is silent

    def test_blocks_begin_one_after_the_other_and_only_attention_changes(self):
        torch.manual_seed(0)
        net, other = CbamYolov5('n').eval(), CbamYolov5('n').eval()
        for key, value in other.cbam.state_dict().items():  # whatever was drawn before
            self.assertTrue(torch.equal(net.cbam.state_dict()[key], value), key)
        for module in net.modules():  # norms of what is seen, or nothing of it reaches the deep layers
            if isinstance(module, torch.nn.BatchNorm2d):
                module.momentum = 1.0
        x = torch.rand(4, 3, 96, 128) * torch.rand(4, 1, 1, 1)
        net.train()(x)
        before = {k: v.clone() for k, v in net.state_dict().items()}
        net.eval().begin_attention(x)
        changed = {k for k, v in net.state_dict().items() if not torch.equal(v, before[k])}
        self.assertEqual(changed, {k for k in before if k.startswith('cbam.')})
        held = {}
        for key, block in net.cbam.items():
            block.register_forward_pre_hook(lambda b, seen, key=key: held.__setitem__(key, b.gates(seen[0])))
        net.features(x)
        for key, (channel, spatial) in held.items():  # each measured behind the gates before it, as they now are
            self.assertAlmostEqual(float(spatial.mean()), 0.5, delta=0.01)
            self.assertAlmostEqual(float(channel.mean()), 0.5, delta=0.01)

    def test_the_start_is_nearly_that_of_the_network_without(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            tiny_set.make_coco_arrays(root)
            arrays = str(root / 'models' / 'yolov5n_coco_state.npz')
            x = torch.rand(2, 3, 64, 96)
            outputs = {}
            for attention, gate_weights in ((False, 0.3), (True, 0.0), (True, 0.3)):
                with unittest.mock.patch.object(model, '_GATE_WEIGHTS', gate_weights):
                    net = CbamYolov5('n', attention=attention)
                weights.load_coco(net, arrays)
                outputs[attention, gate_weights] = net.eval()(x).detach()
        plain = outputs[False, 0.3]
        self.assertEqual(plain.shape, (2, 3 * (8 * 12 + 4 * 6 + 2 * 3), 11))
        torch.testing.assert_close(outputs[True, 0.0], plain, atol=2e-3, rtol=1e-3)
        self.assertGreater(float((outputs[True, 0.3] - plain).abs().max()), 1e-4)

    def test_it_learns_at_a_rate_of_its_own(self):
        for share in (0.3, 1.0, 10.0):  # of which the second is also that of other layers
            net = CbamYolov5('n')
            groups = train.parameter_groups(net, 3, 1e-3, False, share)
            rate = {id(p): g['lr'] for g in groups for p in g['params']}
            decay = {id(p): g['weight_decay'] for g in groups for p in g['params']}
            self.assertAlmostEqual(rate[id(net.cbam['4'].spatial.weight)], share * 1e-3)
            self.assertEqual(decay[id(net.cbam['4'].spatial.weight)], 0)
            self.assertGreater(decay[id(net.model[24].m[0].weight)], 0)
            self.assertAlmostEqual(rate[id(net.model[24].m[0].weight)], 1e-3)
            self.assertAlmostEqual(rate[id(net.model[13].cv1.conv.weight)], 5e-4)
            self.assertNotIn(id(net.model[0].conv.weight), rate)
            self.assertEqual(sum(p.requires_grad for p in net.parameters()), len(rate))
            every = train.parameter_groups(CbamYolov5('n'), 0, 1e-3, True, share)
            self.assertEqual({g['lr'] for g in every}, {share * 1e-3, 1e-3})

    def test_with_and_without_it_a_run_from_nothing_begins_alike(self):
        states = []
        for attention in (True, False):
            torch.manual_seed(7)
            states.append(CbamYolov5('n', attention=attention).state_dict())
        for key, value in states[1].items():
            self.assertTrue(torch.equal(states[0][key], value), key)

    def test_the_spread_of_gates_is_that_of_what_they_see(self):
        torch.manual_seed(0)
        net = CbamYolov5('n').eval()
        rng = np.random.default_rng(0)
        pictures = {'coco': [data.Picture(str(i), 'coco', rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) // (i + 1),
                                          np.zeros((0, 4)), np.zeros(0)) for i in range(3)]}
        for module in net.modules():  # norms of what is seen, or nothing of it reaches the deep layers
            if isinstance(module, torch.nn.BatchNorm2d):
                module.momentum = 1.0
        net.train()(torch.rand(4, 3, 96, 128))
        net.eval()
        cpu = torch.device('cpu')
        moving = choose.gate_spreads(net, pictures, cpu)
        self.assertEqual(set(moving), {f'{k} {g}' for k in (4, 6, 9) for g in ('channel', 'spatial')})
        self.assertGreater(min(moving.values()), 0)
        with torch.no_grad():
            for block in net.cbam.values():  # other constants for other channels are constants all the same
                block.mlp[2].weight.zero_()
                block.mlp[2].bias.normal_()
                block.spatial.weight.zero_()
        self.assertLess(max(choose.gate_spreads(net, pictures, cpu).values()), 1e-6)
        self.assertEqual(choose.gate_spreads(CbamYolov5('n', attention=False).eval(), pictures, cpu), {})

    def test_one_kind_of_gate_is_half_of_a_cbam(self):
        self.assertEqual(choose.spread({'4 channel': 0.5, '6 channel': 0.3, '4 spatial': 0.02, '6 spatial': 0.04}), 0.03)
        self.assertEqual(choose.spread({}), 0)


class Start(unittest.TestCase):
    def test_arrays_that_are_not_all_there_are_named(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            tiny_set.make_coco_arrays(root)
            held = dict(np.load(root / 'models' / 'yolov5n_coco_state.npz'))
            del held['model.3.conv.weight']
            np.savez(root / 'short.npz', **held)
            with self.assertRaisesRegex(ValueError, 'short.npz: missing .*model.3.conv.weight'):
                weights.load_coco(CbamYolov5('n'), str(root / 'short.npz'))


if __name__ == '__main__':
    unittest.main()
