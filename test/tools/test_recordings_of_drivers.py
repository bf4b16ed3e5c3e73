#!/usr/bin/env python3
"""Bags as drivers record them, through the tools: which topics are taken, messages that are late, bags that are none.

Usage: test_recordings_of_drivers.py FOLDER_OF_THE_TOOLS
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np
import rosbag
import rospy
from gyro_deblur.msg import BlurField, Exposure
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

TOOLS = pathlib.Path(sys.argv[1])
START_S = 100.0
WIDTH, HEIGHT, FOCAL_PX = 96, 64, 100.0
FRAMES, PERIOD_S = 12, 0.05
IMU_PERIOD_S = 0.005
EXPOSURE_S, READOUT_S = 0.02, 0.01
RATE_RAD_S = 2.0
CONFIG = ("exposure_time: %g\nreadout_time: %g\nR_cam_imu: [1,0,0,0,1,0,0,0,1]\nblock_size: 32\nvalidation: none\n"
          "optical_flow: false\nkeypoint_detector: FAST\nkeypoint_descriptor: ORB\n" % (EXPOSURE_S, READOUT_S))


def time_of(seconds):
    return rospy.Time(0, int(round(seconds * 1e9)))


def texture(frame):
    """Smooth noise, another one in each frame."""
    noise = np.random.RandomState(frame).uniform(0, 255, (HEIGHT, WIDTH)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, None, 2), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def image(frame, stamp, encoding="mono8"):
    pixels = texture(frame)
    if encoding == "16UC1":
        pixels = pixels.astype("<u2") * 20  # mm
    elif encoding == "32FC1":
        pixels = pixels.astype("<f4") / 50  # m
    message = Image(height=HEIGHT, width=WIDTH, encoding=encoding, step=pixels.strides[0], data=pixels.tobytes())
    message.header.stamp, message.header.frame_id = stamp, "camera"
    return message


def compressed(frame, stamp, codec="png compressed ", encoding="mono8"):
    message = CompressedImage(format="%s; %s" % (encoding, codec), data=cv2.imencode(".png", texture(frame))[1].tobytes())
    message.header.stamp, message.header.frame_id = stamp, "camera"
    return message


def camera_info(stamp):
    cx, cy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    message = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", D=[0.0] * 5,
                         K=[FOCAL_PX, 0, cx, 0, FOCAL_PX, cy, 0, 0, 1], R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
                         P=[FOCAL_PX, 0, cx, 0, 0, FOCAL_PX, cy, 0, 0, 0, 1, 0])
    message.header.stamp, message.header.frame_id = stamp, "camera"
    return message


def imu(stamp):
    message = Imu()
    message.header.stamp, message.header.frame_id = stamp, "imu"
    message.angular_velocity.y = RATE_RAD_S
    return message


def exposure(stamp):
    message = Exposure(exposure_time=rospy.Duration.from_sec(EXPOSURE_S))
    message.header.stamp = stamp
    return message


class DriverBags(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)
        self.input, self.output = self.folder / "in.bag", self.folder / "out.bag"
        self.configure()

    def configure(self, more=""):
        (self.folder / "config.yaml").write_text(CONFIG + more, encoding="utf-8")

    def write(self, images, late_s=(), frames=FRAMES, imu_until_s=None, make_imu=imu):
        """A bag with the images {topic: message of (frame, stamp)}, and what belongs to them.

        late_s: how long after its stamp a kind ("image", "imu", "camera_info", "exposure") is recorded; a kind that is
        not there is recorded at once, exposure only where it is there.
        """
        late_s = dict(late_s)
        home = "/" + next(iter(images)).strip("/").split("/")[0]

        def at(kind, stamp):
            return stamp + rospy.Duration.from_sec(late_s.get(kind, 0))

        with rosbag.Bag(str(self.input), "w") as bag:
            end_s = FRAMES * PERIOD_S + 0.2 if imu_until_s is None else imu_until_s
            for t in np.arange(-1, end_s, IMU_PERIOD_S):
                stamp = time_of(START_S + t)
                bag.write("/imu", make_imu(stamp), at("imu", stamp))
            for frame in range(frames):
                stamp = time_of(START_S + frame * PERIOD_S)
                for topic, make in images.items():
                    bag.write(topic, make(frame, stamp), at("image", stamp))
                bag.write(home + "/camera_info", camera_info(stamp), at("camera_info", stamp))
                if "exposure" in late_s:
                    bag.write(home + "/exposure", exposure(stamp), at("exposure", stamp))

    def run_tool(self, tool, *arguments):
        return subprocess.run([str(TOOLS / tool), *map(str, arguments)], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, universal_newlines=True, timeout=120)

    def deblur(self, *arguments):
        return self.run_tool("deblur_bag", self.input, self.output, "--config", self.folder / "config.yaml", "--json",
                             self.folder / "report.json", *arguments)

    def deblurred(self, *arguments):
        """The report of a run that ends well."""
        result = self.deblur(*arguments)
        self.assertEqual(result.returncode, 0, result.stdout)
        return json.loads((self.folder / "report.json").read_text(encoding="utf-8"))

    def refused(self, result, *parts):
        self.assertEqual(result.returncode, 1, result.stdout)
        self.assertEqual(result.stdout.count("\n"), 1, result.stdout)
        for part in parts:
            self.assertIn(part, result.stdout)
        self.assertFalse(self.output.exists())
        return result.stdout


class WhichImages(DriverBags):
    def taken(self, images, *arguments):
        self.write(images, frames=2)
        return self.deblurred(*arguments)["topics"]

    def asked(self, images, *candidates):
        self.write(images, frames=2)
        text = self.refused(self.deblur(), "several topics of images", "--image-topic", *candidates)
        self.assertEqual(text.count("(sensor_msgs/"), len(candidates), text)

    def test_compressed_colour_with_raw_depth(self):
        images = {"/camera/color/image_raw/compressed": compressed,
                  "/camera/depth/image_rect_raw": lambda i, t: image(i, t, "16UC1")}
        self.assertEqual(self.taken(images)["image"], "/camera/color/image_raw/compressed")

    def test_depth_by_its_encoding(self):
        for encoding in ("16UC1", "32FC1"):
            images = {"/camera/range": lambda i, t, e=encoding: image(i, t, e), "/camera/grey": image}
            self.assertEqual(self.taken(images)["image"], "/camera/grey")
        images = {"/camera/range": lambda i, t: compressed(i, t, "png compressed ", "16UC1"), "/camera/grey": image}
        self.assertEqual(self.taken(images)["image"], "/camera/grey")

    def test_compressed_depth(self):
        images = {"/camera/range/compressedDepth": lambda i, t: compressed(i, t, "compressedDepth", "16UC1"),
                  "/camera/disparity/image": image, "/camera/grey": image}
        self.assertEqual(self.taken(images)["image"], "/camera/grey")

    def test_depth_only_where_it_is_named(self):
        topic = "/camera/depth/image_rect_raw"
        self.write({topic: lambda i, t: image(i, t, "16UC1")}, frames=2)
        self.refused(self.deblur(), "only depth", "--image-topic", topic)
        self.assertEqual(self.deblurred("--image-topic", topic)["topics"]["image"], topic)

    def test_several_are_asked_for(self):
        self.asked({"/camera/left": image, "/camera/right": image}, "/camera/left", "/camera/right")
        self.asked({"/camera/left": image, "/camera/right/compressed": compressed}, "/camera/left",
                   "/camera/right/compressed")

    def test_compressed_version_is_no_other_candidate(self):
        images = {"/camera/grey": image, "/camera/grey/compressed": compressed}
        self.assertEqual(self.taken(images)["image"], "/camera/grey")

    def test_names_as_in_the_launch_files(self):
        images = {"/camera/infra1/image_rect_raw": image, "/camera/infra2/image_rect_raw": image}
        topics = self.taken(images, "--camera-ns", "camera", "--image-topic", "infra1/image_rect_raw",
                            "--camera-info-topic", "/camera/camera_info")
        self.assertEqual(topics["image"], "/camera/infra1/image_rect_raw")
        self.assertEqual(topics["output_namespace"], "/camera")
        topics = self.taken(images, "--image-topic", "/camera/infra2/image_rect_raw")
        self.assertEqual(topics["output_namespace"], "/camera/infra2")
        topics = self.taken({"/camera/rgb/image_rect_color/compressed": compressed}, "--camera-ns", "/camera/rgb/",
                            "--image-topic", "image_rect_color")
        self.assertEqual(topics["image"], "/camera/rgb/image_rect_color/compressed")
        self.assertEqual(topics["output_namespace"], "/camera/rgb")
        with rosbag.Bag(str(self.output)) as bag:
            self.assertEqual(bag.get_message_count("/camera/rgb/deblurred/image_raw"), 2)

    def test_timing_chooses_the_same(self):
        self.write({"/camera/left": image, "/camera/right/compressed": compressed}, frames=2)
        self.refused(self.run_tool("calibrate", self.input), "several topics of images", "/camera/left",
                     "/camera/right/compressed")
        self.write({"/camera/color/compressed": compressed, "/camera/depth": lambda i, t: image(i, t, "16UC1")})
        result = self.run_tool("calibrate", self.input, "--quiet")
        self.assertIn("pairs of frames", result.stdout)  # read, and of course not enough for an estimate
        self.assertNotIn("topic", result.stdout)


class LateMessages(DriverBags):
    """What a recording holds is found by its stamps, whenever it was recorded."""

    IMAGES = {"/camera/image_raw": image}

    def fields(self):
        with rosbag.Bag(str(self.output)) as bag:
            return [message for _, message, _ in bag.read_messages(topics=["/camera/blur_field"])]

    def expect_same(self, late_s, *arguments):
        """Each kind as late as said makes no difference to a recording in which everything comes at once."""
        self.write(self.IMAGES, dict.fromkeys(late_s, 0))
        self.deblurred(*arguments)
        expected = self.fields()
        self.assertEqual([f.reason for f in expected], [BlurField.REASON_NONE] * FRAMES)
        self.write(self.IMAGES, late_s)
        report = self.deblurred(*arguments)
        self.assertEqual(report["passed_through"], {})
        self.assertEqual(self.fields(), expected)

    def test_imu(self):
        self.expect_same({"imu": 0.8})

    def test_imu_by_longer_than_a_queue_of_frames(self):
        self.configure("frame_queue_size: 2\n")
        self.expect_same({"imu": 30.0})

    def test_images(self):
        self.expect_same({"image": 30.0})

    def test_camera_info(self):
        self.expect_same({"camera_info": 3.0})

    def test_exposure(self):
        (self.folder / "config.yaml").write_text(CONFIG.replace("exposure_time: %g" % EXPOSURE_S, "exposure_time: 0"),
                                                 encoding="utf-8")
        self.expect_same({"exposure": 3.0})

    def test_all_of_them_in_another_order(self):
        self.expect_same({"image": 0.3, "imu": 0.8, "camera_info": 2.0, "exposure": 1.2})

    def test_nothing_waits_for_an_imu_that_ended(self):
        self.write(self.IMAGES, {"imu": 0.8}, imu_until_s=FRAMES * PERIOD_S / 2)
        report = self.deblurred()
        reasons = [f.reason for f in self.fields()]
        self.assertEqual(reasons, sorted(reasons, key=lambda r: r != BlurField.REASON_NONE), "covered ones first")
        self.assertEqual(report["passed_through"], {"NO_GYRO": reasons.count(BlurField.REASON_NO_GYRO)})
        self.assertEqual(len(reasons), FRAMES)
        self.assertEqual(report["passed_through"]["NO_GYRO"], 6)

    def test_a_wrong_stamp_costs_its_image_alone(self):
        """An image whose stamp is ahead must not use up what those after it need."""
        wrong = 4
        for ahead_s in (10.0, 3600.0):
            def make(frame, stamp):
                return image(frame, stamp + rospy.Duration.from_sec(ahead_s if frame == wrong else 0))

            self.write({"/camera/image_raw": make}, {"imu": 0.8})
            self.deblurred()
            reasons = [f.reason for f in self.fields()]
            self.assertNotEqual(reasons.pop(wrong), BlurField.REASON_NONE)
            self.assertEqual(reasons, [BlurField.REASON_NONE] * (FRAMES - 1), ahead_s)

    def test_a_wrong_stamp_of_the_imu(self):
        def make(stamp, wrong=time_of(START_S + 0.3)):
            return imu(stamp + rospy.Duration.from_sec(3600) if abs((stamp - wrong).to_sec()) < IMU_PERIOD_S / 2 else stamp)

        self.write(self.IMAGES, {"imu": 0.8}, make_imu=make)
        self.assertEqual(self.deblurred()["passed_through"], {})

    def test_slices_together_are_the_whole(self):
        self.write(self.IMAGES, {"imu": 0.8})
        self.deblurred()
        expected = self.fields()
        found = []
        for limits in (["--end", "1.21"], ["--start", "1.21"]):
            self.deblurred(*limits)
            found += self.fields()
        self.assertEqual(found, expected)


class Stages(DriverBags):
    def test_add_up_to_the_total(self):
        self.write({"/camera/image_raw": image})
        report = self.deblurred("--tracks", "--overlay", "--markers", "--global-shutter", "--trust-mask")
        incomplete = []
        for frame in report["frames"]:
            stages = dict(frame["milliseconds"])
            total = stages.pop("total")
            self.assertIn("tracks", stages)
            self.assertLess(sum(stages.values()), total + 0.01)
            if sum(stages.values()) <= 0.95 * total - 0.1:
                incomplete.append((total, stages))
        # A thread can lose its core between two stages, now and then; a stage that is left out is so in every frame.
        self.assertLess(len(incomplete), len(report["frames"]) / 4, incomplete)


class NoBags(DriverBags):
    def tools(self):
        yield lambda path: self.run_tool("deblur_bag", path, self.output, "--config", self.folder / "config.yaml")
        yield lambda path: self.run_tool("calibrate", path)

    def expect(self, path, *parts):
        for run in self.tools():
            self.refused(run(path), str(path), *parts)

    def test_cut(self):
        self.write({"/camera/image_raw": image})
        os.truncate(self.input, os.path.getsize(self.input) - 100)
        self.expect(self.input, "rosbag reindex %s" % self.input)

    def test_without_index(self):
        self.write({"/camera/image_raw": image})
        content = self.input.read_bytes()
        at = content.index(b"index_pos=") + len(b"index_pos=")
        self.input.write_bytes(content[:at] + bytes(8) + content[at + 8:])
        self.expect(self.input, "no index", "rosbag reindex %s" % self.input)

    def test_ros2(self):
        folder = self.folder / "two"
        folder.mkdir()
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n", encoding="utf-8")
        (folder / "two_0.db3").write_bytes(b"SQLite format 3\0" + bytes(84))
        (folder / "two_0.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(84))
        for path in (folder, folder / "two_0.db3", folder / "two_0.mcap"):
            self.expect(path, "ROS 2 bag", "rosbags-convert --src %s --dst" % path)

    def test_others(self):
        (self.folder / "text.bag").write_text("hello\n", encoding="utf-8")
        self.expect(self.folder / "text.bag", "is not a bag")
        self.expect(self.folder, "is a folder, not a bag")
        self.expect(self.folder / "none.bag", "no such file")


class CommonOptions(unittest.TestCase):
    def test_every_tool_has_them(self):
        for tool in ("deblur_bag", "deblur_image", "make_bag", "simulate_bag", "calibrate"):
            text = subprocess.run([str(TOOLS / tool), "--help"], stdout=subprocess.PIPE, universal_newlines=True,
                                  check=True).stdout
            for option in ("--json", "--quiet"):
                self.assertIn(option, text, tool)
            if tool in ("deblur_bag", "make_bag", "calibrate"):
                for option in ("--camera-ns", "--image-topic", "--imu-topic"):
                    self.assertIn(option, text, tool)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[2:], verbosity=2)
