"""What the tests of the benchmarks share: a folder of their own with a program in it that stands in for godwit."""
import pathlib
import tempfile
import unittest


class StandInTest(unittest.TestCase):
    """FLYER, set by the derived class, is the text of the program; it may log its calls to the file 'flown' beside it."""

    FLYER = ''

    def setUp(self):
        self.temp = tempfile.TemporaryDirectory()
        self.folder = pathlib.Path(self.temp.name)
        self.flyer = self.folder / 'godwit'
        self.flyer.write_text(self.FLYER)
        self.flyer.chmod(0o755)

    def tearDown(self):
        self.temp.cleanup()
