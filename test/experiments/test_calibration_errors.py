#!/usr/bin/env python3
"""calibration_errors: on a short flight nothing given costs little, and wrong numbers cost what they should."""

import pathlib
import subprocess
import tempfile

from quick_test import QuickTest, main


class Flight(QuickTest):
    """Of 6.5 s: what is wrong is replaced, or estimated, before matches are counted."""
    PART = None  # of the program's cases

    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name) / "new"
        subprocess.run([cls.arguments.program, "--part", cls.PART, "--seconds", "6.5", "--quiet", "--data",
                        cls.arguments.data, "--out", cls.out], check=True, stdout=subprocess.DEVNULL)
        cls.cases = {row["given"]: row for row in cls.rows("calibration_errors.csv")}

    def percent(self, given):
        return float(self.cases[given]["of those with everything [%]"])


class WrongExposure(Flight):
    PART = "exposure"

    def test_it_is_replaced(self):
        for factor in "0.50", "0.60", "0.80", "0.90", "1.10", "1.25", "1.60", "2.00":
            self.assertGreater(self.percent("exposure_time x" + factor), 97, msg=factor)

    def test_one_that_is_kept_is_worth_nothing(self):
        blurred_percent = self.percent("everything, nothing is deblurred")
        for factor in "0.60", "1.60":
            kept = "exposure_time x%s, on_exposure_conflict: configured" % factor
            self.assertLess(self.percent(kept), 1.1 * blurred_percent, msg=factor)
            self.assertEqual(self.cases[kept]["exposure within 5 % from [s]"], "-", msg=factor)


class WrongNumbers(Flight):
    PART = "wrong"

    def test_optical_flow_makes_up_for_what_is_slightly_wrong(self):
        for given in ("time_offset + 5 ms", "R_cam_imu about (1, 1, 1) by 5 degrees",
                      "gyro_bias + 0.02 rad/s on each axis", "focal length x1.10"):
            self.assertGreater(self.percent(given), 97, msg=given)

    def test_what_is_far_off_costs_matches(self):
        blurred_percent = self.percent("everything, nothing is deblurred")
        for given in "time_offset + 40 ms", "R_cam_imu about (1, 1, 1) by 90 degrees":
            self.assertLess(self.percent(given), 97, msg=given)
            self.assertGreater(self.percent(given), 1.5 * blurred_percent, msg=given)


class Missing(Flight):
    PART = "missing"

    def test_nothing_given_costs_little(self):
        for given in "all but the rotation", "intrinsics and exposure time", "all but the exposure time", "nothing":
            row = self.cases[given]
            self.assertGreater(float(row["of those with everything [%]"]), 95, msg=row)
            self.assertLess(float(row["gyroscope used from [s]"]), 5, msg=row)

    def test_focal_length_is_found_where_it_is_not_given(self):
        for given, row in self.cases.items():
            focal_percent = row["focal length, of the true one [%]"]
            if given in ("exposure time", "nothing"):
                self.assertLess(abs(float(focal_percent) - 100), 10, msg=row)
            else:
                self.assertEqual(focal_percent, "-", msg=row)

    def test_images_alone_are_worse(self):
        row = self.cases["exposure time, no IMU"]
        self.assertEqual(row["gyroscope used from [s]"], "-", msg=row)
        self.assertLess(float(row["of those with everything [%]"]), 95, msg=row)
        self.assertGreater(float(row["of those with everything [%]"]), 80, msg=row)


if __name__ == "__main__":
    main("trajectories")
