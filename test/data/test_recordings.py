#!/usr/bin/python3
"""make_bag, deblur_bag and the nodelet on recorded data (see README.md in this folder).

Usage: test_recordings.py SOURCE_DIR DATA_DIR TOOL_DIR TEST... Exit status 77: the data is absent.
"""
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag

SOURCE_DIR, DATA_DIR, TOOL_DIR = "", "", ""  # from the command line
SKIPPED = 77  # SKIP_RETURN_CODE in CMakeLists.txt
SHARP, DEBLURRED, NO_GYRO = 0, 1, 4  # as in BlurField.msg
SOURCE_IMAGES = 1
OUTPUTS = ("deblurred/image_raw", "deblurred/camera_info", "keypoints", "blur_field")


def config(name):
    return os.path.join(SOURCE_DIR, "config", name)


def run(tool, *arguments):
    result = subprocess.run([os.path.join(TOOL_DIR, tool)] + list(arguments), stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT, universal_newlines=True)
    if result.returncode != 0:
        raise AssertionError("%s %s: status %d\n%s" % (tool, " ".join(arguments), result.returncode, result.stdout))


def messages(path, topic):
    with rosbag.Bag(path) as bag:
        return [m for _, m, _ in bag.read_messages(topics=[topic])]


def end(process):
    process.send_signal(signal.SIGINT)
    try:
        process.wait(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def through_nodelet(bag, parameters, recorded, folder, rate):
    """Plays a bag through the nodelet, under roslaunch with a master of its own, and records what comes out."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    environment = dict(os.environ, ROS_MASTER_URI="http://localhost:%d" % port, ROS_HOSTNAME="localhost",
                       ROS_LOG_DIR=os.path.join(folder, "ros_log"))
    os.makedirs(environment["ROS_LOG_DIR"], exist_ok=True)
    with open(os.path.join(folder, "roscore.log"), "w", encoding="utf-8") as log:
        master = subprocess.Popen(["roscore", "-p", str(port)], env=environment, stdin=subprocess.DEVNULL, stdout=log,
                                  stderr=log)
    try:
        launch = subprocess.run(
            ["roslaunch", "--wait", "gyro_deblur", "demo.launch", "bag:=" + bag, "config:=" + parameters,
             "record:=" + recorded, "conductor_args:=--patience 120 --rate %g" % rate],
            env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            universal_newlines=True, timeout=500)
    finally:
        end(master)
    if not os.path.isfile(recorded):
        raise AssertionError("nothing was recorded:\n" + launch.stdout)


class Recording(unittest.TestCase):
    FOLDER, FORMAT, MAKE_ARGUMENTS, CONFIG, MORE_CONFIG = "", "", (), "", ""
    # So slow that no frame has to wait for another: behind the camera's rate curved blocks and frames pass through.
    NODELET_RATE = 0.05

    @classmethod
    def setUpClass(cls):
        cls._folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls._folder.cleanup)
        cls.root = cls._folder.name
        cls.input = os.path.join(cls.root, "in.bag")
        cls.output = os.path.join(cls.root, "out.bag")
        report = os.path.join(cls.root, "out.json")
        cls.config = os.path.join(cls.root, "config.yaml")
        with open(config(cls.CONFIG), encoding="utf-8") as given, open(cls.config, "w", encoding="utf-8") as file:
            file.write(given.read() + cls.MORE_CONFIG)
        run("make_bag", cls.input, os.path.join(DATA_DIR, cls.FOLDER), "--format", cls.FORMAT, "--quiet",
            *cls.make_arguments())
        run("deblur_bag", cls.input, cls.output, "--config", cls.config, "--json", report)
        with open(report, encoding="utf-8") as file:
            cls.report = json.load(file)
        cls.images_in = messages(cls.input, "/camera/image_raw")
        cls.images_out = messages(cls.output, "/camera/deblurred/image_raw")
        cls.fields = messages(cls.output, "/camera/blur_field")

    @classmethod
    def make_arguments(cls):
        return ()

    def check_one_for_one(self):
        self.assertEqual([m.header.stamp for m in self.images_out], [m.header.stamp for m in self.images_in])
        self.assertEqual([m.header.stamp for m in self.fields], [m.header.stamp for m in self.images_in])
        for before, after in zip(self.images_in, self.images_out):
            self.assertEqual(
                (after.encoding, after.width, after.height, after.step, after.header.frame_id),
                (before.encoding, before.width, before.height, before.step, before.header.frame_id))

    def check_identical(self):
        for index, (before, after) in enumerate(zip(self.images_in, self.images_out)):
            self.assertTrue(before.data == after.data, "image %d was altered" % index)

    def check_nodelet(self):
        recorded = os.path.join(self.root, "nodelet.bag")
        through_nodelet(self.input, self.config, recorded, self.root, self.NODELET_RATE)
        for topic in OUTPUTS:
            of_bag = messages(self.output, "/camera/" + topic)
            of_nodelet = messages(recorded, "/camera/" + topic)
            self.assertEqual(len(of_nodelet), len(of_bag), topic)
            for index, (a, b) in enumerate(zip(of_bag, of_nodelet)):
                a.header.seq = b.header.seq = 0  # counted by each publisher for itself
                self.assertTrue(a == b, "message %d of %s differs" % (index, topic))


class ShieldBurst(Recording):
    """Seven rolling-shutter frames with about 100 px of real blur, by the gyroscope alone."""

    FOLDER, FORMAT, CONFIG = "shield_burst", "frames", "shield_burst.yaml"
    MORE_CONFIG = "optical_flow: false\n"
    LARGEST_CENTER_EXTENT_PX, GAIN = 113, 1.5
    NODELET_RATE = 0.02  # SIFT takes longest

    @classmethod
    def make_arguments(cls):
        return ("--description", config("recordings/shield_burst.yaml"))

    def test_one_for_one(self):
        self.assertEqual(len(self.images_in), 7)
        self.check_one_for_one()

    def test_predicted_blur_at_the_center(self):
        for frame in self.report["frames"][1:6]:
            self.assertGreaterEqual(frame["center_extent_px"], 97)
            self.assertLessEqual(frame["center_extent_px"], self.LARGEST_CENTER_EXTENT_PX)
            self.assertGreaterEqual(frame["center_angle_deg"], -6)
            self.assertLessEqual(frame["center_angle_deg"], -3)
            self.assertEqual((frame["exposure_s"], frame["readout_s"]), (0.02, 0.0244944))

    def test_covered_images_are_deblurred(self):
        for index in range(1, 6):
            status = np.array(list(self.fields[index].status))
            self.assertEqual(self.fields[index].reason, 0)
            self.assertGreater(np.mean(status == DEBLURRED), 0.9, "image %d" % (index + 1))
            self.assertEqual(np.count_nonzero(status == NO_GYRO), 0, "image %d" % (index + 1))

    def test_uncovered_rows_are_left_alone(self):
        # The gyroscope starts after most rows of image 1 and ends 2.6 ms before image 7 does.
        for index, first, last in ((0, True, False), (6, False, True)):
            field = self.fields[index]
            status = np.array(list(field.status)).reshape(field.rows, field.cols)
            self.assertEqual(np.all(status[0] == NO_GYRO), first, "image %d" % (index + 1))
            self.assertEqual(np.all(status[-1] == NO_GYRO), last, "image %d" % (index + 1))
            self.assertTrue(np.any(status == DEBLURRED), "image %d" % (index + 1))
            before, after = (np.frombuffer(m.data, np.uint8).reshape(m.height, m.step)
                             for m in (self.images_in[index], self.images_out[index]))
            for row in np.nonzero(np.all(status == NO_GYRO, axis=1))[0]:
                rows = slice(row * field.block_height, (row + 1) * field.block_height)
                self.assertTrue(np.array_equal(before[rows], after[rows]))
        uncovered = np.mean(np.array(list(self.fields[0].status)) == NO_GYRO)
        self.assertGreater(uncovered, 0.5)

    def test_detail_is_gained(self):
        # Squared gradient along the motion, which is nearly horizontal here, above what noise contributes across it.
        def along_over_across(message):
            image = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)[:, :, 1]
            small = image.astype(np.float64).reshape(message.height // 4, 4, message.width // 4, 4).mean((1, 3))
            return np.mean(np.diff(small, axis=1) ** 2) / np.mean(np.diff(small, axis=0) ** 2)

        for index in range(1, 6):
            gain = along_over_across(self.images_out[index]) / along_over_across(self.images_in[index])
            self.assertGreater(gain, self.GAIN, "image %d" % (index + 1))

    def test_nodelet_gives_the_same(self):
        self.check_nodelet()


class ShieldBurstByImages(ShieldBurst):
    """The same with optical flow: the tablet was also shifted, by up to a quarter of what it rotated."""

    MORE_CONFIG = ""
    LARGEST_CENTER_EXTENT_PX, GAIN = 1.25 * 113, 1.3

    def test_the_images_add_what_the_gyroscope_does_not_know(self):
        for field in self.fields[2:6]:  # the gyroscope begins within the first
            self.assertGreater(np.mean(np.array(list(field.source)) == SOURCE_IMAGES), 0.6)


class EurocAtRest(Recording):
    """A standing vehicle, for 1.2 s: a bias of 0.08 rad/s that is not known makes less blur than can be seen."""

    FOLDER, FORMAT, CONFIG = "euroc_v1_01", "euroc", "euroc_v1_01.yaml"

    def test_every_image_is_identical(self):
        self.assertEqual(len(self.images_in), 24)
        self.check_one_for_one()
        self.check_identical()
        for field in self.fields:
            self.assertEqual(field.reason, 0)
            self.assertEqual(set(field.status), {SHARP})


class PhoneSharp(Recording):
    """Frames of somebody who walks, without visible blur by rotation."""

    FOLDER, FORMAT, CONFIG = "phone_sharp", "frames", "phone_sharp.yaml"
    MORE_CONFIG = "optical_flow: false\n"

    @classmethod
    def make_arguments(cls):
        return ("--description", config("recordings/phone_sharp.yaml"))

    def test_every_image_is_identical(self):
        self.assertEqual(len(self.images_in), 40)
        self.check_one_for_one()
        self.check_identical()
        for field in self.fields:
            self.assertEqual(field.reason, 0)
            self.assertEqual(set(field.status), {SHARP})

    def test_blur_and_exposure(self):
        for frame in self.report["frames"]:
            self.assertLess(frame["center_extent_px"], 2)
            self.assertAlmostEqual(frame["exposure_s"], 0.005, delta=0.001)
        self.assertGreater(max(f["center_extent_px"] for f in self.report["frames"]), 1)

    def test_timing_is_found_in_the_footage(self):
        """1.3 s of a phone in a car: little for calibrate, but enough to know it by."""
        report_path = os.path.join(self.root, "timing.json")
        run("calibrate", self.input, "--config", config(self.CONFIG), "--estimate-rotation", "--json",
            report_path, "--quiet")
        with open(report_path, encoding="utf-8") as file:
            report = json.load(file)
        known = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
        R = np.reshape(report["R_cam_imu"], (3, 3))
        self.assertLess(np.degrees(np.arccos((np.trace(R.T @ known) - 1) / 2)), 1.5)
        self.assertLess(abs(report["time_offset_s"]["value"]), 0.01)
        readout = report["readout_time_s"]
        self.assertGreater(readout["value"], 0.02)
        self.assertLess(readout["value"], 0.0333 + 2 * readout["stddev"])
        residual = report["median_residual_px"]
        self.assertLess(residual["estimated"], 0.05 * residual["without_gyroscope"])


class PhoneSharpByImages(Recording):
    """The same with optical flow: what passes near by is blurred by 3 to 5 px."""

    FOLDER, FORMAT, CONFIG = "phone_sharp", "frames", "phone_sharp.yaml"

    @classmethod
    def make_arguments(cls):
        return ("--description", config("recordings/phone_sharp.yaml"))

    def test_nothing_is_altered_but_what_passes_near_by(self):
        self.assertEqual(len(self.images_in), 40)
        self.check_one_for_one()
        identical = 0
        for before, after, field in zip(self.images_in, self.images_out, self.fields):
            self.assertEqual(field.reason, 0)
            blurred = np.array(list(field.status)) != SHARP
            self.assertLess(np.mean(blurred), 0.1)
            self.assertLess(np.max(field.extent), 5)
            self.assertTrue(np.all(np.array(list(field.source))[blurred] == SOURCE_IMAGES), "by rotation there is none")
            identical += before.data == after.data
            self.assertTrue(before.data == after.data or np.any(blurred))
        self.assertGreater(identical, 10)


if __name__ == "__main__":
    SOURCE_DIR, DATA_DIR, TOOL_DIR = sys.argv[1:4]
    if not os.path.isdir(DATA_DIR):
        print("SKIPPED:\n%s is absent" % DATA_DIR)
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1] + sys.argv[4:], verbosity=2)
