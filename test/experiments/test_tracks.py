#!/usr/bin/env python3
"""tracks --quick: FeatureTracker errs less than Lucas-Kanade, on blurred and on sharp images; the plot."""

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


class Quick(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([arguments.program, "--quick", "--quiet", "--data", arguments.data, "--out", cls.out], check=True,
                       stdout=subprocess.DEVNULL)
        with open(cls.out / "tracks.csv", newline="", encoding="utf-8") as file:
            cls.errors = {row["tracker"]: row for row in csv.DictReader(file) if row["extent [px]"] == "all"}
        with open(cls.out / "track_lengths.csv", newline="", encoding="utf-8") as file:
            cls.lengths = {row["tracker"]: row for row in csv.DictReader(file)}

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def value(self, tracker, column):
        return float(self.errors[tracker][column])

    def test_errors_are_less_than_half_of_those_of_lucas_kanade(self):
        for tracker, other in (("FeatureTracker, blurred", "LK, blurred"), ("FeatureTracker, blurred", "LK, deblurred"),
                               ("FeatureTracker, sharp", "LK, sharp")):
            self.assertGreater(int(self.errors[tracker]["tracks"]), 1000)
            for column in "median [px]", "p90 [px]", "drift after 5 [px]":
                self.assertLess(self.value(tracker, column), 0.5 * self.value(other, column), msg=(tracker, column))

    def test_errors_through_blur_are_those_of_lucas_kanade_on_sharp_images(self):
        self.assertLess(self.value("FeatureTracker, blurred", "median [px]"), self.value("LK, sharp", "median [px]"))
        self.assertLess(self.value("FeatureTracker, blurred", "above 2 px [%]"), 0.5)

    def test_tracks_are_as_long(self):
        for tracker, other in (("FeatureTracker, blurred", "LK, deblurred"), ("FeatureTracker, sharp", "LK, sharp")):
            tracks = self.lengths[tracker], self.lengths[other]
            longer, shorter = (float(row["length [images]"]) for row in tracks)
            self.assertGreater(longer, shorter - 2 * sum(float(row["standard error"]) for row in tracks))

    def test_covariances_are_those_of_the_errors(self):
        self.assertGreater(self.value("FeatureTracker, blurred", "e^T C^-1 e"), 1)
        self.assertLess(self.value("FeatureTracker, blurred", "e^T C^-1 e"), 4)

    def test_plot_is_drawn(self):
        subprocess.run(["/usr/bin/python3", ROOT / "experiments" / "tracks.py", self.out], check=True,
                       stdout=subprocess.DEVNULL)
        self.assertGreater((self.out / "tracks.png").stat().st_size, 1000)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("data", type=pathlib.Path)
    arguments = parser.parse_args()
    if not (arguments.data / "trajectories").exists():
        print(f"skipped: there is no {arguments.data}/trajectories")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])
