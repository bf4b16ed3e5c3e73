#!/usr/bin/env python3
"""calibrate on footage that does not determine the answer, all simulated.

Usage: test_undetermined_calibration.py FOLDER_OF_THE_TOOLS
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

import rosbag
import rospy
import yaml

TOOLS = pathlib.Path(sys.argv[1])
TRUE_OFFSET_S, TRUE_READOUT_S = 0.123, 0.025
SCENE = """
frames: %d
lead_time: 0.7
camera: {size: [376, 240], intrinsics: [229.4, 228.7, 183.6, 124.2], distortion_model: plumb_bob,
         distortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002], %s,
         readout_time: %g, noise: 2}
imu: {rate: 200, gyro_bias: [0.01, -0.02, 0.03], gyro_noise: 0.003, time_offset: %g, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}
planes:
  - {texture: procedural, texture_seed: 11, texture_size: [1400, 1000], size: [8.4, 6.0], position: [0, 0, 2]}
motion:
  type: curve
  rotation:
    sines:
"""
# Amplitude [deg], frequency [Hz], phase [deg].
SHAKE = [((4, 7, 2), 1.1, 12), ((-3, 2, 5), 1.7, 57)]
PAN = [((3, 8, 2), 0.35, 30)]
LEFT_OF_SHAKE = 0.3  # by the stabilisation of a camera


class UndeterminedCalibration(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        cls.good = cls.simulate("good", 1)

    @classmethod
    def simulate(cls, name, shake, readout_s=TRUE_READOUT_S, pan=1, only_axis=None, frames=40,
                 camera="fps: 20, exposure_time: [0.008, 0.012]"):
        scene = SCENE % (frames, camera, readout_s, TRUE_OFFSET_S)
        for factor, (amplitudes, frequency, phase) in [(shake, s) for s in SHAKE] + [(pan, s) for s in PAN]:
            amplitudes = [factor * a if only_axis in (None, i) else 0 for i, a in enumerate(amplitudes)]
            scene += "      - {amplitude: [%g, %g, %g], frequency: %g, phase: %g}\n" % (*amplitudes, frequency, phase)
        (cls.folder / (name + ".yaml")).write_text(scene, encoding="utf-8")
        path = cls.folder / (name + ".bag")
        subprocess.run([str(TOOLS / "simulate_bag"), str(path), "--scene", str(cls.folder / (name + ".yaml")),
                        "--no-truth", "--quiet"], check=True, stdout=subprocess.DEVNULL)
        return path

    def changed(self, change, images=None):
        """The good bag with each (topic, message, time) as change() returns it; images: of another bag."""
        path = self.folder / "changed.bag"
        with rosbag.Bag(str(path), "w") as target:
            for source, kind in ((images or self.good, "/camera"), (self.good, "/imu"), (self.good, "/tf_static")):
                with rosbag.Bag(str(source)) as bag:
                    for topic, message, time in bag.read_messages():
                        if topic.startswith(kind):
                            target.write(*change(topic, message, time))
        return path

    def calibrate(self, path, *arguments):
        self.output = self.folder / "out.yaml"
        if self.output.exists():
            self.output.unlink()
        self.json = self.folder / "out.json"
        return subprocess.run([str(TOOLS / "calibrate"), str(path), "--output", str(self.output), "--json",
                               str(self.json), "--quiet", "--points", "20", *arguments], stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, universal_newlines=True, timeout=300)

    def verdicts(self):
        return {v["key"]: v for v in json.loads(self.json.read_text(encoding="utf-8"))["verdicts"]}

    def refused(self, path, *parts, arguments=()):
        result = self.calibrate(path, *arguments)
        self.assertEqual(result.returncode, 1, result.stderr)
        for part in parts:
            self.assertIn(part, result.stderr)
        self.assertFalse(self.output.exists())
        return result.stderr

    def written(self, path, *arguments):
        result = self.calibrate(path, *arguments)
        self.assertEqual(result.returncode, 0, result.stderr)
        return yaml.safe_load(self.output.read_text(encoding="utf-8")), result.stderr

    def test_good_footage_is_written(self):
        keys, _ = self.written(self.good)
        self.assertAlmostEqual(keys["time_offset"], TRUE_OFFSET_S, delta=0.001)
        self.assertAlmostEqual(keys["readout_time"], TRUE_READOUT_S, delta=0.05 * TRUE_READOUT_S)

    def test_stabilised_footage(self):
        """The gyroscope feels all of the shake, the images show some of it."""
        path = self.changed(lambda *entry: entry, images=self.simulate("stabilised", LEFT_OF_SHAKE))
        parts = ("nothing is written", "--force", "the images do not move as the gyroscope rotated", "stabilisation")
        text = self.refused(path, *parts)
        without_px, with_px = map(float, re.search(r"is ([\d.]+) px without the gyroscope, ([\d.]+) px with it",
                                                   text).groups())
        self.assertGreater(with_px, without_px)
        self.refused(path, *parts, arguments=["--estimate-rotation"])
        keys, text = self.written(path, "--force")
        self.assertIn("time_offset", keys)
        self.assertIn("the images do not move as the gyroscope rotated", text)

    def test_smooth_images(self):
        """Nothing is left of the shake: what is estimated is impossible, too."""
        path = self.changed(lambda *entry: entry, images=self.simulate("smooth", 0))
        self.refused(path, "the images do not move as the gyroscope rotated", "is longer than the frame period 0.05 s")

    def test_impossible_readout(self):
        config = self.folder / "config.yaml"
        config.write_text("readout_time: 0.154\n", encoding="utf-8")
        arguments = ["--config", str(config), "--fixed-readout"]
        self.refused(self.good, "readout_time = 0.154 s is longer than the frame period 0.05 s", arguments=arguments)
        keys, _ = self.written(self.good, "--force", *arguments)
        self.assertEqual(keys["readout_time"], 0.154)

    def test_offset_at_the_limit_of_the_search(self):
        self.refused(self.good, "at the limit of the search", "--search", arguments=["--search", "0.115"])

    def shifted(self, shift_s, by_stamp=False, still=False):
        """The IMU's clock set by so much; recorded when messages came, or at their stamps; or another IMU at rest."""
        def shift(topic, message, time):
            if topic == "/imu":
                message.header.stamp += rospy.Duration.from_sec(shift_s)
                if still:
                    message.angular_velocity.x = message.angular_velocity.y = message.angular_velocity.z = 0.01
            return topic, message, message.header.stamp if by_stamp and topic != "/tf_static" else time

        return self.changed(shift)

    def test_clocks_hours_apart(self):
        for by_stamp in (False, True):
            keys, text = self.written(self.shifted(-3 * 3600, by_stamp))
            self.assertIn("do not overlap", text)
            self.assertRegex(text, r"are 1079\d\.\d+ s apart")
            self.assertAlmostEqual(keys["time_offset"], TRUE_OFFSET_S - 3 * 3600, delta=0.001)

    def test_a_device_clock_that_begins_with_0(self):
        begin_s = 1.6e9
        keys, text = self.written(self.shifted(1 - begin_s))
        self.assertIn("do not overlap", text)
        self.assertAlmostEqual(keys["time_offset"], TRUE_OFFSET_S + 1 - begin_s, delta=0.001)
        self.assertAlmostEqual(keys["readout_time"], TRUE_READOUT_S, delta=0.05 * TRUE_READOUT_S)

    def test_no_offset_is_found(self):
        self.refused(self.shifted(-3 * 3600, still=True), "do not overlap", "do not agree at any offset")
        for key, verdict in self.verdicts().items():
            if key != "exposure_time":  # of messages
                self.assertEqual(verdict["state"], "not determined", key)

    def test_camera_at_rest(self):
        self.refused(self.simulate("rest", 0, pan=0.1), "the images hardly move", "rotate the camera about all axes")
        self.assertEqual(self.verdicts()["time_offset"]["state"], "not determined")
        self.refused(self.simulate("still", 0, pan=0, frames=50), "do not agree at any offset")
        for key in ("time_offset", "readout_time", "R_cam_imu"):
            self.assertRegex(self.verdicts()[key]["text"], r"rotated faster than 0\.1 rad/s for \d\.\d of the 2 s", key)

    def test_an_exposure_that_is_longer_than_what_is_tried(self):
        """Of a slow camera. That its blur is too short would be wrong."""
        path = self.folder / "unknown_exposure.bag"
        simulated = self.simulate("slow", 0, pan=0.5, frames=8, camera="fps: 4, exposure_time: 0.2")
        with rosbag.Bag(str(simulated)) as source, rosbag.Bag(str(path), "w") as target:
            for topic, message, time in source.read_messages():
                if topic != "/camera/exposure":
                    target.write(topic, message, time)
        self.refused(path, "pairs of frames")
        self.assertIn("exposures up to 0.081 s were tried, and at one frame in 0.25 s it may be longer",
                      self.verdicts()["exposure_time"]["text"])

    def test_rotation_about_one_axis_leaves_the_rotation_open(self):
        path = self.simulate("one_axis", 1, only_axis=1, frames=50)
        self.refused(path, "the recording rotates about one axis only", arguments=["--estimate-rotation"])
        self.assertIn("about one axis only, left and right (about y)", self.verdicts()["R_cam_imu"]["text"])


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[2:], verbosity=2)
