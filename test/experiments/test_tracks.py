#!/usr/bin/env python3
"""tracks --quick: FeatureTracker errs less than Lucas-Kanade, on blurred and on sharp images; the plot. On a recorded
burst it follows more corners."""

import unittest

from quick_test import ROOT, QuickTest, main


class Quick(QuickTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.errors = {row["tracker"]: row for row in cls.rows("tracks.csv") if row["extent [px]"] == "all"}
        cls.lengths = {row["tracker"]: row for row in cls.rows("track_lengths.csv")}

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
        self.check_drawn("tracks.png")


class Recording(QuickTest):
    """A hand-held tablet, about 100 px of blur."""

    @classmethod
    def setUpClass(cls):
        folder = cls.arguments.data / "shield_burst"
        if not folder.exists():
            raise unittest.SkipTest(f"there is no {folder}")
        cls.ARGUMENTS = "--recording", folder, ROOT / "config" / "recordings" / "shield_burst.yaml"
        super().setUpClass()
        cls.near = {(row["tracker"], int(row["images apart"])): float(row["within 1 px"])
                    for row in cls.rows("recorded_tracks.csv")}

    def test_more_corners_agree_with_one_translation(self):
        for other in "LK, raw", "LK, deblurred":
            self.assertGreater(self.near["FeatureTracker, raw", 1], 1.3 * self.near[other, 1], msg=other)
            self.assertGreater(self.near["FeatureTracker, raw", 3], 2 * self.near[other, 3], msg=other)


if __name__ == "__main__":
    main("trajectories")
