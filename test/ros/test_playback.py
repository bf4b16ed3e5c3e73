#!/usr/bin/env python3
"""playback.launch on a bag that has compressed images alone, on a topic that is not image_raw.

Usage: test_playback.py LAUNCH_FILE SIMULATE_BAG
"""

import os
import socket
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np
import rosbag
from sensor_msgs.msg import CompressedImage

LAUNCH_FILE, SIMULATE_BAG = sys.argv[1:3]
FRAMES = 20
IMAGE = "rgb/image_rect_color"  # in /camera, where its driver has camera_info too
DEBLURRED = "/camera/deblurred/image_raw"
FIELD = "/camera/blur_field"
SCENE = """
frames: {frames}
seed: 5
camera: {{size: [192, 144], intrinsics: [190, 190, 95.5, 71.5], fps: 10, exposure_time: 0.02, noise: 1.5}}
imu: {{rate: 200}}
planes:
  - {{texture: procedural, texture_seed: 11, texture_size: [1600, 1200], size: [9.6, 7.2], position: [0, 0, 2]}}
motion:
  type: curve
  rotation: {{sines: [{{amplitude: [9, 14, 5], frequency: 1.3, phase: 20}}]}}
"""


def compressed(image):
    pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width)
    return CompressedImage(header=image.header, format="mono8; jpeg compressed ",
                           data=cv2.imencode(".jpg", pixels)[1].tobytes())


class Playback(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, name):
        return os.path.join(self.folder, name)

    def record(self):
        """Records a driver's bag; returns its path and the stamps of its images [ns]."""
        with open(self.path("scene.yaml"), "w", encoding="utf-8") as file:
            file.write(SCENE.format(frames=FRAMES))
        subprocess.run([SIMULATE_BAG, self.path("raw.bag"), "--scene", self.path("scene.yaml"), "--no-truth", "--quiet"],
                       check=True, stdout=subprocess.DEVNULL)
        names = {"/camera/image_raw": f"/camera/{IMAGE}/compressed", "/camera/camera_info": "/camera/rgb/camera_info",
                 "/camera/exposure": "/camera/exposure", "/imu": "/imu",
                 "/tf_static": "/tf_static"}
        stamps_ns = []
        with rosbag.Bag(self.path("raw.bag")) as raw, rosbag.Bag(self.path("in.bag"), "w") as bag:
            for topic, message, time, header in raw.read_messages(topics=list(names), return_connection_header=True):
                if topic == "/camera/image_raw":
                    stamps_ns.append(message.header.stamp.to_nsec())
                    message, header = compressed(message), None
                bag.write(names[topic], message, time, connection_header=header)
        return self.path("in.bag"), stamps_ns

    def play(self, bag):
        """What playback.launch prints, and its status."""
        with socket.socket() as probe:
            probe.bind(("localhost", 0))
            port = probe.getsockname()[1]
        environment = dict(os.environ, ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost",
                           ROS_LOG_DIR=self.path("log"))
        result = subprocess.run(["roslaunch", "-p", str(port), LAUNCH_FILE, f"bag:={bag}", f"image:={IMAGE}",
                                 f"record:={self.path('out.bag')}"], env=environment, stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, text=True, timeout=120, check=False)
        return result.returncode, result.stdout

    def test_every_image_is_deblurred(self):
        bag, stamps_ns = self.record()
        self.assertEqual(len(stamps_ns), FRAMES)
        status, output = self.play(bag)
        self.assertEqual(status, 0, output)
        self.assertIn(f"{FRAMES} of {FRAMES} frames came out", output)
        with rosbag.Bag(self.path("out.bag")) as recorded:
            images = [message for _, message, _ in recorded.read_messages(topics=[DEBLURRED])]
            fields = [message for _, message, _ in recorded.read_messages(topics=[FIELD])]
        self.assertEqual([image.header.stamp.to_nsec() for image in images], stamps_ns, output)
        self.assertEqual([field.reason_text for field in fields if field.reason], [], output)
        deblurred = sum(any(status == field.DEBLURRED for status in field.status) for field in fields)
        self.assertGreater(deblurred, FRAMES // 2, output)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
