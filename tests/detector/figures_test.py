"""The arithmetic of the detector's figures, without PyTorch: precision and recall, as flown, tiles, draws of the pictures."""
import pathlib
import sys
import tempfile
import unittest

import cv2
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / 'detector' / 'training'))
import augment  # noqa: E402
import bootstrap  # noqa: E402
import data  # noqa: E402
import evaluate  # noqa: E402
import metrics  # noqa: E402
import network  # noqa: E402
import scoring  # noqa: E402

MODELS = pathlib.Path(network.__file__).resolve().parents[1] / 'models'


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
        net = object.__new__(network.Network)
        net.tiled = False

        def look(image, threshold):
            b, s = np.array(boxes, float), np.array(scores, float)
            sure = s.max(1) > threshold
            return b[sure], s[sure]

        net._look = look
        return net

    def picture(self, boxes, labels):
        return data.Picture('p', 'coco', np.zeros((100, 200, 3), np.uint8), np.float32(boxes), np.array(labels))

    def test_only_what_flies_is_counted(self):
        person = lambda score: [score, 0, 0, 0, 0, 0]  # noqa: E731
        found = self.network([[10, 10, 50, 90], [12, 10, 60, 90], [100, 10, 140, 90], [150, 10, 190, 90]],
                             [person(0.9), person(0.8), person(0.3), person(0.2)])
        # The second is suppressed at 0.45, the third is nobody, the fourth not sure enough: one of two.
        picture = self.picture([[10, 10, 50, 90], [150, 10, 190, 90]], [0, 0])
        f = scoring.score_as_flown(found, [picture])['person']
        self.assertEqual((f['P'], f['R'], f['boxes'], f['objects']), (0.5, 0.5, 2, 2))
        self.assertEqual(scoring.score_as_flown(found, [picture], score=0.1)['person']['R'], 1)

    def test_suppression_is_that_of_flight(self):
        both = self.network([[0, 0, 100, 100], [33, 0, 133, 100]], [[0.9, 0, 0, 0, 0, 0], [0.8, 0, 0, 0, 0, 0]])
        picture = self.picture([[0, 0, 100, 100]], [0])  # they overlap by 0.504: two at 0.6, one in flight
        self.assertEqual(scoring.score_as_flown(both, [picture])['person']['P'], 1)

    def test_a_row_is_of_its_best_class(self):
        f = scoring.score_as_flown(self.network([[10, 10, 50, 50]], [[0, 0, 0.9, 0, 0.5, 0]]),
                                    [self.picture([[10, 10, 50, 50]], [2])])
        self.assertEqual(f['vehicle']['P'], 1)
        self.assertNotIn('bus', f)

    def test_what_the_edge_cuts_is_told_apart(self):
        found = self.network([[50, 10, 90, 90]], [[0.9, 0, 0, 0, 0, 0]])
        f = scoring.score_as_flown(found, [self.picture([[50, 10, 90, 90], [160, 20, 200, 90]], [0, 0])])
        self.assertEqual((f['person']['R'], f['person at the edge']['R'], f['person at the edge']['objects']), (0.5, 0, 1))

    def test_the_figures_are_those_of_the_flying_code(self):
        header = (pathlib.Path(scoring.__file__).resolve().parents[1] / 'decode.h').read_text()
        self.assertIn(f'score_threshold = {scoring.FLYING_SCORE}F;', header)
        self.assertIn(f'nms_iou = {scoring.FLYING_OVERLAP}F;', header)


