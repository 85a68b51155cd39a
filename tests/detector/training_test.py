"""The training side without PyTorch: the split that keeps held-out pictures out, labels, and the figures' arithmetic."""
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
import evaluate  # noqa: E402
import metrics  # noqa: E402


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
        held_out = data.names(self.root, 'aerial_cars', True)
        # 74..83 and 155..159 are two flights: the gap between them is wider than any inside.
        self.assertEqual(held_out, ['MOS159', 'MOS82', 'MOS83'])
        train = data.names(self.root, 'aerial_cars', False)
        self.assertEqual(len(train), 13)
        self.assertFalse(set(train) & set(held_out))

    def test_numbers_in_brackets_are_frame_numbers(self):
        self.touch('cats_topdown/images', [f'Drone2_({i})' for i in range(1, 11)])
        self.assertEqual(data.names(self.root, 'cats_topdown', True), ['Drone2_(10)', 'Drone2_(9)'])

    def test_pictures_that_figures_are_cut_from_are_never_trained_on(self):
        for part in ('train2017', 'val2017'):
            self.touch(f'coco256/images/{part}', ['000000000009', '000000000113', '000000000241', '000000009483'])
        self.assertEqual(data.names(self.root, 'coco', False), ['000000000009'])

    def test_labels_become_our_classes_and_the_rest_is_left_out(self):
        for sub in ('images', 'labels', 'ignore'):
            (self.root / 'visdrone_mini' / sub).mkdir(parents=True)
        (self.root / 'visdrone_mini' / 'train.list').write_text('a\n')
        cv2.imwrite(str(self.root / 'visdrone_mini' / 'images' / 'a.jpg'), np.zeros((100, 200, 3), np.uint8))
        (self.root / 'visdrone_mini' / 'labels' / 'a.txt').write_text(
            '1 0.5 0.5 0.1 0.2\n4 0.25 0.5 0.1 0.2\n6 0.75 0.5 0.1 0.2\n')
        (self.root / 'visdrone_mini' / 'ignore' / 'a.txt').write_text('0 0.1 0.1 0.1 0.1\n')
        picture, = data.load(self.root, 'visdrone', held_out=False)
        self.assertEqual(picture.labels.tolist(), [0, 2])  # people, van
        np.testing.assert_allclose(picture.boxes[0], [90, 40, 110, 60], atol=1e-4)
        self.assertEqual(len(picture.ignore), 2)  # the region, and a tricycle

        (self.root / 'visdrone_mini' / 'labels' / 'a.txt').write_text('1 0.5 0.5 0.1\n')
        with self.assertRaisesRegex(ValueError, 'a.txt: every line must hold 5 numbers'):
            data.load(self.root, 'visdrone', held_out=False)


    def one_picture(self, source, label):
        for sub in ('images', 'labels'):
            (self.root / source / sub).mkdir(parents=True)
        cv2.imwrite(str(self.root / source / 'images' / 'Drone1-1.jpg'), np.zeros((100, 200, 3), np.uint8))
        if label is not None:
            (self.root / source / 'labels' / 'Drone1-1.txt').write_text(label)
        return data.load(self.root, source, held_out=False)[0]

    def test_a_label_file_that_was_lost_is_no_empty_picture(self):
        with self.assertRaisesRegex(ValueError, 'Drone1-1.txt: no label file'):
            self.one_picture('cats_topdown', None)
        (self.root / 'coco256' / 'images' / 'train2017').mkdir(parents=True)
        for stem in ('000000000250', '000000000009'):  # the first is known to show none of the 80 classes
            cv2.imwrite(str(self.root / 'coco256' / 'images' / 'train2017' / f'{stem}.jpg'), np.zeros((9, 9, 3), np.uint8))
        with self.assertRaisesRegex(ValueError, '000000000009.txt: no label file'):
            data.load(self.root, 'coco', held_out=False)
        (self.root / 'coco256' / 'images' / 'train2017' / '000000000009.jpg').unlink()
        self.assertEqual(len(data.load(self.root, 'coco', held_out=False)), 1)

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
        with unittest.mock.patch.object(data, 'names', return_value=['Drone1-1']):
            self.assertEqual(len(data.load(self.root, 'cats_topdown', held_out=True)[0].ignore), 0)

    def test_a_quarter_of_the_views_is_visdrone(self):
        views = {}
        for step in range(12):
            sources = data.sources_of_step(step, 8)
            self.assertEqual(sources[0], ('coco', 4))
            for source, count in sources:
                views[source] = views.get(source, 0) + count
        self.assertEqual(views, {'coco': 48, 'visdrone': 24, 'aerial_cars': 16, 'cats_topdown': 8})


class Views(unittest.TestCase):
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


