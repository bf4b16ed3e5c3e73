#!/usr/bin/env python3
"""setup with a simulated camera and IMU that rosbag plays, with a master of its own.

Usage: test_setup.py FOLDER_OF_THE_TOOLS
"""
import contextlib
import importlib.util
import os
import pathlib
import socket
import subprocess
import sys
import tempfile
import time
import types
import unittest
from importlib.machinery import SourceFileLoader

import cv2
import rosbag
import rosgraph
import yaml
from sensor_msgs.msg import CompressedImage, Image

SCRIPTS = pathlib.Path(__file__).resolve().parents[2] / "scripts"
sys.path.insert(0, str(SCRIPTS))
from live_inputs import Camera  # noqa: E402

TOOLS = pathlib.Path(sys.argv[1])
EXPOSURE_S, OFFSET_S, READOUT_S = 0.02, 0.043, 0.02
SCENE = f"""
frames: 224
lead_time: 0.3
camera: {{size: [256, 192], intrinsics: [190, 190, 127.5, 95.5], fps: 14, exposure_time: {EXPOSURE_S},
         readout_time: {READOUT_S}, noise: 1.5}}
imu: {{rate: 200, gyro_bias: [0.01, -0.02, 0.03], gyro_noise: 0.003, time_offset: {OFFSET_S}, R_cam_imu: [0, 1, 0, -1, 0, 0, 0, 0, 1]}}
planes:
  - {{texture: procedural, texture_seed: 11, texture_size: [1600, 1200], size: [12, 9], position: [0, 0, 2]}}
motion:
  type: curve
  rotation:
    sines:
      - {{amplitude: [8, 14, 4], frequency: 1.1, phase: 12}}
      - {{amplitude: [-6, 4, 10], frequency: 1.7, phase: 57}}
"""


