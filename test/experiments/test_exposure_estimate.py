#!/usr/bin/env python3
"""exposure_estimate --quick: exposures are right, one by one, filtered, and after a jump; tables and plots."""

import math
import statistics

from quick_test import QuickTest, main

BLURRED_PX = 8


class Quick(QuickTest):
    ARGUMENTS = ("--parts", "frames", "--parts", "changes", "--assumptions", "1", "0.6")

    def test_the_exposure_of_one_frame(self):
        for assumed in "1", "0.6":
            ratios = [float(row["ratio"]) for row in self.rows("exposure_frames.csv")
                      if row["light"] == "day" and row["assumed"] == assumed
                      and float(row["extent_px"]) >= BLURRED_PX]
            known = [ratio for ratio in ratios if not math.isnan(ratio)]
            self.assertGreater(len(known), 0.8 * len(ratios))
            self.assertGreater(len(known), 10)
            self.assertAlmostEqual(statistics.median(known), 1, delta=0.02)
            self.assertTrue(all(0.9 < ratio < 1.1 for ratio in known), msg=known)

    def test_a_filter_finds_it_in_any_light(self):
        for row in self.rows("exposure_filtered.csv"):
            if int(row["blurred"]) >= 15:
                self.assertAlmostEqual(float(row["ratio"]), 1, delta=0.06, msg=row)

    def test_a_jump_is_followed(self):
        rows = self.rows("exposure_changes.csv")
        for row in rows:
            if 1 < float(row["t_s"]) < 1.5 or float(row["t_s"]) > 2.1:
                self.assertAlmostEqual(float(row["filtered_ms"]) / float(row["true_ms"]), 1, delta=0.08, msg=row)
        self.assertEqual({row["true_ms"] for row in rows}, {"15.000", "30.000"})

    def test_tables_and_plots_are_made(self):
        self.check_drawn("exposure_filtered.png", "exposure_changes.png", "exposure_estimate.md")


if __name__ == "__main__":
    main("trajectories")
