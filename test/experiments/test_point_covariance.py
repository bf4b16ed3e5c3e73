#!/usr/bin/env python3
"""point_covariance --quick: errors squared are what the covariances say, by extent and light; the plot."""

import sys

import numpy as np

from quick_test import ROOT, QuickTest, main

sys.path.insert(0, str(ROOT / "experiments"))
from point_covariance import errors_by_what_was_said  # noqa: E402

MIN_POINTS = 300


class Quick(QuickTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.bins = [row for row in cls.rows("point_covariance.csv") if int(row["points in it"]) >= MIN_POINTS]

    def test_every_kind_of_point_has_bins_of_both_statuses(self):
        for points in "SIFT", "ORB":
            of_kind = [row for row in self.bins if row["points"] == points]
            self.assertEqual({row["status"] for row in of_kind}, {"SHARP", "DEBLURRED"}, msg=points)
            self.assertGreater(len({row["extent [px]"] for row in of_kind}), 2, msg=points)

    def test_errors_are_what_covariances_say(self):
        for row in self.bins:
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
        self.check_drawn("point_covariance.png")


if __name__ == "__main__":
    main("handshake_gyro")
