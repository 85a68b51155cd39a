"""The training side without PyTorch: the split that keeps held-out pictures out, labels, views, rendered pictures."""
import json
import os
import pathlib
import sys
import tempfile
import unittest
import unittest.mock

import cv2
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
import augment  # noqa: E402
import data  # noqa: E402
import render  # noqa: E402
import split  # noqa: E402


class Split(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = pathlib.Path(self.folder.name)

    def tearDown(self):
        self.folder.cleanup()

    def touch(self, folder, stems):
        path = self.root / folder
        path.mkdir(parents=True, exist_ok=True)
        for stem in stems:
            (path / f'{stem}.jpg').touch()

    def test_last_fifth_of_every_flight_is_held_out(self):
        self.touch('aerial_cars/images', [f'MOS{i}' for i in (*range(74, 84), *range(155, 160))] + ['DJI_0005-0018'])
        held_out = split.names(self.root, 'aerial_cars', 'held_out')
        # 74..83 and 155..159 are two flights: the gap between them is wider than any inside.
        self.assertEqual(held_out, ['MOS159', 'MOS82', 'MOS83'])
        parts = {p: split.names(self.root, 'aerial_cars', p) for p in ('train', 'choose')}
        # Of the eight that are left of the first flight, the last chooses.
        self.assertEqual(parts['choose'], ['MOS81'])
        self.assertEqual(len(parts['train']), 12)
        self.assertFalse(set(parts['train']) & {*held_out, *parts['choose']})

    def test_flights_that_are_unseen_are_neither_trained_on_nor_choose(self):
        self.touch('cats_topdown/images', [f'{flight}_{i}' for flight in range(7) for i in range(1, 21)])
        self.touch('aerial_cars/images', [f'{flight}{i}' for flight in ('MunichStreet02-MOS', 'MOS') for i in range(74, 94)])
        for source, begins, seen in (('cats_topdown', ('5_', '6_'), 5), ('aerial_cars', ('MunichStreet',), 1)):
            for part in ('train', 'choose'):
                stems = split.names(self.root, source, part)
                self.assertFalse([s for s in stems if s.startswith(begins)])
                self.assertEqual(len(stems), seen * (14 if part == 'train' else 2))
            unseen = split.names(self.root, source, 'unseen')
            self.assertTrue(all(s.startswith(begins) for s in unseen))
            self.assertEqual(len(unseen), 20 * len(begins))

    def test_the_delivered_sets_have_parts_that_do_not_meet(self):
        shared = pathlib.Path(os.environ.get('GODWIT_SHARED_DIR', '')) / 'data' / 'detection'
        if not shared.is_dir():
            self.assertNotEqual(os.environ.get('CI'), 'true', 'shared data is missing')
            self.skipTest('GODWIT_SHARED_DIR has no detection pictures')
        for source in data.SETS:
            parts = {p: set(split.names(shared, source, p)) for p in split.PARTS}
            for learnt in ('train', 'choose'):
                self.assertTrue(parts[learnt], f'{source} {learnt}')
                for scored in ('held_out', 'unseen'):
                    self.assertFalse(parts[learnt] & parts[scored], f'{source} {learnt} {scored}')
            self.assertFalse(parts['train'] & parts['choose'], source)
            self.assertFalse(parts['train'] & split.SPRITE_SOURCES)
        for source, folders in split.UNSEEN.items():
            self.assertGreaterEqual(len(split.names(shared, source, 'unseen')), 20)

    def test_an_eighth_of_the_pictures_without_flight_chooses(self):
        self.touch('coco256/images/train2017', [f'{i:012}' for i in range(1, 17)])
        self.assertEqual(split.names(self.root, 'coco', 'choose'), ['000000000008', '000000000016'])
        self.assertEqual(len(split.names(self.root, 'coco', 'train')), 14)
        with self.assertRaisesRegex(ValueError, 'test: no part'):
            split.names(self.root, 'coco', 'test')

    def test_numbers_in_brackets_are_frame_numbers(self):
        self.touch('cats_topdown/images', [f'Drone2_({i})' for i in range(1, 11)])
        self.assertEqual(split.names(self.root, 'cats_topdown', 'held_out'), ['Drone2_(10)', 'Drone2_(9)'])

    def test_pictures_that_figures_are_cut_from_are_never_trained_on(self):
        for part in ('train2017', 'val2017'):
            self.touch(f'coco256/images/{part}', ['000000000009', '000000000113', '000000000241', '000000009483'])
        self.assertEqual(split.names(self.root, 'coco', 'train'), ['000000000009'])

    def test_labels_become_our_classes_and_the_rest_is_left_out(self):
        for sub in ('images', 'labels', 'ignore'):
            (self.root / 'visdrone_mini' / sub).mkdir(parents=True)
        (self.root / 'visdrone_mini' / 'train.list').write_text('a\n')
        cv2.imwrite(str(self.root / 'visdrone_mini' / 'images' / 'a.jpg'), np.zeros((100, 200, 3), np.uint8))
        (self.root / 'visdrone_mini' / 'labels' / 'a.txt').write_text(
            '1 0.5 0.5 0.1 0.2\n4 0.25 0.5 0.1 0.2\n6 0.75 0.5 0.1 0.2\n')
        (self.root / 'visdrone_mini' / 'ignore' / 'a.txt').write_text('0 0.1 0.1 0.1 0.1\n')
        picture, = data.load(self.root, 'visdrone', part='train')
        self.assertEqual(picture.labels.tolist(), [0, 2])  # people, van
        np.testing.assert_allclose(picture.boxes[0], [90, 40, 110, 60], atol=1e-4)
        self.assertEqual(len(picture.ignore), 2)  # the region, and a tricycle

        (self.root / 'visdrone_mini' / 'labels' / 'a.txt').write_text('1 0.5 0.5 0.1\n')
        with self.assertRaisesRegex(ValueError, 'a.txt: every line must hold 5 numbers'):
            data.load(self.root, 'visdrone', part='train')


    def one_picture(self, source, label):
        for sub in ('images', 'labels'):
            (self.root / source / sub).mkdir(parents=True)
        cv2.imwrite(str(self.root / source / 'images' / 'Drone1-1.jpg'), np.zeros((100, 200, 3), np.uint8))
        if label is not None:
            (self.root / source / 'labels' / 'Drone1-1.txt').write_text(label)
        return data.load(self.root, source, part='train')[0]

    def test_a_label_file_that_was_lost_is_no_empty_picture(self):
        with self.assertRaisesRegex(ValueError, 'Drone1-1.txt: no label file'):
            self.one_picture('cats_topdown', None)
        (self.root / 'coco256' / 'images' / 'train2017').mkdir(parents=True)
        for stem in ('000000000250', '000000000009'):  # the first is known to show none of the 80 classes
            cv2.imwrite(str(self.root / 'coco256' / 'images' / 'train2017' / f'{stem}.jpg'), np.zeros((9, 9, 3), np.uint8))
        with self.assertRaisesRegex(ValueError, '000000000009.txt: no label file'):
            data.load(self.root, 'coco', part='train')
        (self.root / 'coco256' / 'images' / 'train2017' / '000000000009.jpg').unlink()
        self.assertEqual(len(data.load(self.root, 'coco', part='train')), 1)

    def test_an_unknown_class_is_told(self):
        with self.assertRaisesRegex(ValueError, "Drone1-1.txt: class 5 is none of aerial_cars's 5"):
            self.one_picture('aerial_cars', '0 0.5 0.5 0.1 0.2\n5 0.5 0.5 0.1 0.2\n')

    def test_cut_vehicles_that_nobody_labelled_are_no_background(self):
        picture = self.one_picture('cats_topdown', '0 0.5 0.5 0.1 0.2\n')
        self.assertEqual(len(picture.boxes), 1)
        inside = lambda x, y: any(a <= x < c and b <= y < d for a, b, c, d in picture.ignore)  # noqa: E731
        for x, y in ((1, 50), (199, 50), (100, 1), (100, 99)):
            self.assertTrue(inside(x, y))
        self.assertFalse(inside(100, 50))
        self.assertFalse(inside(20, 50))
        # What is scored is not touched: figures stay comparable.
        with unittest.mock.patch.object(split, 'names', return_value=['Drone1-1']):
            self.assertEqual(len(data.load(self.root, 'cats_topdown', part='held_out')[0].ignore), 0)

    def test_a_quarter_of_the_views_is_visdrone(self):
        views = {}
        for step in range(12):
            sources = data.sources_of_step(step, 8)
            self.assertEqual(sources[0], ('coco', 4))
            for source, count in sources:
                views[source] = views.get(source, 0) + count
        self.assertEqual(views, {'coco': 48, 'visdrone': 24, 'aerial_cars': 16, 'cats_topdown': 8})

    def test_rendered_pictures_are_a_quarter_or_an_eighth_that_costs_vehicles_nothing(self):
        for batch in (8, 32):
            for eighths in (1, 2):
                views = dict(data.sources_of_step(2, batch, eighths))
                self.assertEqual(sum(views.values()), batch)
                self.assertEqual(views['simulated'] * 8, batch * eighths)
                self.assertEqual(list(views)[0], 'coco')
                without = dict(data.sources_of_step(2, batch))['cats_topdown']
                self.assertEqual(views['cats_topdown'] * eighths, without)
        for batch, simulated, wanted in ((6, 0, 4), (12, 1, 8), (12, 2, 8), (0, 0, 4)):
            with self.assertRaisesRegex(ValueError, f'multiple of {wanted}'):
                data.sources_of_step(0, batch, simulated)

    def test_from_free_pictures_alone_a_quarter_is_from_above(self):
        self.assertEqual(data.sources_of_step(1, 4, permissive=True), [('coco', 3), ('aerial_cars', 1)])
        self.assertEqual(data.sources_of_step(5, 16, 2, True), [('coco', 8), ('aerial_cars', 4), ('simulated', 4)])
        with self.assertRaisesRegex(ValueError, 'multiple of 4'):
            data.sources_of_step(0, 6, 2, True)
        self.assertEqual(data.sets_of(False), data.SETS)
        self.assertEqual(data.sets_of(True), ('coco', 'aerial_cars'))

    def test_the_digest_knows_every_change(self):
        def digest(**change):
            p = {'name': 'p', 'source': 'coco', 'image': np.zeros((4, 5, 3), np.uint8), 'boxes': np.float32([[0, 0, 2, 2]]),
                 'labels': np.array([0]), 'ignore': np.zeros((0, 4), np.float32), **change}
            return data.digest({'coco': [data.Picture(**p)]})

        image = np.zeros((4, 5, 3), np.uint8)
        image[1, 2, 0] = 1
        seen = {digest(), digest(image=image), digest(name='q'), digest(labels=np.array([2])),
                digest(boxes=np.float32([[0, 0, 2, 3]])), digest(ignore=np.float32([[0, 0, 1, 1]]))}
        self.assertEqual(len(seen), 6)
        self.assertEqual(digest(), digest())


def grey(image):
    return bool((image[..., 0] == image[..., 1]).all() and (image[..., 1] == image[..., 2]).all())


class Views(unittest.TestCase):
    def person(self):
        """A person in red on blue."""
        image = np.zeros((240, 320, 3), np.uint8)
        image[..., 2] = 90
        image[40:200, 120:180] = (200, 0, 0)
        return data.Picture('p', 'coco', image, np.float32([[120, 40, 180, 200]]), np.array([0]))

    def test_half_of_the_views_are_grey(self):
        views = [augment.single(self.person(), 64, 64, np.random.default_rng(seed)) for seed in range(300)]
        self.assertAlmostEqual(np.mean([grey(v.image) for v in views]), 0.5, delta=0.08)
        self.assertFalse([v for v in views if (v.plain != augment.BORDER).any() and grey(v.plain)])  # what a teacher sees

    def test_an_edge_cuts_people_in_every_way(self):
        ways = dict.fromkeys(('head', 'left', 'right'), 0)
        for seed in range(200):
            rng = np.random.default_rng(seed)
            with unittest.mock.patch.object(augment, '_colour', lambda image, _: image):
                v = augment.cut(self.person(), 128, 128, rng)
            if not len(v.labels):
                self.assertEqual(len(v.ignore), 1)  # too little is left of it to be learnt
                continue
            (x0, y0, x1, y1), = v.boxes
            ys, xs = np.nonzero(v.image[..., 0] > 150)
            np.testing.assert_allclose([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], [x0, y0, x1, y1], atol=2.1)
            edge = 0 if v.image[0, 0, 2] != augment.BORDER else 16  # of the picture, in its letterbox
            ways['head'] += int(abs(y0 - edge) < 1e-3)
            ways['left'] += int(x0 < 1e-3)
            ways['right'] += int(x1 > 128 - 1e-3)
        self.assertGreater(ways['head'], 60)
        self.assertGreater(ways['left'], 25)
        self.assertGreater(ways['right'], 25)

    def test_rendered_vehicles_are_cut_at_each_edge(self):
        edges = dict.fromkeys(range(4), 0)
        for seed in range(200):
            p = self.person()
            p.source, p.labels = 'simulated', np.array([5])
            v = augment.cut(p, 128, 128, np.random.default_rng(seed))
            for x0, y0, x1, y1 in v.boxes:
                border = 0 if y1 > 112.5 or y0 < 15.5 else 16
                for edge, far in enumerate((x0, y0 - border, 128 - x1, 128 - border - y1)):
                    edges[edge] += int(abs(far) < 1e-3)
        self.assertGreater(min(edges.values()), 20, edges)

    def test_a_part_that_shows_nothing_is_magnified(self):
        shows = 0
        for seed in range(60):
            with unittest.mock.patch.object(augment, '_colour', lambda image, _: image):
                v = augment.nothing(self.person(), 64, 64, np.random.default_rng(seed))
            self.assertEqual(v.image.shape, (64, 64, 3))
            if not len(v.boxes) and not len(v.ignore):
                shows += 1
                self.assertFalse((v.image[..., 0] > 0).any())  # nothing of the person, and no border
        self.assertGreater(shows, 55)

    def test_where_things_are_everywhere_the_view_is_as_any_other(self):
        p = self.person()
        p.boxes = np.float32([[0, 0, 320, 240]])
        v = augment.nothing(p, 64, 64, np.random.default_rng(0))
        self.assertEqual(len(v.boxes) + len(v.ignore), 1)

    def test_a_picture_without_people_is_not_cut(self):
        car = self.person()
        car.labels[:] = 2
        self.assertEqual(augment.cut(car, 64, 64, np.random.default_rng(0)).image.shape, (64, 64, 3))

    def test_a_box_stays_on_its_thing(self):
        image = np.zeros((300, 500, 3), np.uint8)
        image[100:160, 200:320] = 255
        box = np.float32([[200, 100, 320, 160]])
        picture = data.Picture('p', 'cats_topdown', image, box, np.array([data.VEHICLE]))
        for seed in range(40):
            rng = np.random.default_rng(seed)
            canvas = np.full((256, 256, 3), augment.BORDER, np.uint8)
            boxes, _, _ = augment._place(canvas, (0, 0, 256, 256), augment._turn(picture, rng),
                                         256 * rng.uniform(0.5, 1.5), rng)
            for x0, y0, x1, y1 in boxes:
                ys, xs = np.nonzero((canvas > 200).all(2))
                np.testing.assert_allclose([xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], [x0, y0, x1, y1], atol=1.6)


class Rendered(unittest.TestCase):
    ROWS = [{'kind': 'person', 'x0': '0', 'y0': '0', 'x1': '64', 'y1': '48', 'visible_px': '800'},
            {'kind': 'person', 'x0': '64', 'y0': '0', 'x1': '128', 'y1': '48', 'visible_px': '700'},
            {'kind': 'truck', 'x0': '320', 'y0': '240', 'x1': '640', 'y1': '480', 'visible_px': '70000'},
            {'kind': 'car', 'x0': '5', 'y0': '5', 'x1': '5', 'y1': '9', 'visible_px': '1'}]

    def test_a_thing_counts_where_enough_of_it_is_visible(self):
        learnt, left_out = render.sort_boxes(self.ROWS, 640, 480)
        self.assertEqual(learnt, ['0 0.050000 0.050000 0.100000 0.100000', '5 0.750000 0.750000 0.500000 0.500000'])
        self.assertEqual(left_out, ['0 0.150000 0.050000 0.100000 0.100000'])

    def test_a_flight_becomes_a_set(self):
        with tempfile.TemporaryDirectory() as folder:
            root = pathlib.Path(folder)
            (root / 'flight/mav0/cam0/data').mkdir(parents=True)
            for sub in ('images', 'labels', 'ignore'):
                (root / 'set' / sub).mkdir(parents=True)
            cv2.imwrite(str(root / 'flight/mav0/cam0/data/1500000000.jpg'), np.zeros((480, 640), np.uint8))
            cv2.imwrite(str(root / 'flight/mav0/cam0/data/2500000000.jpg'), np.zeros((480, 640), np.uint8))
            (root / 'flight/boxes.csv').write_text('t,mover,kind,moving,x0,y0,x1,y1,visible_px\n' + ''.join(
                f"1.500000000,7,{r['kind']},1,{r['x0']},{r['y0']},{r['x1']},{r['y1']},{r['visible_px']}\n" for r in self.ROWS))
            self.assertEqual(render.take(root / 'flight', 'own_3', 640, 480, root / 'set'), 2)
            first, second = data.load(root / 'set', 'simulated', 'train')
            self.assertEqual((first.name, first.labels.tolist(), len(first.ignore)), ('own_3_000', [0, 5], 1))
            np.testing.assert_allclose(first.boxes[1], [320, 240, 640, 480], atol=0.01)
            self.assertEqual((second.name, len(second.labels)), ('own_3_001', 0))
            (root / 'flight/mav0/cam0/data/3500000000.jpg').write_bytes(
                (root / 'flight/mav0/cam0/data/1500000000.jpg').read_bytes())
            for sub in ('images', 'labels', 'ignore'):
                (root / 'few' / sub).mkdir(parents=True)
            self.assertEqual(render.take(root / 'flight', 'own_3', 640, 480, root / 'few', every=2, quality=10), 2)
            self.assertEqual([p.stem for p in sorted((root / 'few' / 'images').iterdir())], ['own_3_000', 'own_3_002'])
            self.assertLess((root / 'few' / 'images' / 'own_3_000.jpg').stat().st_size,
                            (root / 'set' / 'images' / 'own_3_000.jpg').stat().st_size)
            data.leave_out_smaller([first], 65)
            self.assertEqual((first.labels.tolist(), len(first.ignore)), ([5], 2))

    def test_what_flies_is_never_trained_on(self):
        own = {p.stem for p in render.scenarios_of(flown=False)}
        self.assertGreaterEqual(len(own), 5)
        self.assertFalse(own & {p.stem for p in (render.HERE.parents[1] / 'config' / 'scenarios').glob('*.toml')})
        self.assertEqual([p.stem for p in render.scenarios_of(flown=True) if p.exists()], list(render.FLOWN))
        self.assertEqual([p.stem for p in render.scenarios_of(False, ['roofs', 'evening'])], ['roofs', 'evening'])
        with self.assertRaisesRegex(ValueError, 'no scenario street; there are .*roofs'):
            render.scenarios_of(False, ['roofs', 'street'])
        with tempfile.TemporaryDirectory() as folder:
            purpose = pathlib.Path(folder) / 'purpose.json'
            for told, refused in (({'for': 'training', 'scenarios': ['roofs']}, False),
                                  ({'for': 'scoring', 'scenarios': ['roofs']}, True),
                                  ({'for': 'training', 'scenarios': ['roofs', 'night']}, True)):
                purpose.write_text(json.dumps(told))
                if refused:
                    with self.assertRaisesRegex(ValueError, 'not to be trained on'):
                        render.check_to_train_on(pathlib.Path(folder))
                else:
                    render.check_to_train_on(pathlib.Path(folder))

    def test_every_scenario_has_its_pictures_a_second_apart(self):
        for scenario in (*render.scenarios_of(True), *render.scenarios_of(False)):
            text = render.at_one_a_second(scenario.read_text())
            self.assertIn('\nfps = 1', text)
            self.assertEqual((render.side(text, 'width'), render.side(text, 'height')), (640, 480))
        with self.assertRaisesRegex(ValueError, 'one line fps'):
            render.at_one_a_second('fx = 3\n')


if __name__ == '__main__':
    unittest.main()
