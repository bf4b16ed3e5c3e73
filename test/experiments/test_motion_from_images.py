#!/usr/bin/env python3
"""motion_from_images --quick: its tables are written, and what they are there to show holds on half a second."""

import argparse
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SKIPPED = 77  # as ctest is told
arguments = None


def median_and_p90(cell):
    median, p90 = cell.split(" / ")
    return float(median), float(p90)


class Quick(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([arguments.program, "--quick", "--quiet", "--part", "displacement", "--part", "shutter",
                        "--data", arguments.data, "--out", cls.out], check=True, stdout=subprocess.DEVNULL)

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def rows(self, name):
        with open(self.out / name, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def test_images_leave_a_tenth_of_what_the_gyroscope_does_not_know(self):
        rows = self.rows("displacement.csv")
        self.assertEqual(len(rows), 6)
        for row in rows:
            alone, with_velocity, images = (median_and_p90(row[name + " [px]"]) for name in (
                "gyroscope alone", "true velocity, median depth", "images"))
            for k in range(2):
                self.assertLess(images[k], 0.1 * alone[k], row)
                self.assertLess(images[k], with_velocity[k], row)

    def test_points_of_a_global_shutter_are_where_they_were(self):
        rows = self.rows("shutter.csv")
        self.assertEqual(len(rows), 2)
        for row in rows:
            median, p90 = median_and_p90(row["images [px]"])
            self.assertLess(median, 0.15, row)
            self.assertLess(p90, 0.6, row)
            self.assertGreater(median_and_p90(row["rotation [px]"])[0], 0.15, row)

    def test_plot_and_picture_are_drawn(self):
        subprocess.run(["/usr/bin/python3", ROOT / "experiments" / "motion_from_images.py", self.out,
                        "--trajectory", "V1_02_medium"], check=True, stdout=subprocess.DEVNULL)
        for name in "motion_from_images.png", "global_shutter.png":
            self.assertGreater((self.out / name).stat().st_size, 1000, name)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    arguments = parser.parse_args()
    if not (arguments.data / "trajectories").exists():
        print(f"skipped: there is no {arguments.data}/trajectories")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