class Tiles(unittest.TestCase):
    def test_the_squares_are_those_that_fly(self):
        # As in tiles_test.cpp.
        self.assertEqual(network.square_tiles(1280, 720), [(x, 0, 720, 720) for x in (0, 280, 560)])
        self.assertEqual(network.square_tiles(720, 1280)[2], (0, 560, 720, 720))
        self.assertEqual(network.square_tiles(416, 416), [])

    def test_a_thing_cut_off_by_a_square_is_left_to_the_others(self):
        net = object.__new__(network.Network)
        net.tiled = True
        bright = []

        def look(image, threshold):
            columns = np.flatnonzero(image.max((0, 2)))
            bright.append(image.shape)
            if not len(columns):
                return np.zeros((0, 4)), np.zeros((0, 6))
            return np.array([[columns[0], 0, columns[-1] + 1, image.shape[0]]], float), np.full((1, 6), 0.5)

        net._look = look
        picture = np.zeros((100, 200, 3), np.uint8)
        picture[40:60, 95:105] = 255  # cut by the first and the last of three squares
        boxes, scores = net.detect(picture, 0.1)
        self.assertEqual(bright, [(100, 200, 3)] + [(100, 100, 3)] * 3)
        self.assertEqual(boxes.tolist(), [[95, 0, 105, 100]] * 2)
        self.assertEqual(scores.shape, (2, 6))


class Inputs(unittest.TestCase):
    def test_a_rectangle_shows_a_cameras_picture_larger(self):
        # As Letterbox.ARectangleShowsACamerasPictureLarger of decode_test.cpp.
        view, scale, left, top = augment.letterbox(np.full((480, 640, 3), 9, np.uint8), 480, 352)
        self.assertEqual((view.shape, round(scale, 4), left, top), ((352, 480, 3), 0.7333, 5, 0))
        self.assertEqual((view[0, 4, 0], view[0, 5, 0], view[351, 473, 0], view[351, 474, 0]), (augment.BORDER, 9, 9, augment.BORDER))
        self.assertEqual(augment.letterbox(np.zeros((1, 5000, 3), np.uint8), 416, 416)[0].shape, (416, 416, 3))

    def test_the_input_is_what_the_metadata_says(self):
        sides = {}
        for name in ('416', '320', '480x352'):
            n = network.Network(MODELS / f'cbam_yolov5n_{name}.onnx')
            sides[name] = (n.width, n.height)
        self.assertEqual(sides, {'416': (416, 416), '320': (320, 320), '480x352': (480, 352)})
        with tempfile.TemporaryDirectory() as folder:
            own = pathlib.Path(folder) / 'own.onnx'
            own.write_bytes((MODELS / 'cbam_yolov5n_320.onnx').read_bytes())
            own.with_suffix('.toml').write_text((MODELS / 'cbam_yolov5n_416.toml').read_text())
            with self.assertRaisesRegex(ValueError, 'runs at none of 416 x 416'):
                network.Network(own)
            told = (MODELS / 'cbam_yolov5n_320.toml').read_text()
            own.with_suffix('.toml').write_text(told.replace('"yolov5"', '"yolox"'))
            with self.assertRaisesRegex(ValueError, 'output of 6300 rows is not of the layout that own.toml says, yolox'):
                network.Network(own)

    def test_colour_and_place_are_what_the_metadata_says(self):
        # Whatever the layout: a network without anchors may read red first in the middle, too.
        with tempfile.TemporaryDirectory() as folder:
            own = pathlib.Path(folder) / 'own.onnx'
            own.write_bytes((MODELS / 'cbam_yolov5n_320.onnx').read_bytes())
            told = (MODELS / 'cbam_yolov5n_320.toml').read_text()
            image = np.full((80, 160, 3), (10, 20, 30), np.uint8)
            for colour, place, scale, first, top in (('rgb', 'centre', 1 / 255, 10, 80), ('bgr', 'top_left', 0.5, 30, 0)):
                changed = told.replace('"rgb"', f'"{colour}"').replace('"centre"', f'"{place}"')
                own.with_suffix('.toml').write_text(changed.replace('0.00392156862745098', str(scale)))
                blob, _, left, above = network.Network(own).blob(image)
                self.assertEqual((left, above), (0, top))
                np.testing.assert_allclose(blob[0, :, top + 5, 5], np.array([first, 20, 40 - first]) * scale, rtol=1e-6)
                self.assertAlmostEqual(float(blob[0, 0, 319, 5]), 114 * scale, places=4)

    def test_a_picture_is_looked_at_once(self):
        looks = []

        class Counted:
            def detect(self, image, threshold):
                looks.append(threshold)
                return np.array([[0, 0, 9, 9], [0, 0, 5, 5]], float), np.array([[0.5, 0.0], [0.02, 0.0]])

        remembered, image = network.Remembered(Counted()), np.zeros((9, 9, 3), np.uint8)
        self.assertEqual([len(remembered.detect(image, t)[0]) for t in (0.01, 0.25, 0.6)], [2, 1, 0])
        self.assertEqual(looks, [0.01])
        with self.assertRaises(ValueError):
            remembered.detect(image, 0.001)

    def test_pictures_are_as_asked(self):
        def picture(w, h):
            return data.Picture('p', 'coco', cv2.randu(np.zeros((h, w, 3), np.uint8), 0, 255), np.zeros((0, 4)), np.zeros(0))

        pictures = evaluate.as_asked([picture(40, 30), picture(30, 40), picture(32, 32)], wide=True, grey=True)
        self.assertEqual([p.image.shape for p in pictures], [(30, 40, 3)])
        self.assertEqual(np.ptp(pictures[0].image, axis=2).max(), 0)


