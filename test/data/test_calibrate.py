#!/usr/bin/python3
"""calibrate as a program, on simulated bags with known truth.

Usage: test_calibrate.py TOOL_DIR PLOT_SCRIPT
"""
import json
import os
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np
import rosbag
import yaml

TOOL_DIR, PLOT_SCRIPT = "", ""  # from the command line

SCENE = """
frames: 40
lead_time: 0.7
camera: {size: [376, 240], intrinsics: [229.4, 228.7, 183.6, 124.2], distortion_model: plumb_bob,
         distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002], fps: 20, exposure_time: [0.008, 0.012],
         readout_time: 0.025, noise: 2}
imu: {rate: 200, gyro_bias: [0.01, -0.02, 0.03], gyro_noise: 0.003, time_offset: 0.123, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}
planes:
  - {texture: procedural, texture_seed: 11, texture_size: [1400, 1000], size: [8.4, 6.0], position: [0, 0, 2]}
motion:
  type: curve
  rotation:
    sines:
      - {amplitude: [4, 7, 2], frequency: 1.1, phase: 12}
      - {amplitude: [-3, 2, 5], frequency: 1.7, phase: 57}
"""
R_CAM_IMU = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])


# Blur of 9 px and more in most images, of an exposure that no message has.
BLURRED_SCENE = SCENE.replace("exposure_time: [0.008, 0.012]", "exposure_time: 0.02").replace(
    "[4, 7, 2]", "[8, 14, 4]").replace("[-3, 2, 5]", "[-6, 4, 10]")
EXPOSURE_S = 0.02


