#!/usr/bin/env python3
"""image_quality --quick: corners are found again as expected of their blocks, and scores order frames; the plot."""

from quick_test import QuickTest, main

MIN_CORNERS = 300


class Quick(QuickTest):
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
        self.assertIn("POOR", {row["grade"] for row in rows})

    def test_plot_is_drawn(self):
        self.check_drawn("image_quality.png")


if __name__ == "__main__":
    main("handshake_gyro")
