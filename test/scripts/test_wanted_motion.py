#!/usr/bin/env python3
"""What setup asks of the one who rotates the camera."""

import pathlib
import sys
import unittest

import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "scripts"))
from wanted_motion import WantedMotion  # noqa: E402

RATE_HZ = 200
BIAS = np.array([0.02, -0.05, 0.03])
PAN, TILT, ROLL = np.eye(3)


def after(seconds, rate):
    """Of rate(t) about the axes of an IMU that is mounted askew."""
    askew = np.linalg.qr(np.array([[1, 2, 3], [0, 1, 4], [5, 6, 0.5]]))[0]
    motion = WantedMotion()
    for i in range(int(seconds * RATE_HZ)):
        t_s = i / RATE_HZ
        motion.add(t_s, askew @ rate(t_s) + BIAS)
    return motion.state()


def shake(t_s, axes):
    return sum(np.sin(2 * np.pi * (1.1 + 0.3 * i) * t_s + i) * axis for i, axis in enumerate(axes))


class WantedMotionTest(unittest.TestCase):
    def test_a_camera_that_stands(self):
        self.assertEqual(WantedMotion().state(), (0.0, "no samples of the IMU yet"))
        share, text = after(10, lambda t_s: 0.01 * shake(t_s, [PAN]))
        self.assertEqual(share, 0)
        self.assertIn("rotate the camera: back and forth", text)

    def test_axes_one_after_the_other(self):
        shares = []
        for axes, wanted in (([PAN], "another axis"), ([PAN, TILT], "the third axis"), ([PAN, TILT, ROLL], "")):
            share, text = after(20, lambda t_s, axes=axes: shake(t_s, axes))
            shares.append(share)
            self.assertIn(wanted, text)
            self.assertEqual(text == "", wanted == "")
        self.assertEqual(shares, sorted(shares))

    def test_rotates_in_one_direction(self):
        share, text = after(20, lambda t_s: 3 * max(0, np.sin(0.4 * np.pi * t_s)) * PAN
                            + 0.5 * shake(t_s, [0 * PAN, TILT, ROLL]))
        self.assertLess(share, 1)
        self.assertIn("change the direction more often", text)

    def test_too_short(self):
        self.assertIn("keep rotating", after(3, lambda t_s: shake(t_s, [PAN, TILT, ROLL]))[1])

    def test_samples_that_are_no_good(self):
        motion = WantedMotion()
        for t_s, rate in ((1, (0, 0, 0)), (1, (1, 1, 1)), (0.5, (1, 1, 1)), (2, (np.nan, 0, 0))):
            motion.add(t_s, rate)
        self.assertEqual(motion.state()[1], "no samples of the IMU yet")


if __name__ == "__main__":
    unittest.main()
