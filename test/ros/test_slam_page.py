#!/usr/bin/env python3
"""The commands and launch files of doc/guides/slam.md: roslaunch loads them, and the nodelets get what each stack needs."""

import collections
import os
import pathlib
import re
import shlex
import shutil
import sys
import tempfile
import unittest

import roslaunch.arg_dump
import roslaunch.config
import roslaunch.xmlloader

ROOT = pathlib.Path(__file__).resolve().parents[2]
FRONT_END = ROOT / "launch" / "slam_front_end.launch"
ON_TRACKS = ROOT / "openvins" / "launch" / "openvins_tracks.launch"
# Files that the page takes for granted in $HOME, and what stands for them here.
USERS_FILES = {"my_camera.yaml": ROOT / "config" / "default.yaml", "my_camera1.yaml": ROOT / "config" / "default.yaml",
               "camchain-imucam.yaml": ROOT / "test" / "config" / "calibration" / "kalibr.yaml"}

Need = collections.namedtuple("Need", "cameras feature_tracks global_shutter_feature_tracks",
                              defaults=["global_shutter/feature_tracks"])
# What each stack wants.
NEEDS = {
    "OpenVINS": Need(["/cam0"], "feature_tracks"),
    "VINS-Mono": Need(["/cam0"], "/feature_tracker/feature"),
    "VINS-Fusion": Need(["/cam0", "/cam1"], "feature_tracks"),
    "VINS-Fusion on tracks": Need(["/cam0"], "feature_tracks", "/feature_tracker/feature"),
    "ORB-SLAM3": Need(["/cam0"], "feature_tracks"),
    "msckf_vio": Need(["/cam0", "/cam1"], "feature_tracks"),
}
OPENVINS_STEREO = NEEDS["OpenVINS"]._replace(cameras=["/cam0", "/cam1"])
# The nodes that the page adds to the front end.
STACKS = {
    "OpenVINS": [("ov_msckf", "run_subscribe_msckf")],
    "VINS-Mono": [("vins_estimator", "vins_estimator"), ("feature_tracker", "feature_tracker")],
    "VINS-Fusion": [("vins", "vins_node")],
    "ORB-SLAM3": [("ORB_SLAM3", "Mono_Inertial"), ("ORB_SLAM3", "Stereo_Inertial")],
    "msckf_vio": [("nodelet", "nodelet")],
}


def load(path, arguments=()):
    config = roslaunch.config.ROSLaunchConfig()
    roslaunch.xmlloader.XmlLoader().load(str(path), config, argv=list(arguments), verbose=False)
    return config


class SlamPage(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.temporary = tempfile.TemporaryDirectory()
        cls.home = pathlib.Path(cls.temporary.name)
        os.environ["HOME"] = str(cls.home)
        for name, source in USERS_FILES.items():
            shutil.copy(source, cls.home / name)
        parts = re.split(r"^## (.*)$", (ROOT / "doc" / "guides" / "slam.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
        cls.introduction = parts[0]
        cls.sections = dict(zip(parts[1::2], parts[2::2]))

    @classmethod
    def tearDownClass(cls):
        cls.temporary.cleanup()

    def arguments_of_command(self, text, package="gyro_deblur", launch=FRONT_END):
        """Of the one call of the launch file in `text`; each must be an argument that it has."""
        commands = re.findall(rf"^roslaunch {package} {launch.name} ((?:.*\\\n)*.*)$", text, re.MULTILINE)
        self.assertEqual(len(commands), 1, text)
        arguments = shlex.split(os.path.expandvars(commands[0].replace("\\\n", " ")))
        # roslaunch does not complain about others.
        known = roslaunch.arg_dump.get_args([str(launch)])
        for argument in arguments:
            self.assertIn(argument.partition(":=")[0], known)
        return arguments

    def snippets(self, section):
        """The launch files of a section; lines without a root get one."""
        for text in re.findall(r"^```xml\n(.*?)^```$", self.sections[section], re.MULTILINE | re.DOTALL):
            path = self.home / "snippet.launch"
            path.write_text(text if text.startswith("<launch>") else f"<launch>\n{text}</launch>\n", encoding="utf-8")
            yield load(path)

    def assert_front_end(self, config, need):
        nodes = {node.namespace.rstrip("/"): node for node in config.nodes if "gyro_deblur/DeblurNodelet" in node.args}
        self.assertEqual(sorted(nodes), need.cameras)
        self.assertEqual([n.args for n in config.nodes if n.name == "deblur_manager"], ["manager"])
        for camera, node in nodes.items():
            self.assertEqual(node.args, "load gyro_deblur/DeblurNodelet /deblur_manager")
            remaps = dict(node.remap_args)
            self.assertEqual(remaps["imu"], "/imu0")
            for topic, wanted in (("feature_tracks", need.feature_tracks),
                                  ("global_shutter/feature_tracks", need.global_shutter_feature_tracks)):
                self.assertEqual(remaps[topic], wanted if camera == "/cam0" else topic)

    def test_front_end_alone(self):
        self.assert_front_end(load(FRONT_END, self.arguments_of_command(self.introduction)), NEEDS["ORB-SLAM3"])

    def test_commands_give_the_nodelets_what_each_stack_needs(self):
        for stack, need in NEEDS.items():
            with self.subTest(stack):
                self.assert_front_end(load(FRONT_END, self.arguments_of_command(self.sections[stack])), need)

    def test_launch_files_start_the_stacks(self):
        for stack, nodes in STACKS.items():
            with self.subTest(stack):
                added = [(node.package, node.type) for config in self.snippets(stack) for node in config.nodes
                         if "manager" != node.args and "DeblurNodelet" not in node.args]
                self.assertEqual(added, nodes)

    def test_the_launch_file_with_both(self):
        (config,) = self.snippets("OpenVINS")
        self.assert_front_end(config, OPENVINS_STEREO)
        self.assertTrue(config.params["/ov_msckf/use_stereo"].value)

    def test_openvins_on_tracks(self):
        given = self.arguments_of_command(self.sections["OpenVINS on tracks"], "gyro_deblur_openvins", ON_TRACKS)
        for rolling, topic in (("false", "feature_tracks"), ("true", "global_shutter/feature_tracks")):
            with self.subTest(rolling_shutter=rolling):
                config = load(ON_TRACKS, [*given, f"rolling_shutter:={rolling}"])
                self.assert_front_end(config, NEEDS["OpenVINS"])
                (node,) = [node for node in config.nodes if node.package == "gyro_deblur_openvins"]
                self.assertEqual(node.type, "openvins_tracks")
                self.assertEqual(dict(node.remap_args), {"imu": "/imu0", "feature_tracks": f"/cam0/{topic}"})
                self.assertEqual(config.params["/ov_msckf/config_path"].value, f"{self.home}/estimator_config.yaml")

    def test_stacks_take_the_deblurred_images(self):
        for stack in ("ORB-SLAM3", "msckf_vio"):
            for config in self.snippets(stack):
                remaps = [to for node in config.nodes for _, to in node.remap_args]
                with self.subTest(stack):
                    self.assertIn("/cam0/deblurred/image_raw", remaps)
                    self.assertIn("/imu0", remaps)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
