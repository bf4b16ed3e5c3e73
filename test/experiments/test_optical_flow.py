#!/usr/bin/env python3
"""optical_flow --quick: its tables are written, and what they are there to show holds on half a second."""

from quick_test import QuickTest, main


def median_and_p90(cell):
    median, p90 = cell.split(" / ")
    return float(median), float(p90)


class Quick(QuickTest):
    ARGUMENTS = ("--part", "displacement", "--part", "shutter")

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
        self.check_drawn("optical_flow.png", "global_shutter.png",
                         arguments=("--trajectory", "V1_02_medium"))


if __name__ == "__main__":
    main("trajectories")