class Setup(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = pathlib.Path(folder.name)
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            cls.uri = f"http://localhost:{probe.getsockname()[1]}"
        cls.environment = dict(os.environ, ROS_MASTER_URI=cls.uri, ROS_HOSTNAME="localhost",
                               ROS_LOG_DIR=str(cls.folder / "log"), ROS_HOME=str(cls.folder / "home"))
        cls.start(["roscore", "-p", cls.uri.rsplit(":", 1)[1]])
        cls.record()
        cls.master = rosgraph.Master("/test_setup", master_uri=cls.uri)
        cls.wait_for(cls.master.is_online)

    @classmethod
    def start(cls, command):
        """Returns a function that ends it."""
        process = subprocess.Popen(command, env=cls.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.DEVNULL)

        def end():
            process.terminate()
            process.wait()

        cls.addClassCleanup(end)
        return end

    @contextlib.contextmanager
    def drivers(self):
        """The camera and the IMU, for 16 s."""
        end = self.start(["rosbag", "play", "--quiet", str(self.folder / "in.bag")])
        self.wait_for(lambda: "/imu" in dict(self.master.getPublishedTopics("")))
        try:
            yield
        finally:
            end()

    @staticmethod
    def wait_for(condition, seconds=30):
        until_s = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > until_s:
                raise AssertionError("waited in vain")
            time.sleep(0.1)

    @classmethod
    def record(cls):
        """A camera, its depth, and another one without camera_info."""
        (cls.folder / "scene.yaml").write_text(SCENE, encoding="utf-8")
        subprocess.run([str(TOOLS / "simulate_bag"), str(cls.folder / "all.bag"), "--scene",
                        str(cls.folder / "scene.yaml"), "--no-truth", "--quiet"], check=True, stdout=subprocess.DEVNULL)
        with rosbag.Bag(str(cls.folder / "all.bag")) as source, rosbag.Bag(str(cls.folder / "in.bag"), "w") as target:
            for topic, message, at in source.read_messages(
                    topics=["/camera/image_raw", "/camera/camera_info", "/imu"]):
                target.write(topic, message, at)
                if topic != "/camera/image_raw":
                    continue
                other = Image(header=message.header, height=2, width=2, step=2, encoding="mono8", data=bytes(4))
                target.write("/other/image_raw", other, at)
                depth = Image(header=message.header, height=1, width=1, step=2, encoding="16UC1", data=bytes(2))
                target.write("/range/image_raw", depth, at)

    def run_setup(self, *arguments, **more):
        return subprocess.run([str(TOOLS / "setup"), "--look", "0.5", "--yes", *arguments], stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True, timeout=120,
                              env=dict(self.environment, **more), check=False)

    def refused(self, text, *arguments, **more):
        result = self.run_setup(*arguments, **more)
        self.assertEqual(result.returncode, 1, result.stdout + result.stderr)
        self.assertIn(text, result.stderr)

    def parameters_of(self, launch):
        return yaml.safe_load(subprocess.run(["roslaunch", "--dump-params", str(launch)], env=self.environment,
                                             stdout=subprocess.PIPE, universal_newlines=True, check=True,
                                             timeout=60).stdout)

    def test_cameras_are_listed_and_have_to_be_chosen(self):
        with self.drivers():
            result = self.run_setup("--list")
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertRegex(result.stdout, r"1  /camera/image_raw +256x192 mono8, \d+\.\d Hz, calibrated\n")
            self.assertRegex(result.stdout, r"2  /other/image_raw +2x2 mono8, \d+\.\d Hz, without camera_info\n")
            self.assertRegex(result.stdout, r"1  /imu  \d+ Hz\n")
            self.assertNotIn("/range", result.stdout)
            self.refused("there are several cameras, name one with --image: /camera/image_raw, /other/image_raw")
        with self.drivers():
            self.refused("--imu /gyro is not published: /imu", "--image", "/camera/image_raw", "--imu", "/gyro")
            self.refused("/other/image_raw has no calibrated camera_info", "--image", "/other/image_raw")

    def test_from_running_drivers_to_a_launch_file(self):
        folder = self.folder / "files"
        with self.drivers():
            result = self.run_setup("--image", "/camera/image_raw", "--seconds", "9", "--folder", str(folder), "--name",
                                    "mine")
        self.assertEqual(result.returncode, 0, result.stdout + result.stderr)
        keys = yaml.safe_load((folder / "mine.yaml").read_text(encoding="utf-8"))
        self.assertAlmostEqual(keys["time_offset"], OFFSET_S, delta=0.001)
        self.assertAlmostEqual(keys["readout_time"], READOUT_S, delta=0.05 * READOUT_S)
        self.assertAlmostEqual(keys["exposure_time"], EXPOSURE_S, delta=0.04 * EXPOSURE_S)
        self.assertGreater(cv2.imread(str(folder / "mine.png")).std(), 10)
        self.assertEqual(sorted(path.name for path in folder.iterdir()),
                         ["mine.json", "mine.launch", "mine.png", "mine.yaml"])
        self.assertIn(f"roslaunch {folder}/mine.launch", result.stdout)
        self.assertRegex(result.stderr, r"  \d of 9 s, motion \[#+-*\] +\d+ %, \d+ images, \d+ samples: keep rotating")
        parameters = self.parameters_of(folder / "mine.launch")
        self.assertEqual(parameters["/camera/gyro_deblur/time_offset"], keys["time_offset"])

    def test_a_recording_that_is_too_short_has_verdicts_and_nothing_to_start(self):
        folder = self.folder / "short"
        with self.drivers():
            self.refused("does not determine the calibration", "--image", "/camera/image_raw", "--seconds", "0.3",
                         "--folder", str(folder))
        self.assertEqual(sorted(path.name for path in folder.iterdir()), ["camera.json", "camera.png"])

    def test_launch_file_of_a_camera_in_any_namespace(self):
        loader = SourceFileLoader("setup", str(SCRIPTS / "setup"))  # its name has no .py
        setup = importlib.util.module_from_spec(importlib.util.spec_from_loader("setup", loader))
        loader.exec_module(setup)
        (self.folder / "any.yaml").write_text("time_offset: 0.25\n", encoding="utf-8")
        launch = self.folder / "any.launch"
        for topic, kind, transport, node in (
                ("/image_raw", Image, "raw", "/gyro_deblur"),
                ("/a/b/image_raw/compressed", CompressedImage, "compressed", "/a/b/gyro_deblur")):
            stream = types.SimpleNamespace(topic=topic, kind=kind, first=None, size_bytes=0, rate_hz=lambda: 0.0)
            launch.write_text(setup.launch_file(Camera(stream, None, ""), stream, "any.yaml"), encoding="utf-8")
            parameters = self.parameters_of(launch)
            self.assertEqual(parameters[node + "/time_offset"], 0.25)
            self.assertEqual(parameters[node + "/image_transport"], transport)

    def test_without_a_master(self):
        self.refused("there is no ROS master at http://localhost:1", ROS_MASTER_URI="http://localhost:1")

    def test_bad_arguments(self):
        self.assertEqual(self.run_setup("--seconds", "0").returncode, 2)

    def test_a_recording_is_not_overwritten(self):
        bag = self.folder / "field.bag"
        bag.write_text("precious", encoding="utf-8")
        result = self.run_setup("--folder", str(self.folder), "--name", "field", "--yes")
        self.assertEqual(result.returncode, 2)
        self.assertIn("field.bag is there already: choose another --folder or --name", result.stderr)
        self.assertEqual(bag.read_text(encoding="utf-8"), "precious")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
