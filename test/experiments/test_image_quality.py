#!/usr/bin/env python3
"""image_quality --quick: corners are found again as expected of their blocks, and scores order frames; the plot."""

import argparse
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SKIPPED = 77  # as ctest is told
MIN_CORNERS = 300
arguments = None


class Quick(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([arguments.program, "--quick", "--quiet", "--data", arguments.data, "--out", cls.out], check=True,
                       stdout=subprocess.DEVNULL)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def rows(self, name):
        with open(self.out / name, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def test_corners_are_found_again_as_expected(self):
        rows = [row for row in self.rows("image_quality_blocks.csv") if int(row["corners"]) >= MIN_CORNERS]
        self.assertGreater(len({row["extent [px]"] for row in rows}), 4)
        self.assertEqual({row["status"] for row in rows}, {"SHARP", "DEBLURRED"})
        for row in rows:
            self.assertAlmostEqual(float(row["expected"]), float(row["repeated"]), delta=0.15, msg=row)

    def test_frames_are_ordered_by_their_scores(self):
        rows = sorted(self.rows("image_quality_frames.csv"), key=lambda row: float(row["score"]))
        third = len(rows) // 3
        low, middle, high = (sum(float(row["repeated"]) for row in part) / len(part)
                             for part in (rows[:third], rows[third:-third], rows[-third:]))
        self.assertLess(low + 0.1, middle)
        self.assertLess(middle + 0.1, high)
        self.assertIn("BAD", {row["verdict"] for row in rows})

    def test_plot_is_drawn(self):
        subprocess.run(["/usr/bin/python3", ROOT / "experiments" / "image_quality.py", self.out], check=True,
                       stdout=subprocess.DEVNULL)
        self.assertGreater((self.out / "image_quality.png").stat().st_size, 1000)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    arguments = parser.parse_args()
    if not (arguments.data / "handshake_gyro").exists():
        print(f"skipped: there is no {arguments.data}/handshake_gyro")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
