#!/usr/bin/env python3
"""scripts/golden show: what is equal passes, what moved is told with its size."""
import pathlib
import subprocess
import tempfile
import unittest

GOLDEN = pathlib.Path(__file__).resolve().parents[2] / "scripts" / "golden"
STAGES = "pyramid 0 640 480 00ff\ncorner 0 1 0 10.5 20.5 99.1\npose 0 1 30 0.1 0.2 0.3 0 0 0 1\n"
TUM = "# t\n1.0 0.1 0.2 0.3 0 0 0 1 1\n2.0 0.2 0.2 0.3 0 0 0 1 1\n"


class GoldenShow(unittest.TestCase):
    def show(self, old, new, *options):
        with tempfile.TemporaryDirectory() as folder:
            a, b = pathlib.Path(folder) / "a", pathlib.Path(folder) / "b"
            a.write_text(old)
            b.write_text(new)
            run = subprocess.run([GOLDEN, "show", a, b, *[o.format(folder=folder) for o in options]],
                                 capture_output=True, text=True)
            picture = pathlib.Path(folder) / "p.png"
            return run.returncode, run.stdout + run.stderr, picture.stat().st_size if picture.exists() else 0

    def test_equal_files_and_last_bits_pass(self):
        self.assertEqual(self.show(STAGES, STAGES)[0], 0)
        self.assertEqual(self.show(STAGES, STAGES.replace("10.5", "10.500001"))[0], 0)
        self.assertEqual(self.show(TUM, TUM.replace(" 1 1", " 0.9999999 1"))[0], 0)

    def test_what_moved_is_told(self):
        for old, new in (("10.5", "10.6"), ("00ff", "00fe"), ("corner 0 1", "corner 0 2"), ("0.1 0.2", "nan 0.2"),
                         ("pose 0 1 30", "pose 0 1 31")):
            code, text, _ = self.show(STAGES, STAGES.replace(old, new))
            self.assertEqual(code, 1, new)
        self.assertIn("inf", text)

    def test_missing_and_further_rows_are_told(self):
        self.assertEqual(self.show(TUM, TUM + "3.0 0.2 0.2 0.3 0 0 0 1 1\n")[0], 1)
        self.assertEqual(self.show(TUM, "# t\n")[0], 1)

    def test_the_plot_is_drawn(self):
        _, _, size = self.show(TUM, TUM.replace("0.2 0.2", "0.3 0.2"), "--plot", "{folder}/p.png")
        self.assertGreater(size, 5000)


if __name__ == "__main__":
    unittest.main()
