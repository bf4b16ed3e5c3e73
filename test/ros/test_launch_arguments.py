#!/usr/bin/env python3
"""What the launch files make of their arguments: names of image topics, and the transport of a bag's images."""

import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import roslaunch.config
import roslaunch.xmlloader
import rosbag
import rospy
from sensor_msgs.msg import CompressedImage, Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "launch"
SCRIPT = ROOT / "scripts" / "play_bag.py"
CONFIG = "config:=%s" % (ROOT / "config" / "default.yaml")
NO_INDEX = 0  # of a bag that was not closed: its header says that the index begins there


def load(name, *arguments):
    config = roslaunch.config.ROSLaunchConfig()
    roslaunch.xmlloader.XmlLoader().load(str(LAUNCH / name), config, argv=list(arguments), verbose=False)
    return config


def remaps(config):
    """By the name of the node, those from image_raw and from what rviz has in its place."""
    return {node.name: dict(node.remap_args) for node in config.nodes}


class Bags(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def bag(self, *topics):
        """Of one image on each topic."""
        path = self.folder / "in.bag"
        with rosbag.Bag(str(path), "w") as bag:
            for topic in topics:
                compressed = topic.endswith("compressed")
                bag.write(topic, CompressedImage() if compressed else Image(), rospy.Time(1))
        return path


class ImageArgument(unittest.TestCase):
    def test_default(self):
        self.assertEqual(remaps(load("deblur.launch"))["gyro_deblur"]["image_raw"], "image_raw")

    def test_reaches_the_nodelet_of_every_file(self):
        for name, arguments in (("deblur.launch", []), ("playback.launch", ["bag:=/x.bag"]),
                                ("inspect.launch", ["bag:=/x.bag"]), ("demo.launch", ["bag:=/x.bag", CONFIG]),
                                ("slam_front_end.launch", ["camera1:=/cam1"])):
            with self.subTest(name):
                config = load(name, "image:=infra1/image_rect_raw", *arguments)
                nodelets = [n for n in config.nodes if n.name == "gyro_deblur"]
                self.assertEqual(len(nodelets), 2 if "camera1:=/cam1" in arguments else 1)
                for node in nodelets:
                    self.assertEqual(dict(node.remap_args)["image_raw"], "infra1/image_rect_raw")

    def test_cameras_of_a_pair_may_differ(self):
        config = load("slam_front_end.launch", "camera1:=/cam1", "image:=left", "image1:=right")
        images = {n.namespace: dict(n.remap_args)["image_raw"] for n in config.nodes if n.name == "gyro_deblur"}
        self.assertEqual(images, {"/cam0/": "left", "/cam1/": "right"})

    def test_reaches_those_who_look_and_play(self):
        config = load("inspect.launch", "bag:=/x.bag", "camera:=/camera", "image:=infra1/image_rect_raw")
        conductor = next(n for n in config.nodes if n.name == "conductor")
        self.assertIn("--image infra1/image_rect_raw", conductor.args)
        rviz = remaps(config)["rviz"]
        self.assertEqual(rviz["/camera/image_raw"], "/camera/infra1/image_rect_raw")
        self.assertEqual(rviz["/camera/camera_info"], "/camera/infra1/camera_info")
        self.assertEqual(remaps(load("rviz.launch", "image:=/a/b"))["rviz"]["/camera/image_raw"], "/a/b")


class Transport(Bags):
    NAME = "/camera/gyro_deblur/image_transport"

    def transport(self, path, *arguments):
        parameter = load("playback.launch", "bag:=%s" % path, *arguments).params.get(self.NAME)
        return parameter.value if parameter else None

    def test_is_what_the_bag_has(self):
        self.assertEqual(self.transport(self.bag("/camera/image_raw/compressed")), "compressed")
        self.assertEqual(self.transport(self.bag("/camera/image_raw")), "raw")
        self.assertEqual(self.transport(self.bag("/camera/image_raw", "/camera/image_raw/compressed")), "raw")
        self.assertEqual(self.transport(self.bag("/camera/a/compressed"), "image:=a"), "compressed")
        self.assertEqual(self.transport(self.folder / "none.bag"), "raw")

    def test_bag_holds_against_config_and_argument_against_bag(self):
        config = self.folder / "config.yaml"
        config.write_text("image_transport: raw\n", encoding="utf-8")
        path = self.bag("/camera/image_raw/compressed")
        self.assertEqual(self.transport(path, "config:=%s" % config), "compressed")
        self.assertEqual(self.transport(path, "image_transport:=theora"), "theora")


class WrongBags(Bags):
    """play_bag.py ends with one line, before it asks for a master."""

    def refused(self, path):
        result = subprocess.run([sys.executable, str(SCRIPT), str(path)], stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, universal_newlines=True, timeout=60)
        self.assertEqual(result.returncode, 1, result.stdout)
        self.assertEqual(result.stdout.count("\n"), 1, result.stdout)
        self.assertIn(str(path), result.stdout)
        return result.stdout

    def test_missing_or_no_bag(self):
        self.assertIn("no such file", self.refused(self.folder / "none.bag"))
        path = self.folder / "text.bag"
        path.write_text("hello\n", encoding="utf-8")
        self.assertIn("is not a bag", self.refused(path))

    def test_cut_or_without_index(self):
        path = self.bag("/camera/image_raw")
        os.truncate(path, os.path.getsize(path) - 100)
        self.assertIn("rosbag reindex", self.refused(path))
        path = self.bag("/camera/image_raw")
        content = path.read_bytes()
        field = b"index_pos="
        at = content.index(field) + len(field)
        path.write_bytes(content[:at] + NO_INDEX.to_bytes(8, "little") + content[at + 8:])
        self.assertIn("rosbag reindex", self.refused(path))

    def test_ros2(self):
        folder = self.folder / "two"
        folder.mkdir()
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n", encoding="utf-8")
        (folder / "two_0.db3").write_bytes(b"SQLite format 3\0" + bytes(84))
        (folder / "two_0.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(84))
        for path in (folder, folder / "two_0.db3", folder / "two_0.mcap"):
            text = self.refused(path)
            self.assertIn("ROS 2 bag", text)
            self.assertIn("rosbags-convert --src %s" % path, text)

    def test_topics_that_are_not_there_are_named(self):
        text = self.refused(self.bag("/camera/infra1/image_rect_raw"))
        self.assertIn("no messages on /camera/image_raw", text)
        self.assertIn("image:=", text)
        self.assertIn("/camera/infra1/image_rect_raw (sensor_msgs/Image)", text)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
