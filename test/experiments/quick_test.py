"""What the tests of experiments' quick runs have in common: the run, its tables, its pictures."""

import argparse
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SKIPPED = 77  # ctest's SKIP_RETURN_CODE


class QuickTest(unittest.TestCase):
    """An experiment's results, once for all tests of a class."""

    arguments = None  # of the command line: program, data
    ARGUMENTS = ()  # of the program, further ones

    @classmethod
    def script(cls):
        """Path of the Python script of the program's name."""
        return ROOT / "experiments" / (pathlib.Path(cls.arguments.program).name + ".py")

    @classmethod
    def setUpClass(cls):
        subprocess.run(["/usr/bin/python3", cls.script(), "--help"], check=True, stdout=subprocess.DEVNULL)
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([cls.arguments.program, "--quick", "--quiet", *cls.ARGUMENTS, "--data", cls.arguments.data,
                        "--out", cls.out], check=True, stdout=subprocess.DEVNULL)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    @classmethod
    def rows(cls, name):
        with open(cls.out / name, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def check_drawn(self, *names, arguments=()):
        """The script of the program's name makes these files of more than a kilobyte."""
        subprocess.run(["/usr/bin/python3", self.script(), self.out, *arguments], check=True, stdout=subprocess.DEVNULL)
        for name in names:
            self.assertGreater((self.out / name).stat().st_size, 1000, msg=name)


def main(recording):
    """Runs the calling module's tests; skips them where this folder is not among the recorded data."""
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    QuickTest.arguments = parser.parse_args()
    if not (QuickTest.arguments.data / recording).exists():
        print(f"SKIPPED:\nthere is no {QuickTest.arguments.data}/{recording}")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