class Figures(unittest.TestCase):
    def score(self, boxes, scores, truth, ignore=()):
        c = metrics.ClassScore()
        as_boxes = lambda b: np.array(b, np.float32).reshape(-1, 4)  # noqa: E731
        c.add(as_boxes(boxes), np.array(scores, np.float32), as_boxes(truth), as_boxes(ignore))
        return c

    def test_all_right_is_one(self):
        b = [[0, 0, 10, 10], [20, 20, 40, 40]]
        np.testing.assert_allclose(self.score(b, [0.9, 0.8], b).average_precision(), 1)

    def test_a_wrong_box_above_a_right_one_halves_the_precision(self):
        c = self.score([[50, 50, 60, 60], [0, 0, 10, 10]], [0.9, 0.8], [[0, 0, 10, 10]])
        self.assertAlmostEqual(c.average_precision()[0], 0.5)

    def test_a_second_box_on_one_thing_is_wrong(self):
        c = self.score([[0, 0, 10, 10], [0, 0, 10, 10]], [0.9, 0.8], [[0, 0, 10, 10]])
        precision = c.curves()[1]
        np.testing.assert_allclose(precision, [1, 0.5])

    def test_a_miss_halves_the_recall(self):
        c = self.score([[0, 0, 10, 10]], [0.9], [[0, 0, 10, 10], [20, 20, 40, 40]])
        self.assertAlmostEqual(c.average_precision()[0], 51 / 101)

    def test_ignored_regions_count_neither_way(self):
        c = self.score([[50, 50, 60, 60], [0, 0, 10, 10]], [0.9, 0.8], [[0, 0, 10, 10]], [[45, 45, 65, 65]])
        self.assertAlmostEqual(c.average_precision()[0], 1)

    def test_suppression_is_by_class(self):
        boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [0, 0, 10, 10]], float)
        kept = metrics.nms(boxes, np.array([0.5, 0.9, 0.4]), np.array([0, 0, 1]))
        self.assertEqual(kept.tolist(), [1, 2])


class AsFlown(unittest.TestCase):
    def network(self, boxes, scores):
        network = object.__new__(evaluate.Network)
        network.tiled = False

        def look(image, threshold):
            b, s = np.array(boxes, float), np.array(scores, float)
            sure = s.max(1) > threshold
            return b[sure], s[sure]

        network._look = look
        return network

    def picture(self, boxes, labels):
        return data.Picture('p', 'coco', np.zeros((100, 200, 3), np.uint8), np.float32(boxes), np.array(labels))

    def test_only_what_flies_is_counted(self):
        person = lambda score: [score, 0, 0, 0, 0, 0]  # noqa: E731
        found = self.network([[10, 10, 50, 90], [12, 10, 60, 90], [100, 10, 140, 90], [150, 10, 190, 90]],
                             [person(0.9), person(0.8), person(0.3), person(0.2)])
        # The second is suppressed at 0.45, the third is nobody, the fourth not sure enough: one of two.
        picture = self.picture([[10, 10, 50, 90], [150, 10, 190, 90]], [0, 0])
        f = evaluate.score_as_flown(found, [picture])['person']
        self.assertEqual((f['P'], f['R'], f['boxes'], f['objects']), (0.5, 0.5, 2, 2))
        self.assertEqual(evaluate.score_as_flown(found, [picture], score=0.1)['person']['R'], 1)

    def test_suppression_is_that_of_flight(self):
        both = self.network([[0, 0, 100, 100], [33, 0, 133, 100]], [[0.9, 0, 0, 0, 0, 0], [0.8, 0, 0, 0, 0, 0]])
        picture = self.picture([[0, 0, 100, 100]], [0])  # they overlap by 0.504: two at 0.6, one in flight
        self.assertEqual(evaluate.score_as_flown(both, [picture])['person']['P'], 1)

    def test_a_row_is_of_its_best_class(self):
        f = evaluate.score_as_flown(self.network([[10, 10, 50, 50]], [[0, 0, 0.9, 0, 0.5, 0]]),
                                    [self.picture([[10, 10, 50, 50]], [2])])
        self.assertEqual(f['vehicle']['P'], 1)
        self.assertNotIn('bus', f)

    def test_what_the_edge_cuts_is_told_apart(self):
        found = self.network([[50, 10, 90, 90]], [[0.9, 0, 0, 0, 0, 0]])
        f = evaluate.score_as_flown(found, [self.picture([[50, 10, 90, 90], [160, 20, 200, 90]], [0, 0])])
        self.assertEqual((f['person']['R'], f['person at the edge']['R'], f['person at the edge']['objects']), (0.5, 0, 1))

    def test_the_figures_are_those_of_the_flying_code(self):
        header = (pathlib.Path(evaluate.__file__).resolve().parents[1] / 'decode.h').read_text()
        self.assertIn(f'score_threshold = {evaluate.FLYING_SCORE}F;', header)
        self.assertIn(f'nms_iou = {evaluate.FLYING_OVERLAP}F;', header)


class Tiles(unittest.TestCase):
    def test_the_squares_are_those_that_fly(self):
        # As in tiles_test.cpp.
        self.assertEqual(evaluate.square_tiles(1280, 720), [(x, 0, 720, 720) for x in (0, 280, 560)])
        self.assertEqual(evaluate.square_tiles(720, 1280)[2], (0, 560, 720, 720))
        self.assertEqual(evaluate.square_tiles(416, 416), [])

    def test_a_thing_cut_off_by_a_square_is_left_to_the_others(self):
        network = object.__new__(evaluate.Network)
        network.tiled = True
        bright = []

        def look(image, threshold):
            columns = np.flatnonzero(image.max((0, 2)))
            bright.append(image.shape)
            if not len(columns):
                return np.zeros((0, 4)), np.zeros((0, 6))
            return np.array([[columns[0], 0, columns[-1] + 1, image.shape[0]]], float), np.full((1, 6), 0.5)

        network._look = look
        picture = np.zeros((100, 200, 3), np.uint8)
        picture[40:60, 95:105] = 255  # cut by the first and the last of three squares
        boxes, scores = network.detect(picture, 0.1)
        self.assertEqual(bright, [(100, 200, 3)] + [(100, 100, 3)] * 3)
        self.assertEqual(boxes.tolist(), [[95, 0, 105, 100]] * 2)
        self.assertEqual(scores.shape, (2, 6))


if __name__ == '__main__':
    unittest.main()
