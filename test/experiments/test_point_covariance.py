#!/usr/bin/env python3
"""point_covariance --quick: errors squared are what the covariances say, by extent and light; the plot."""

import argparse
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "experiments"))
from point_covariance import errors_by_what_was_said  # noqa: E402

SKIPPED = 77  # as ctest is told
MIN_POINTS = 300
arguments = None


class Quick(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([arguments.program, "--quick", "--quiet", "--data", arguments.data, "--out", cls.out], check=True,
                       stdout=subprocess.DEVNULL)
        with open(cls.out / "point_covariance.csv", newline="", encoding="utf-8") as file:
            cls.rows = [row for row in csv.DictReader(file) if int(row["points in it"]) >= MIN_POINTS]

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def test_every_kind_of_point_has_bins_of_both_statuses(self):
        for points in "SIFT", "ORB":
            of_kind = [row for row in self.rows if row["points"] == points]
            self.assertEqual({row["status"] for row in of_kind}, {"SHARP", "DEBLURRED"}, msg=points)
            self.assertGreater(len({row["extent [px]"] for row in of_kind}), 2, msg=points)

    def test_errors_are_what_covariances_say(self):
        for row in self.rows:
            self.assertLess(float(row["mean"]), 3, msg=row)
            self.assertGreater(float(row["within 95 %"]), 0.75, msg=row)
            self.assertGreater(float(row["mean"]), 1 / 3, msg=row)

    def test_points_that_are_said_to_be_farther_off_are(self):
        said = errors_by_what_was_said(self.out / "point_covariance_samples.csv", MIN_POINTS)
        for points in "SIFT", "ORB":
            bins = said[points]
            self.assertGreater(len(bins), 2, msg=points)
            said_growth, growth = np.log(bins[-1, :2] / bins[0, :2])
            self.assertGreater(growth, 0.5 * said_growth, msg=bins)
            for of_bin in bins:
                self.assertLess(abs(np.log2(of_bin[1] / of_bin[0])), 1, msg=of_bin)

    def test_plot_is_drawn(self):
        subprocess.run(["/usr/bin/python3", ROOT / "experiments" / "point_covariance.py", self.out], check=True,
                       stdout=subprocess.DEVNULL)
        self.assertGreater((self.out / "point_covariance.png").stat().st_size, 1000)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    arguments = parser.parse_args()
    if not (arguments.data / "handshake_gyro").exists():
        print(f"skipped: there is no {arguments.data}/handshake_gyro")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