class Draws(unittest.TestCase):
    class Said:
        """People at the boxes that a picture's first pixels count."""

        def detect(self, image, threshold):
            right = int(image[0, 0, 0])
            boxes = np.array([[10, 10, 60, 90]] if right else [[110, 10, 150, 90], [10, 10, 60, 90]], float)
            scores = np.zeros((len(boxes), 6))
            scores[:, 0] = np.linspace(0.9, 0.8, len(boxes))
            return boxes, scores

    def picture(self, right, extra=()):
        image = np.zeros((100, 200, 3), np.uint8)
        image[0, 0, 0] = right
        boxes = [[10, 10, 60, 90], *extra]
        return data.Picture('p', 'coco', image, np.float32(boxes), np.zeros(len(boxes), np.int64))

    def test_its_average_precision_is_that_of_the_other_figures(self):
        pictures = [self.picture(1), self.picture(0), self.picture(1, [[100, 5, 120, 95]])]
        table = bootstrap.collect(self.Said(), pictures)['person all']
        score = metrics.ClassScore()
        for p in pictures:
            boxes, scores = self.Said().detect(p.image, 0)
            score.add(boxes, scores[:, 0], p.boxes, p.ignore)
        self.assertAlmostEqual(table.average_precision(), score.average_precision()[0], places=9)
        # Twice the same pictures are the same figure; only the right one is all right.
        self.assertAlmostEqual(table.average_precision(np.array([2, 2, 2])), table.average_precision(), places=9)
        self.assertAlmostEqual(table.average_precision(np.array([3, 0, 0])), 1)
        again = bootstrap.Table.from_json(table.to_json())
        self.assertEqual(again.average_precision(), table.average_precision())

    def test_small_things_are_counted_apart(self):
        small = [150, 50, 158, 58]
        tables = bootstrap.collect(self.Said(), [self.picture(1, [small])])
        self.assertEqual(tables['person all'].truths.sum(), 2)
        # The person found is large and says nothing of small ones, of which none is found.
        self.assertEqual((tables['person small'].truths.sum(), len(tables['person small'].hit)), (1, 0))
        self.assertNotIn('vehicle small', tables)

    def test_equal_networks_do_not_differ(self):
        table = bootstrap.collect(self.Said(), [self.picture(i % 2) for i in range(12)])['person all']
        d = bootstrap.difference([(table, table)] * 3, 100)
        self.assertEqual((d['by_seed'], d['low'], d['high']), ([0, 0, 0], 0, 0))

    def test_what_is_better_in_every_picture_is_better_in_every_draw(self):
        worse = bootstrap.collect(self.Said(), [self.picture(0) for _ in range(12)])['person all']
        better = bootstrap.collect(self.Said(), [self.picture(1) for _ in range(12)])['person all']
        d = bootstrap.difference([(worse, better)], 100)
        self.assertGreater(d['low'], 0.3)
        low, high = bootstrap.spread_of(better, 50)
        self.assertEqual((low, high), (1, 1))


if __name__ == '__main__':
    unittest.main()