class Calibrate(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.simulate("in.bag", SCENE)

    @classmethod
    def simulate(cls, name, scene):
        with open(cls.path("scene.yaml"), "w") as file:
            file.write(scene)
        subprocess.run([os.path.join(TOOL_DIR, "simulate_bag"), cls.path(name), "--scene", cls.path("scene.yaml"),
                        "--no-truth", "--quiet"], check=True, stdout=subprocess.DEVNULL)

    @classmethod
    def images_and_samples(cls, name, scene):
        """Simulates a bag without messages of exposure and tf."""
        cls.simulate("all.bag", scene)
        with rosbag.Bag(cls.path("all.bag")) as source, rosbag.Bag(cls.path(name), "w") as target:
            for topic, message, time in source.read_messages():
                if topic not in ("/camera/exposure", "/tf_static"):
                    target.write(topic, message, time)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    @classmethod
    def path(cls, name):
        return os.path.join(cls.folder.name, name)

    @classmethod
    def calibrate(cls, *arguments, bag="in.bag"):
        return subprocess.run([os.path.join(TOOL_DIR, "calibrate"), cls.path(bag), "--output", cls.path("out.yaml"),
                               "--json", cls.path("out.json"), "--quiet", "--points", "30", *arguments],
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)

    def results(self):
        with open(self.path("out.yaml")) as file, open(self.path("out.json")) as report:
            return yaml.safe_load(file), json.load(report)

    def check(self, keys):
        self.assertAlmostEqual(keys["time_offset"], 0.123, delta=0.001)
        self.assertAlmostEqual(keys["readout_time"], 0.025, delta=0.05 * 0.025)
        np.testing.assert_allclose(keys["gyro_bias"], [0.01, -0.02, 0.03], atol=0.005)

    def test_from_nothing(self):
        result = self.calibrate("--estimate-rotation")
        self.assertEqual(result.returncode, 0, result.stderr)
        keys, report = self.results()
        self.check(keys)
        R = np.reshape(keys["R_cam_imu"], (3, 3))
        self.assertLess(np.degrees(np.arccos((np.trace(R.T @ R_CAM_IMU) - 1) / 2)), 0.5)
        self.assertEqual(report["rotation_from"], "estimated")
        self.assertLess(report["median_residual_px"]["estimated"], 0.5)
        self.assertGreater(report["median_residual_px"]["without_gyroscope"], 3)
        for line in ("time_offset   +0.12", "readout_time  +0.02", "gyro_bias     [+0.0", "R_cam_imu     ["):
            self.assertIn(line, result.stdout)
        # The simulated exposure messages bring their own readout time, which the user has to know.
        self.assertIn("readout time of 0.025000 s of their own", result.stderr)

    def verdict(self, key):
        with open(self.path("out.json")) as file:
            return {v["key"]: v for v in json.load(file)["verdicts"]}[key]

    def test_everything_from_images_and_samples(self):
        self.images_and_samples("blurred.bag", BLURRED_SCENE)
        result = self.calibrate(bag="blurred.bag")
        self.assertEqual(result.returncode, 0, result.stderr)
        keys, report = self.results()
        self.check(keys)
        self.assertAlmostEqual(keys["exposure_time"], EXPOSURE_S, delta=0.03 * EXPOSURE_S)
        self.assertEqual(keys["stamp_phase"], "start")
        # Half of the exposure's error is in the offset.
        offset = report["time_offset_s"]
        self.assertLess(abs(offset["value"] - 0.123), 3 * offset["stddev"])
        self.assertLess(offset["stddev"], 2e-4)
        R = np.reshape(keys["R_cam_imu"], (3, 3))
        self.assertLess(np.degrees(np.arccos((np.trace(R.T @ R_CAM_IMU) - 1) / 2)), 0.5)
        self.assertEqual([v["state"] for v in report["verdicts"]], 5 * ["known"])
        self.assertRegex(self.verdict("exposure_time")["text"], r"known to [12]\.\d %, by the blur of \d+ of 40 images")
        # The zeros of the spectrum are where the path puts them.
        power = {round(p["waves"], 2): p["log_power"] for p in report["exposure"]["spectrum"]}
        self.assertLess(power[1.05], power[1.35] - 0.5)
        # The images hold against exposure_time, unless it is to be kept.
        for more, exposure_s in (("", EXPOSURE_S), ("on_exposure_conflict: configured\n", 0.03)):
            with open(self.path("wrong.yaml"), "w") as file:
                file.write("exposure_time: 0.03\n" + more)
            result = self.calibrate("--config", self.path("wrong.yaml"), "--end", "2", bag="blurred.bag")
            self.assertEqual(result.returncode, 0, result.stderr)
            keys, _ = self.results()
            self.assertAlmostEqual(keys["exposure_time"], exposure_s, delta=0.03 * EXPOSURE_S)
        self.assertRegex(self.verdict("exposure_time")["text"],
                         r"blur is 0\.6\d times \(\+- 1 %\) what exposure_time says")

    def test_an_exposure_that_sharp_images_do_not_determine(self):
        self.images_and_samples("sharp.bag", SCENE.replace("exposure_time: [0.008, 0.012]", "exposure_time: 0.002"))
        result = self.calibrate(bag="sharp.bag")
        self.assertEqual(result.returncode, 0, result.stderr)
        keys, _ = self.results()
        self.assertNotIn("exposure_time", keys)
        # Half of it is in the offset.
        self.assertAlmostEqual(keys["time_offset"], 0.123 + 0.001, delta=0.0005)
        self.assertEqual(keys["stamp_phase"], "middle")
        self.assertEqual(self.verdict("exposure_time")["state"], "not determined")
        self.assertIn("Rotate the camera faster, or set exposure_time", self.verdict("exposure_time")["text"])
        with open(self.path("out.yaml")) as file:
            self.assertIn("# exposure_time is not here: 0 of 40 images determine it", file.read())

    def test_with_the_rotation_of_tf(self):
        self.assertEqual(self.calibrate().returncode, 0)
        keys, report = self.results()
        self.check(keys)
        self.assertNotIn("R_cam_imu", keys)
        self.assertEqual(report["rotation_from"], "tf")
        self.assertEqual(self.verdict("R_cam_imu")["state"], "given")
        self.assertIn("the exposure message", self.verdict("exposure_time")["text"])
        self.deblur("in.bag")
        # Of footage without timing there are the verdicts, and what determines the exposure.
        whole = self.plot()
        self.assertEqual(self.calibrate("--end", "1.05").returncode, 1)
        self.assertEqual(self.verdict("time_offset")["state"], "not determined")
        self.assertLess(self.plot().shape[0], whole.shape[0])

    def deblur(self, bag):
        """Some of the images, with the file that was written."""
        result = subprocess.run([os.path.join(TOOL_DIR, "deblur_bag"), self.path(bag), self.path("deblurred.bag"),
                                 "--config", self.path("out.yaml"), "--end", "1.5"], stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, universal_newlines=True)
        self.assertEqual(result.returncode, 0, result.stdout)
        self.assertNotIn("is not known", result.stdout)
        with rosbag.Bag(self.path("deblurred.bag")) as deblurred:
            fields = [m for _, m, _ in deblurred.read_messages(topics=["/camera/blur_field"])]
        self.assertEqual({field.reason for field in fields}, {0})

    def plot(self):
        subprocess.run([sys.executable, PLOT_SCRIPT, self.path("out.json"), self.path("out.png")], check=True)
        picture = cv2.imread(self.path("out.png"))
        self.assertGreater(picture.shape[0], 500)
        self.assertGreater(picture.std(), 10)
        return picture

    def test_a_damaged_message_is_named(self):
        for damaged in ("/imu", "/camera/camera_info"):
            with self.subTest(damaged):
                damaged_at = None
                with rosbag.Bag(self.path("in.bag")) as source, rosbag.Bag(self.path("damaged.bag"), "w") as target:
                    for topic, (kind, data, *rest), time in source.read_messages(raw=True):
                        if topic == damaged and damaged_at is None:
                            data, damaged_at = data[:len(data) // 2], time
                        target.write(topic, (kind, data, *rest), time, raw=True)
                result = self.calibrate(bag="damaged.bag")
                self.assertEqual(result.returncode, 1)
                self.assertEqual(result.stderr.count("\n"), 1, result.stderr)
                self.assertIn("%s: topic %s, " % (self.path("damaged.bag"), damaged), result.stderr)
                self.assertIn(" recorded at %d.%09d s: cannot be read: " % (damaged_at.secs, damaged_at.nsecs),
                              result.stderr)

    def test_what_is_given_stays(self):
        with open(self.path("extrinsic.yaml"), "w") as file:
            file.write("%YAML:1.0\nmodel_type: PINHOLE\nimage_width: 376\nimage_height: 240\n"
                       "distortion_parameters: {k1: -0.28, k2: 0.07, p1: 0.0002, p2: 0.00002}\n"
                       "projection_parameters: {fx: 229.4, fy: 228.7, cx: 183.6, cy: 124.2}\ntd: 0.1\nbody_T_cam0: "
                       "{rows: 4, cols: 4, dt: d, data: [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}\n")
        with open(self.path("given.yaml"), "w") as file:
            file.write("readout_time: 0.024\ngyro_bias: [0.01, -0.02, 0.03]\nnoise_to_signal_ratio: 0.02\n"
                       "rectified_input: false\ncalibration_file: extrinsic.yaml\n")
        result = self.calibrate("--config", self.path("given.yaml"), "--fixed-readout", "--fixed-bias", "--search", "0.05")
        self.assertEqual(result.returncode, 0, result.stderr)
        keys, report = self.results()
        self.assertEqual(keys["readout_time"], 0.024)
        self.assertEqual(keys["gyro_bias"], [0.01, -0.02, 0.03])
        self.assertEqual(report["rotation_from"], "as configured")
        self.assertAlmostEqual(keys["time_offset"], 0.123, delta=0.002)
        # What calibrate does not estimate is handed on, and what it does holds against the file.
        self.assertEqual(keys["noise_to_signal_ratio"], 0.02)
        self.assertEqual(keys["calibration_file"], self.path("extrinsic.yaml"))
        self.assertEqual(keys["on_calibration_conflict"], "configured")
        self.deblur("in.bag")

    def test_an_offset_at_which_stamps_do_not_overlap_is_no_place_to_begin(self):
        with open(self.path("far.yaml"), "w") as file:
            file.write("time_offset: 5\n")
        result = self.calibrate("--config", self.path("far.yaml"))
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn("which with time_offset = 5.000000000 s are 2.192000000 s apart", result.stderr)
        self.check(self.results()[0])

    def test_bad_input(self):
        def fails(expected, *arguments, bag="in.bag"):
            result = self.calibrate(*arguments, bag=bag)
            self.assertEqual(result.returncode, 1, result.stderr)
            self.assertEqual(result.stderr.count("\n"), 1, result.stderr)
            self.assertIn(expected, result.stderr)

        fails("no such file", bag="none.bag")
        with open(self.path("no.bag"), "w") as file:
            file.write("no bag")
        fails("is not a bag", bag="no.bag")
        fails("no topic /left for images; the bag has", "--image-topic", "/left")
        fails("pairs of frames have 8 tracked points or more; 10 are needed", "--end", "1.05")
        self.assertEqual(self.calibrate("--search", "6").returncode, 2)


if __name__ == "__main__":
    TOOL_DIR, PLOT_SCRIPT = sys.argv[1:3]
    unittest.main(argv=sys.argv[:1] + sys.argv[3:], verbosity=2)
