#!/usr/bin/env python3
"""unknown_camera: a short flight of which nothing is given is deblurred about as well as one of which everything is."""

import pathlib
import subprocess
import tempfile

from quick_test import QuickTest, main


class Short(QuickTest):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = pathlib.Path(cls.temporary.name)
        subprocess.run([cls.arguments.program, "--seconds", "6.5", "--quiet", "--data", cls.arguments.data,
                        "--out", cls.out], check=True, stdout=subprocess.DEVNULL)
        cls.cases = {row["given"]: row for row in cls.rows("unknown_camera.csv")}

    def test_nothing_given_costs_little(self):
        for given in "all but the rotation", "intrinsics and exposure time", "exposure time", "nothing":
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
